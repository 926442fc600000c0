"""The web pages: `python -m sphinx -b html docs OUT`, offline, from the stored notebooks.

The notebooks are copied into docs/notebooks with their stored outputs. Those with an explorer are run once more, each
explorer is saved as a page of its own, and takes the place of its still picture. `-D live=05_vi_slam` runs only that
one (a comma separates several), `-D live=` none.
"""

import shutil
import tempfile
import tomllib
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_output

import vislam_edu
from vislam_edu.course.guesses import GUESSED

HERE = Path(__file__).resolve().parent
SERIES, COPIES, PAGES = HERE.parent / "notebooks", HERE / "notebooks", HERE / "_live" / "explorers"

project, author, release = "vislam_edu", "vislam_edu contributors", vislam_edu.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx-mathjax-offline"]
(HERE / "_live").mkdir(exist_ok=True)  # Sphinx leaves out a folder that is not there when it begins
urls = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]
html_theme_options = {
    "footer_icons": [{"name": "Repository", "url": urls["Repository"], "html": "Repository", "class": ""}]}
html_theme, html_title = "furo", "vislam_edu: visual-inertial SLAM"
html_static_path, html_css_files, html_extra_path = ["_static"], ["site.css"], ["_live"]
html_js_files = [("site.js", {"defer": "defer"})]
exclude_patterns = ["_live"]
nb_execution_mode = "off"
nb_mime_priority_overrides = [("html", "text/html", 1), ("html", "image/png", 2)]  # not the empty view of a widget
nb_code_prompt_show, nb_code_prompt_hide = "Guess first, then show the result", "Hide the result"
myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 2
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings give shapes; ArrayLike would be expanded into eight types
suppress_warnings = ["misc.highlighting_failure", "myst.header", "myst.xref_missing"]


def is_explorer(output):
    return output.get("data", {}).get("text/plain", "").startswith("Explorer(")


def live_pages(path, notebook):
    """Run a notebook up to its last explorer and save each as a page; returns {cell id: file name}."""
    saved, run = {}, nbformat.from_dict(notebook)
    cells = []
    for cell in run.cells:
        cells.append(cell)
        if any(is_explorer(output) for output in cell.get("outputs", [])):
            saved[cell.id] = f"{path.stem}-{cell.id}.html"
            cells.append(new_code_cell(f"Out[max(Out)].save_html({str(PAGES / saved[cell.id])!r})"))
            run.cells = cells[:]  # nothing below the last explorer
    if saved:
        PAGES.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder:  # nothing that a cell writes may end up beside the notebooks
            NotebookClient(run, timeout=300, resources={"metadata": {"path": folder}}).execute()
    return saved


def frame(file, alt):
    """An output that shows a saved explorer."""
    return new_output("display_data", {"text/html": (
        f'<iframe src="../explorers/{file}" title="{alt}" loading="lazy" style="width:100%; height:720px; '
        f'border:0"></iframe><p><a href="../explorers/{file}">The explorer on a page of its own</a></p>')})


def prepare(app):
    """Copy the notebooks: explorers live, guessed results folded, every picture with its output's alternative text."""
    shutil.rmtree(COPIES, ignore_errors=True)
    shutil.copytree(SERIES / "images", COPIES / "images")
    wanted = None if app.config.live == "all" else app.config.live.split(",")
    for path in sorted(SERIES.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        saved = live_pages(path, notebook) if wanted is None or path.stem in wanted else {}
        for cell in notebook.cells:
            if GUESSED in (tags := cell.metadata.get("tags", [])):
                tags.append("hide-output")
            for k, output in enumerate(cell.get("outputs", [])):
                alt = output.get("metadata", {}).get("image/png", {}).get("alt")
                if alt:
                    cell.metadata.setdefault("mystnb", {})["image"] = {"alt": alt}
                if cell.get("id") in saved and is_explorer(output):
                    cell.outputs[k] = frame(saved[cell.id], (alt or "explorer").replace('"', "'"))
        nbformat.write(notebook, COPIES / path.name)


def as_it_is(app, what, name, obj, options, lines):
    """Docstrings are plain text made to be read in an editor: shown as they are, not as reStructuredText."""
    lines[:] = [".. code-block:: text", "", *(f"    {line}" for line in lines), ""]


def setup(app):
    app.add_config_value("live", "all", "env", str)
    app.connect("builder-inited", prepare)
    app.connect("autodoc-process-docstring", as_it_is)
