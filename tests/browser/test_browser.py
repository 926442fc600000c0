"""Every notebook in JupyterLab and a real browser: its cells run, sliders work, nothing leaves this machine.

Of a notebook only the cells with a slider or an explorer are shown and run, with what they need of the cells above
them: the others hold text and still pictures, which `--nbval` compares without a browser, in a new kernel for each
notebook; here one kernel serves all. Three notebooks have a panel and an explorer of each kind between them;
VISLAM_EDU_WHOLE=1 takes every notebook, and shows and runs all cells.

Needs Chromium (or Chrome; set CHROMIUM to its path if it is not found). Screenshots are left in screenshots/.
"""

import dis
import json
import shutil
from pathlib import Path
from types import CodeType

import nbformat
import pytest
from browser import NO_CHROMIUM, POLLING, SCREENSHOTS, SECOND, STATE, expect, jupyter, listen, violations, wait_until
from whole import WHOLE

from notebooks import WIDGET_VIEW

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = [path for path in sorted((ROOT / "notebooks").glob("*.ipynb"))
             if WHOLE or path.stem[:2] in ("03", "05", "10")]
pytestmark = NO_CHROMIUM

# The notebook's own indicator says idle before the kernel exists, and what is run then is lost.
KERNEL_READY = """() => {
    const session = window.jupyterapp?.shell?.currentWidget?.context?.sessionContext;
    const kernel = session?.session?.kernel;
    return session?.isReady && kernel?.connectionStatus === 'connected' && kernel.status === 'idle';
}"""
RESTORED = "() => window.jupyterapp?.restored.then(() => true)"
# The kernel that the first notebook starts serves the others too: to import what all of them import takes longer than
# most cells.
OPEN = """async name => {
    await window.jupyterapp.commands.execute(
        'docmanager:open', {path: name, factory: 'Notebook', kernel: window.firstKernel});
}"""
CLOSE_ALL = """async () => {
    for (const tab of [...window.jupyterapp.shell.widgets('main')]) {
        window.firstKernel ??= tab.context?.sessionContext.session?.kernel?.model;
        tab.dispose();
    }
}"""
# JupyterLab shows an exception's traceback as stderr.
FAILED_OUTPUT = '[data-mime-type$="jupyter.stderr"], [data-mime-type$="jupyter.error"]'
ALL_RAN_OR_ONE_FAILED = """failed =>
    document.querySelector(failed) !== null ||
    [...document.querySelectorAll('.jp-CodeCell')].every(cell =>
        cell.querySelector('.cm-content').textContent.trim() === '' ||
        /^\\[\\d+\\]:$/.test(cell.querySelector('.jp-InputPrompt').textContent.trim()))"""
PICTURE = """async image => {
    const hash = await crypto.subtle.digest('SHA-256', await (await fetch(image.src)).arrayBuffer());
    return String.fromCharCode(...new Uint8Array(hash));
}"""
SETTINGS = {
    "apputils-extension/notification": {"fetchNews": "false", "checkForUpdates": False},
    "docmanager-extension/plugin": {"autosave": False},
    "notebook-extension/tracker": {"windowingMode": "none"},    # or cells out of view are not in the page
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Address of a JupyterLab with its own settings that serves copies of the notebooks, see `copy_notebooks`."""
    home = tmp_path_factory.mktemp("lab")
    copy_notebooks(home / "notebooks")
    nbformat.write(pictures(), home / "notebooks" / "pictures.ipynb")
    nbformat.write(widgets(), home / "notebooks" / "widgets.ipynb")
    shutil.copytree(ROOT / "benchmarks" / "results", home / "benchmarks" / "results")  # stored studies they read
    for plugin, values in SETTINGS.items():
        file = home / "settings" / "@jupyterlab" / f"{plugin}.jupyterlab-settings"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(values))
    alt = f"--LabApp.extra_labextensions_path={ROOT / 'docs' / 'labextensions'}"
    with jupyter("jupyterlab", home, "--LabApp.expose_app_in_browser=True", alt) as address:
        yield address


def pictures():
    """A notebook with two stored pictures, one with an alternative text."""
    dot = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
    outputs = [nbformat.v4.new_output("display_data", {"image/png": dot}, metadata={"image/png": metadata})
               for metadata in ({"alt": 'Depth < 40 m, "far".', "width": 30}, {})]
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1", outputs=outputs)], metadata={
        "kernelspec": {"name": "python3", "display_name": "Python 3"}})


def widgets():
    """A notebook with an explorer that has controls, and a panel."""
    sources = ("from vislam_edu import Noise, simulate\n"
               "from vislam_edu.course.ch02.panel import StereoDepthPicture\n"
               "from vislam_edu.course.ch05.panel import WhatIf\n"
               "from vislam_edu.widgets import Panel",
               "WhatIf(simulate.first_steps().slice(0, 12), Noise(), start=5)", "Panel(StereoDepthPicture())")
    return nbformat.v4.new_notebook(cells=list(map(nbformat.v4.new_code_cell, sources)), metadata={
        "kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}})


def copy_notebooks(folder):
    """Copies without outputs, of the needed cells alone; since they share a kernel, each begins by emptying it."""
    shutil.copytree(ROOT / "notebooks", folder, ignore=shutil.ignore_patterns(".*"))
    for path in folder.glob("*.ipynb"):
        notebook = nbformat.read(path, as_version=4)
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
        if not WHOLE:
            notebook.cells = needed(code)
        for cell in code:
            cell.outputs, cell.execution_count = [], None
        code[0].source = "%reset -f\n" + code[0].source
        nbformat.write(notebook, path)


def needed(code):
    """The first of these cells, those where something moves, and going up each that binds a name that those read."""
    kept, missing = [], set()
    for cell in reversed(code):
        bound, read = names(cell.source)
        if cell is code[0] or missing & bound or any(WIDGET_VIEW in out.get("data", {}) for out in cell.outputs):
            kept.insert(0, cell)
            missing = missing - bound | read
    return kept


def names(source):
    """Names that a cell binds, and those that it or its functions read before it does."""
    bound, read, codes = set(), set(), [compile(source, "cell", "exec")]
    for code in codes:
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
        for step in dis.get_instructions(code):
            if step.opname == "STORE_NAME":
                bound.add(step.argval)
            elif step.opname in ("LOAD_NAME", "LOAD_GLOBAL") and step.argval not in bound:
                read.add(step.argval)
    return bound, read


@pytest.fixture(scope="module")
def jupyterlab(chromium, lab):
    """A page with the application, which notebook after notebook is opened in: loading it takes longer than most run.

    It remembers in `complaints` what went wrong behind the scenes.
    """
    page = chromium.new_page(viewport={"width": 1300, "height": 950})
    listen(page, lab)
    page.goto(f"{lab}/lab?reset")
    page.wait_for_function(RESTORED, timeout=60 * SECOND)
    return page


@pytest.fixture
def page(jupyterlab, notebook):
    """The application with nothing open. What the test leaves open is closed, and all of that without a complaint."""
    yield jupyterlab
    SCREENSHOTS.mkdir(exist_ok=True)
    jupyterlab.screenshot(path=SCREENSHOTS / f"{notebook.stem}.png")
    jupyterlab.keyboard.press("Escape")  # a dialog that a failure left would cover the next notebook
    jupyterlab.evaluate(CLOSE_ALL)
    complaints, jupyterlab.complaints = jupyterlab.complaints, []
    assert complaints == []


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_in_the_browser(notebook, page):
    open_notebook(page, notebook.name)
    run_all(page)
    assert failures(page) == []
    slider = page.locator(".jp-OutputArea-output:has(img.widget-image) :is(input, select)").first
    if slider.count():
        step_by_keyboard(page, slider)
        is_sharp_and_fits(slider)
    for explorer in page.locator(".vx").all():
        explore(page, explorer)
    assert failures(page) == []


@pytest.mark.parametrize("notebook", [Path("pictures.ipynb")], ids=str)
def test_a_screen_reader_finds_the_stored_alternative_texts(notebook, page):
    open_notebook(page, notebook.name)
    picture = page.get_by_role("img", name='Depth < 40 m, "far".', exact=True)
    expect(picture).to_have_count(1)
    assert picture.evaluate("image => [image.naturalWidth, image.width]") == [1, 30]
    assert page.locator(".jp-RenderedImage img").evaluate_all("images => images.map(image => image.alt)")[1:] == [""]


@pytest.mark.parametrize("notebook", [Path("widgets.ipynb")], ids=str)
def test_axe_finds_no_violation(notebook, page):
    open_notebook(page, notebook.name)
    run_all(page)
    page.wait_for_selector(".vx canvas")
    page.wait_for_selector("img.widget-image")
    assert violations(page, ".jp-OutputArea-output") == []


def open_notebook(page, name):
    page.evaluate(OPEN, name)
    page.wait_for_selector(".jp-Notebook .jp-Cell", timeout=60 * SECOND)
    page.wait_for_function(KERNEL_READY, polling=POLLING, timeout=30 * SECOND)


def run_all(page):
    page.get_by_role("menuitem", name="Run", exact=True).click()
    page.get_by_role("menuitem", name="Run All Cells", exact=True).click()
    page.wait_for_function(ALL_RAN_OR_ONE_FAILED, arg=FAILED_OUTPUT, polling=POLLING, timeout=120 * SECOND)


def failures(page):
    """Texts of all outputs that a reader would take for a failure."""
    broken = page.get_by_text("Error displaying widget")
    return page.locator(FAILED_OUTPUT).all_text_contents() + broken.all_text_contents()


def output_of(slider):
    return slider.locator("xpath=ancestor::*[contains(@class, 'jp-OutputArea-output')][1]")


def step_by_keyboard(page, slider):
    """A step forth shows another picture, a step back the first one again.

    One key at a time: each is answered by one picture, so the first that differs is the one to stay. A picture may
    keep what it has been asked (chapter 09 collects the points of a curve), so the way is gone twice.
    """
    image = output_of(slider).locator("img.widget-image").first
    image.scroll_into_view_if_needed()
    expect(image).to_be_visible()
    at_end = slider.evaluate("input => input.value === input.max")
    forth, back = ("ArrowLeft", "ArrowRight") if at_end else ("ArrowRight", "ArrowLeft")
    slider.focus()
    shown = image.evaluate(PICTURE)
    for key in (forth, back, forth):
        page.keyboard.press(key)
        wait_until(page, lambda before=shown: image.evaluate(PICTURE) != before, "the picture did not follow")
        before, shown = shown, image.evaluate(PICTURE)
    page.keyboard.press(back)
    wait_until(page, lambda: image.evaluate(PICTURE) == before, "going back did not restore the picture")


def is_sharp_and_fits(slider):
    """Two pixels of the picture for one of the page, and with its controls at most as high as JupyterLab's window."""
    image = output_of(slider).locator("img.widget-image").first
    assert image.evaluate("image => image.naturalWidth / image.clientWidth") >= 1.9
    assert output_of(slider).evaluate("output => output.clientHeight") <= 700


def explore(page, explorer):
    """Keys move the explorer and not the notebook; the kernel learns where it stands."""
    explorer.scroll_into_view_if_needed()
    before = explorer.evaluate(STATE)
    forth, back = ("ArrowLeft", "ArrowRight") if before["i"] >= 3 else ("ArrowRight", "ArrowLeft")
    explorer.locator("input[type=range]").focus()
    cell = page.evaluate("() => window.jupyterapp.shell.currentWidget.content.activeCellIndex")
    for _ in range(3):
        page.keyboard.press(forth)
    moved = explorer.evaluate(STATE)
    assert abs(moved["i"] - before["i"]) == 3
    assert moved["map"][0]["pose"] != before["map"][0]["pose"]
    for _ in range(3):
        page.keyboard.press(back)
    assert explorer.evaluate(STATE) == before
    assert page.evaluate("() => window.jupyterapp.shell.currentWidget.content.activeCellIndex") == cell
