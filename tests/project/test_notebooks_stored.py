"""What is stored in the notebooks: nbval compares only what is there, so a missing output would pass."""

import ast
import base64
import re
from pathlib import Path

import nbformat
import pytest
from nbconvert import HTMLExporter
from nbformat import v4
from picture_checks import GITHUB

from vislam_edu.plots.text import PAGE

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
PNG = {"image/png": "iVBORw0KGgo="}
LARGEST = 3_000_000  # bytes
MACHINE_PATH = re.compile(r"/home/|/Users/|/root/|/tmp/|site-packages|\b[A-Z]:\\{1,2}(?:Users|Program)")
PICTURES = {"image/png", "image/jpeg"}
WIDGET = "application/vnd.jupyter.widget-view+json"


def problems(notebook):
    """What is wrong with a stored notebook, each with its cell."""
    found = ["widget state in the metadata"] if "widgets" in notebook.metadata else []
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    if not code or not has_import(code[0]):
        found.append("the first code cell holds no imports")
    for number, cell in enumerate(notebook.cells, 1):
        wrong = [f"{what} on someone's machine" for what in machine_paths(cell)]
        if cell.cell_type == "code":
            wrong += code_cell_problems(cell)
        found += [f"cell {number}: {problem}" for problem in wrong]
    return found


def code_cell_problems(cell):
    if cell.source.strip() and cell.execution_count is None:
        yield "never run (no execution_count): nbval would not compare it"
    if cell.source.rstrip().endswith(";"):
        yield "ends in a semicolon, which nbval does not honour: assign the value instead"
    for output in cell.outputs:
        if output.output_type == "error":
            yield f"stored error: {output.ename}"
        if output.get("name") == "stderr":
            yield "stored stderr"
        if (longest := max(map(len, output.get("text", "").splitlines()), default=0)) > PAGE:
            yield f"a printed line of {longest} characters, where JupyterLab shows little more than {PAGE}"
        yield from picture_problems(output)


def picture_problems(output):
    """What a reader without a kernel, or without eyes for it, would miss of an output."""
    data = output.get("data", {})
    if WIDGET in data and "image/png" not in data:
        yield "a widget without a still picture"
    for mime in PICTURES & data.keys():
        if not output.metadata.get(mime, {}).get("alt"):
            yield "a picture without alternative text"
    if data.get("text/plain", "").startswith("<Figure") and "image/png" not in data:
        yield "a figure without its picture: the first code cell calls style.use()"
    elif data.get("text/plain", "").startswith("<Figure") and (width := png_width(data["image/png"])) > GITHUB:
        yield f"a figure {width} px wide, which GitHub shrinks to {GITHUB} px, and its lettering with it"


def png_width(base64_png):
    return int.from_bytes(base64.b64decode(base64_png[:32])[16:20])  # of the header, which comes first in the file


def has_import(cell):
    return any(isinstance(line, ast.Import | ast.ImportFrom) for line in ast.parse(cell.source).body)


def machine_paths(cell):
    texts = [cell.source]
    for output in cell.get("outputs", []):
        texts += [str(output.get("text", "")), *output.get("traceback", [])]
        texts += [str(data) for mime, data in output.get("data", {}).items() if mime not in PICTURES]
    text = "\n".join(texts)
    return set(MACHINE_PATH.findall(text)) | ({str(ROOT)} if str(ROOT) in text else set())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_notebook(path):
    assert problems(nbformat.read(path, as_version=4)) == []
    assert path.stat().st_size < LARGEST


@pytest.mark.parametrize(("page", "entry"), [("README.md", r"\n\| \[(\d\w+)\]\(notebooks/"),
                                             ("docs/index.md", r"\nnotebooks/(\w+)"),
                                             ("docs/instructor.md", r"\n\| (\d\db?) ")])
def test_a_page_lists_every_notebook_in_order(page, entry):
    text = (ROOT / page).read_text(encoding="utf-8").partition("\n## Eight weeks")[0]
    words = 1 if "instructor" in page else None  # its table of hours begins with the number
    assert re.findall(entry, text) == ["_".join(path.stem.split("_")[:words]) for path in NOTEBOOKS]


LINK_TO_A_FILE = re.compile(r"\]\((?!https?:|#)([^)#]+)[^)]*\)")
FETCHED = re.compile(r"!\[[^\]]*\]\(\s*https?:|\bsrc\s*=\s*[\"']?https?:")  # by whoever opens the page


@pytest.mark.parametrize("path", [*NOTEBOOKS, *sorted((ROOT / "docs").glob("*.md"))], ids=lambda path: path.stem)
def test_a_link_leads_to_a_file_and_nothing_is_fetched(path):
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        cells = nbformat.reads(text, as_version=4).cells
        text = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    assert [link for link in LINK_TO_A_FILE.findall(text) if not (path.parent / link).exists()] == []
    assert FETCHED.findall(text) == []


NOTE = re.compile(r"^\*(\[Report\]\(00_start_here\.ipynb\)|Report), [^*]+:\*", re.MULTILINE)


@pytest.mark.parametrize("path", NOTEBOOKS[1:], ids=lambda path: path.stem)
def test_the_first_note_on_the_report_of_a_chapter_says_what_that_is(path):
    notes = NOTE.findall("\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells))
    assert ["[" in note for note in notes] == [True] * bool(notes) + [False] * (len(notes) - 1)


QUOTE = re.compile(r"\[\d\db?\]\(\.\./notebooks/(\w+\.ipynb)\): `([^`]+)`")
QUOTES = QUOTE.findall((ROOT / "docs/instructor.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("notebook", "quoted"), QUOTES)
def test_the_instructors_page_quotes_what_a_notebook_prints(notebook, quoted):
    cells = nbformat.read(ROOT / "notebooks" / notebook, as_version=4).cells
    printed = " ".join(output.get("text", "") for cell in cells for output in cell.get("outputs", []))
    assert quoted in " ".join(printed.split())


def test_every_question_of_the_instructors_page_is_decided_by_a_quote():
    questions = (ROOT / "docs/instructor.md").read_text(encoding="utf-8").split("## Questions for peer instruction")[1]
    rows = questions.split("\n## ")[0].count("\n| ") - 1  # less the heading
    assert rows == len(QUOTES) > 0


# A hat over the vectors whose skew or twist matrix the chapters use; their estimates have other names (mu, T). A
# position has both: \hat p is its estimate, unless it is multiplied by what turns.
HAT_AS_MATRIX = re.compile(r"\\(?:wide)?hat\s*\{?\s*(?:\\(?:phi|xi|epsilon|omega|theta|Delta|delta(?:\\psi|_R))"
                           r"|[suv](?![a-z])|x_R|\(|p\}?\s*(?:\\[,;]\s*)?(?:R|\\theta|x_R))")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_hat_is_an_estimate_and_a_wedge_a_matrix(path):
    sources = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells)
    assert HAT_AS_MATRIX.findall(sources) == []


@pytest.mark.parametrize("formula", [r"\hat\epsilon", r"\hat u_k", r"\widehat{\delta\psi}", r"\hat{v}", r"\hat p R",
                                     r"\hat x_R", r"\widehat{(m-p)}", r"\hat p\,x_R", r"\hat \delta_R"])
def test_a_hat_over_a_vector_of_a_matrix_is_found(formula):
    assert HAT_AS_MATRIX.search(formula)
    assert not HAT_AS_MATRIX.search(r"\hat m_j, \epsilon^\wedge, \hat{T}, (\hat m - \hat p), \hat p + J_l")


def sound():
    run = {"execution_count": 1}
    return v4.new_notebook(cells=[
        v4.new_markdown_cell("# $\\mathbf{T}$ and I:\\mathbb{R}"),
        v4.new_code_cell("import numpy as np", **run),
        v4.new_code_cell("print('a')", **run, outputs=[v4.new_output("stream", name="stdout", text="a\n")]),
        v4.new_code_cell("1", **run, outputs=[described_picture()]),
        v4.new_code_cell(""),
    ])


def described_picture():
    return v4.new_output("display_data", data=PNG, metadata={"image/png": {"alt": 'x < "3"'}})


def spoil(**changes):
    """A sound notebook with changes to its last cell that prints."""
    notebook = sound()
    notebook.cells[2].update(changes)
    return notebook


def printing(text, name="stdout"):
    return spoil(outputs=[v4.new_output("stream", name=name, text=text)])


def test_a_sound_notebook_passes():
    assert problems(sound()) == []


ERROR = v4.new_output("error", ename="KeyError", evalue="", traceback=[])
LINK = v4.new_output("display_data", data={"text/html": "<a href='/Users/ann'>"})
WIDE = base64.b64encode(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + (831).to_bytes(4) + bytes(8)).decode()
FIGURE = v4.new_output("execute_result", data={"text/plain": "<Figure size", "image/png": WIDE},
                       metadata={"image/png": {"alt": "a line"}})
BARE = v4.new_output("execute_result", data={"text/plain": "<Figure size"})
SPOILED = {
    "never run": (spoil(execution_count=None), "never run"),
    "semicolon": (spoil(source="ax.plot(x);"), "semicolon"),
    "error": (spoil(outputs=[ERROR]), "stored error: KeyError"),
    "stderr": (printing("warning", name="stderr"), "stored stderr"),
    "widget": (spoil(outputs=[v4.new_output("display_data", data={WIDGET: {}})]), "without a still"),
    "picture": (spoil(outputs=[v4.new_output("display_data", data=PNG)]), "without alternative text"),
    "wide figure": (spoil(outputs=[FIGURE]), "831 px wide"),
    "no picture": (spoil(outputs=[BARE]), "style.use()"),
    "long line": (printing("short\n" + 101 * "x"), "a printed line of 101"),
    "path in stdout": (printing("saved /home/ann/x.png"), "/home/"),
    "path on Windows": (printing("saved C:\\Users\\ann"), "C:\\Users"),
    "path in html": (spoil(outputs=[LINK]), "/Users/"),
    "path in the source": (spoil(source="load('/tmp/x.npz')"), "/tmp/"),
}


@pytest.mark.parametrize("name", SPOILED)
def test_each_problem_is_found_in_its_cell(name):
    notebook, problem = SPOILED[name]
    [found] = problems(notebook)
    assert found.startswith("cell 3: ")
    assert problem in found


def test_the_path_of_this_project_is_found():
    assert any(str(ROOT) in problem for problem in problems(printing(f"saved {ROOT}/results")))


def test_widget_state_and_a_first_cell_without_imports_are_found():
    notebook = sound()
    notebook.metadata["widgets"] = {}
    del notebook.cells[1]
    assert problems(notebook) == ["widget state in the metadata", "the first code cell holds no imports"]
    assert problems(v4.new_notebook()) == ["the first code cell holds no imports"]


def test_nbconvert_gives_a_screen_reader_the_alternative_text():
    """Its template "classic" does; "lab", its default, does not read this metadata."""
    html, _ = HTMLExporter(template_name="classic").from_notebook_node(sound())
    assert re.findall("<img[^>]*>", html) == ["""<img alt='x &lt; "3"' src="data:image/png;base64,iVBORw0KGgo="/>"""]
