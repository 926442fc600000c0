"""What the tests in a real browser share: which browser, and how to wait."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

playwright_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect, sync_playwright = playwright_api.expect, playwright_api.sync_playwright

SCREENSHOTS = Path(__file__).resolve().parents[2] / "screenshots"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
CHROMIUM = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, BROWSERS)), None)
SECOND = 1000  # ms, the unit of playwright's timeouts
POLLING = 100  # ms; playwright's default, to look at every frame that is drawn, keeps the processor busy
STATE = "element => element.explorer.state()"
NO_CHROMIUM = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium found; set CHROMIUM to its path")


def launch(playwright):
    """Chromium, for which no address but this machine's resolves, so nothing can be fetched unseen."""
    options = ["--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
    if getattr(os, "geteuid", lambda: 1)() == 0:
        options.append("--no-sandbox")  # which root cannot use
    return playwright.chromium.launch(executable_path=CHROMIUM, args=options)


# What JupyterLab says on a busy machine when a kernel ends before its debugger has answered.
NOISE = "Could not restore the debugger state"


def listen(page, *allowed):
    """Collect in `page.complaints` what goes wrong behind the scenes. allowed : beginnings of addresses."""
    page.complaints = []
    page.on("pageerror", lambda error: page.complaints.append(f"error in the page: {error}"))
    page.on("console", lambda line: line.type == "error" and not line.text.startswith(NOISE)
            and page.complaints.append(f"console: {line.text}"))
    page.on("request", lambda request: request.url.startswith((*allowed, "data:", "blob:"))
            or page.complaints.append(f"request: {request.url}"))


_FOLDERS = {  # of a Jupyter that knows nothing of the user's own
    "JUPYTER_CONFIG_DIR": "config",
    "JUPYTER_DATA_DIR": "data",
    "JUPYTER_RUNTIME_DIR": "runtime",
    "JUPYTERLAB_SETTINGS_DIR": "settings",
    "JUPYTERLAB_WORKSPACES_DIR": "workspaces",
    "IPYTHONDIR": "ipython",
}


@contextlib.contextmanager
def jupyter(module, home, *options, root=None):
    """Address of a Jupyter server with settings of its own, below `home`; it serves `root`, or home/notebooks."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address, log = f"http://127.0.0.1:{port}", home / "server.log"
    command = [
        sys.executable, "-m", module, "--no-browser", "--allow-root", "--ip=127.0.0.1", f"--port={port}",
        "--ServerApp.port_retries=0", f"--ServerApp.root_dir={root or home / 'notebooks'}", "--IdentityProvider.token=",
        *options,
    ]
    environment = os.environ | {name: str(home / folder) for name, folder in _FOLDERS.items()}
    with log.open("w") as out, subprocess.Popen(command, env=environment, stdout=out, stderr=out) as server:
        try:
            _wait_for(address, server, log)
            yield address
        finally:
            server.terminate()


def _wait_for(address, server, log, seconds=60):
    """Until a Jupyter server answers; the test fails with its log when it does not."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and server.poll() is None:
        with contextlib.suppress(OSError), urllib.request.urlopen(f"{address}/api/status", timeout=1):
            return
        time.sleep(0.1)
    pytest.fail(f"Jupyter did not start:\n{log.read_text()}")


def violations(page, within="html"):
    """What axe finds in a part of a page against WCAG 2.1, levels A and AA: rule, what it says, first element."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    found = axe.Axe().run(page, context={"include": [within], "exclude": ["mjx-container"]}, options={
        "runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"], "resultTypes": ["violations"]})
    return [(rule["id"], rule["help"], rule["nodes"][0]["html"]) for rule in found.response["violations"]]


def wait_until(page, condition, message, seconds=15):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, message
        page.wait_for_timeout(50)
