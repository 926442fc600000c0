"""The explorer and a panel in front ends other than JupyterLab, each skipped where it is not installed.

    python -m pip install notebook nbclassic voila && python -m pytest -n 0 tests/browser/test_front_ends.py

Passed with Notebook 7.6.5, nbclassic 1.3.3 and Voila 0.5.13.
"""

import importlib.util

import nbformat
import pytest
from browser import NO_CHROMIUM, POLLING, SCREENSHOTS, SECOND, STATE, jupyter, wait_until
from test_browser import KERNEL_READY, PICTURE, run_all, widgets

pytestmark = NO_CHROMIUM


def run_notebook_7(page):
    page.wait_for_function(KERNEL_READY, polling=POLLING, timeout=60 * SECOND)
    run_all(page)


def run_nbclassic(page):
    page.wait_for_function("() => window.Jupyter?.notebook?.kernel?.is_connected()", polling=POLLING,
                           timeout=60 * SECOND)
    page.evaluate("() => Jupyter.notebook.execute_all_cells()")


def run_voila(page):
    """It runs a notebook before it shows it."""


FRONT_ENDS = {  # module: where it shows a notebook, and how all of it is run
    "notebook": ("notebooks/a.ipynb", run_notebook_7),
    "nbclassic": ("nbclassic/notebooks/a.ipynb", run_nbclassic),
    "voila": ("voila/render/a.ipynb", run_voila),
}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Address of a Jupyter server, which loads whatever front ends are installed."""
    home = tmp_path_factory.mktemp("front_ends")
    (home / "notebooks").mkdir()
    nbformat.write(widgets(), home / "notebooks" / "a.ipynb")
    with jupyter("jupyter_server", home, "--JupyterNotebookApp.expose_app_in_browser=True") as address:
        yield address


def installed(front_end):
    missing = importlib.util.find_spec(front_end) is None
    return pytest.param(front_end, marks=pytest.mark.skipif(missing, reason=f"{front_end} is not installed"))


@pytest.mark.parametrize("front_end", [installed(name) for name in FRONT_ENDS])
def test_a_front_end_drives_the_explorer_and_a_panel(front_end, chromium, server):
    path, run = FRONT_ENDS[front_end]
    page = chromium.new_page(viewport={"width": 1366, "height": 900})
    errors = []
    page.on("pageerror", lambda error: errors.append(error.stack))
    page.goto(f"{server}/{path}", timeout=60 * SECOND)
    run(page)
    page.wait_for_selector(".vx canvas", timeout=60 * SECOND)
    page.wait_for_function("() => document.querySelector('.vx').explorer.state().map.length", polling=POLLING)
    SCREENSHOTS.mkdir(exist_ok=True)
    try:
        keys_step_the_explorer(page)
        the_kernel_sends_it_another_run(page)
        page.screenshot(path=SCREENSHOTS / f"{front_end}_explorer.png")
        a_panel_draws_again(page)
    finally:
        page.screenshot(path=SCREENSHOTS / f"{front_end}_panel.png")
        page.close()
    # The widgets' modules are loaded from blobs; what a front end has to complain of by itself is not tested here.
    assert [error for error in errors if "blob:" in error] == []


def keys_step_the_explorer(page):
    """Its slider and its canvases keep the arrow keys, with which a notebook goes from cell to cell."""
    explorer = page.locator(".vx")
    explorer.locator("input[type=range]").focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    assert explorer.evaluate(STATE)["i"] == 16
    explorer.get_by_role("img", name="map").first.focus()
    for _ in range(2):
        page.keyboard.press("ArrowUp")
    assert explorer.evaluate(STATE)["i"] == 18


def the_kernel_sends_it_another_run(page):
    explorer = page.locator(".vx")
    before = explorer.evaluate(STATE)["time"]["high"]
    assert before[0] == before[1]
    page.get_by_label("V ×").focus()
    page.keyboard.press("End")
    wait_until(page, lambda: explorer.evaluate(STATE)["time"]["high"][1] > 1.5 * before[1], "no other run came")
    after = explorer.evaluate(STATE)
    assert (after["i"], after["time"]["high"][0]) == (18, before[0])


def a_panel_draws_again(page):
    image, slider = page.locator("img.widget-image"), page.get_by_label("depth (m)")
    slider.scroll_into_view_if_needed()
    slider.focus()
    shown = image.evaluate(PICTURE)
    page.keyboard.press("End")
    wait_until(page, lambda: image.evaluate(PICTURE) != shown, "the picture did not follow")
