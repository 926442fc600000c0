"""From key to picture: python benchmarks/explorer.py [--page-only]

The explorer of chapter 05 (two runs of 130 half-steps) in a plain page and in JupyterLab, in real Chromium:
milliseconds from a key press to the frame that shows it, median and worst of 50 presses, and bytes sent per explorer.
Also the milliseconds that the kernel needs for one picture of each panel. Prints, and writes
benchmarks/results/explorer.json. Needs playwright and Chromium (CHROMIUM names it if it is not found). Run it on a
quiet machine.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: the matrices are too small to share among threads

import argparse
import contextlib
import gzip
import json
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import nbformat
import numpy as np

from vislam_edu import simulate, window_slam
from vislam_edu.course.ch01.panel import TwistPicture
from vislam_edu.course.ch02.panel import StereoDepthPicture
from vislam_edu.course.ch10 import broken_filters
from vislam_edu.noise import Noise
from vislam_edu.widgets import Explorer, Panel

RESULTS = Path(__file__).with_name("results") / "explorer.json"
PRESSES = 50
CELL = """from vislam_edu import simulate, window_slam
from vislam_edu.noise import Noise
from vislam_edu.course.ch10 import broken_filters
from vislam_edu.widgets import Explorer

drive, noise = simulate.first_steps(), Noise()
blind = broken_filters.without_cross_covariance
runs = {"joint": window_slam.run(drive, noise), "blind": window_slam.run(drive, noise, process_frame=blind)}
Explorer(runs, drive, show=0, start=10)"""
# A key event carries the time at which the browser got it. The first task after the next frame's callbacks runs when
# that frame has been painted.
LISTEN = """() => { window.times = []; addEventListener('keydown', event => requestAnimationFrame(() => {
    const channel = new MessageChannel();
    channel.port1.onmessage = () => window.times.push(performance.now() - event.timeStamp);
    channel.port2.postMessage(0); }), true); }"""


def key_to_paint(page) -> list[float]:
    """Milliseconds of each of `PRESSES` presses of an arrow key, one at a time."""
    page.locator(".vx input[type=range]").first.focus()
    for _ in range(5):  # the browser compiles what it runs often
        page.keyboard.press("ArrowRight")
    page.evaluate(LISTEN)
    for _ in range(PRESSES):
        page.keyboard.press("ArrowRight")
        page.wait_for_timeout(60)
    return page.evaluate("() => window.times")


def in_a_page(browser, explorer) -> list[float]:
    """In a saved page without a kernel."""
    with tempfile.TemporaryDirectory() as folder:
        page = browser.new_page(viewport={"width": 1100, "height": 760})
        page.goto(explorer.save_html(Path(folder) / "page.html").as_uri())
        page.wait_for_selector(".vx canvas")
        return key_to_paint(page)


def in_jupyterlab(browser) -> list[float]:
    """In JupyterLab at 1366 x 768, with a kernel that learns of every step."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        home = Path(folder)
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)], metadata={
            "kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}})
        nbformat.write(notebook, home / "a.ipynb")
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        names = ("CONFIG", "DATA", "RUNTIME")
        environment = os.environ | {f"JUPYTER_{name}_DIR": str(home / name) for name in names}
        environment |= {"JUPYTERLAB_SETTINGS_DIR": str(home / "s"), "JUPYTERLAB_WORKSPACES_DIR": str(home / "w")}
        server = stack.enter_context(subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--ip=127.0.0.1", f"--port={port}",
             f"--ServerApp.root_dir={home}", "--IdentityProvider.token="],
            env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
        stack.callback(server.terminate)
        address = f"http://127.0.0.1:{port}"
        for _ in range(300):
            with contextlib.suppress(OSError), urllib.request.urlopen(f"{address}/api/status", timeout=1):
                break
            time.sleep(0.2)
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.goto(f"{address}/lab/tree/a.ipynb?reset")
        page.wait_for_selector(".jp-CodeCell .cm-content", timeout=60_000)
        page.wait_for_timeout(4000)  # the kernel's indicator says idle before there is one
        page.locator(".jp-CodeCell .cm-content").first.click()
        page.keyboard.press("Shift+Enter")
        page.wait_for_selector(".vx canvas", timeout=60_000)
        page.wait_for_timeout(3000)
        return key_to_paint(page)


def panel_ms(panel, name) -> float:
    """Median CPU milliseconds of a picture while one slider is pulled from end to end."""
    control, times = panel.controls[name], []
    for value in np.linspace(control.control.low, control.control.high, 30):
        begin = time.process_time()
        control.value = value
        times.append(1e3 * (time.process_time() - begin))
    return float(np.median(times))


def main():
    """Print the figures and store them; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page-only", action="store_true", help="leave JupyterLab out")
    only_page = parser.parse_args().page_only
    from playwright.sync_api import sync_playwright

    drive, noise = simulate.first_steps(), Noise()
    blind = broken_filters.without_cross_covariance
    explorer = Explorer({"joint": window_slam.run(drive, noise),
                         "blind": window_slam.run(drive, noise, process_frame=blind)}, drive, show=0, start=10)
    sent = json.dumps(explorer.header).encode() + explorer.data
    figures = {"explorer_bytes": len(sent), "explorer_gzip_bytes": len(gzip.compress(sent, mtime=0))}
    executable = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        places = {"page": lambda: in_a_page(browser, explorer)}
        if not only_page:
            places["jupyterlab"] = lambda: in_jupyterlab(browser)
        for place, measure in places.items():
            times = measure()
            figures[place] = {"presses": len(times), "key_to_paint_ms": round(float(np.median(times)), 1),
                              "key_to_paint_worst_ms": round(max(times), 1)}
        browser.close()
    figures["panel_ms"] = {"01 twist": round(panel_ms(Panel(TwistPicture()), "omega_z"), 1),
                           "02 stereo depth": round(panel_ms(Panel(StereoDepthPicture()), "depth"), 1)}
    print(json.dumps(figures, indent=2))
    RESULTS.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
