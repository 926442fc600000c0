"""Running notebooks: outputs are stored, a second run changes no byte, and what goes wrong is named."""

import base64
import io
import re

import matplotlib.pyplot as plt
import nbformat
import pytest
from nbformat import v4
from PIL import Image, PngImagePlugin

import notebooks

CELLS = [
    v4.new_markdown_cell("# A notebook"),
    v4.new_code_cell("from pathlib import Path\n\nimport ipywidgets\nimport matplotlib.pyplot as plt"),
    v4.new_code_cell("print(Path.cwd().name)\nprint('second line')"),
    v4.new_code_cell("figure, axes = plt.subplots(figsize=(2, 1))"),
    v4.new_code_cell("ipywidgets.IntSlider(3)"),
    v4.new_code_cell("ipywidgets.IntSlider(4)", metadata={
        "tags": ["kept"], "nbgrader": {"grade": True},
        "execution": {"iopub.execute_input": "2020"}, "collapsed": True,
    }),
]


def write(path, cells):
    path.parent.mkdir(exist_ok=True)
    notebook = v4.new_notebook(cells=cells, metadata={"widgets": {"state": {}}, "kernelspec": {
        "display_name": "someone's own", "language": "python", "name": "someones_own"}})
    nbformat.write(notebook, path)
    return path


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    path = write(tmp_path_factory.mktemp("execute") / "folder" / "notebook.ipynb", CELLS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MPLBACKEND", "agg")       # would keep the figure out of the outputs
        assert notebooks.main([str(path)]) == 0
    return path


def cells(path):
    return nbformat.read(path, as_version=4).cells


def outputs(path, cell):
    return cells(path)[cell].outputs


def test_outputs_are_stored_and_the_notebook_runs_in_its_folder(executed):
    assert [output.text for output in outputs(executed, 2)] == ["folder\nsecond line\n"]
    assert [cell.execution_count for cell in cells(executed)[1:]] == [1, 2, 3, 4, 5]


def test_a_second_run_changes_nothing(executed, capsys):
    before = executed.read_bytes()
    assert notebooks.main(["--check", str(executed)]) == 0
    assert notebooks.main([str(executed)]) == 0
    assert executed.read_bytes() == before
    assert [file.name for file in executed.parent.iterdir()] == ["notebook.ipynb"]


def test_only_what_an_author_wrote_stays_in_the_metadata(executed):
    notebook = nbformat.read(executed, as_version=4)
    assert notebook.metadata == {"kernelspec": notebooks.KERNELSPEC, "language_info": {"name": "python"}}
    assert [cell.metadata for cell in notebook.cells[:-1]] == [{}] * 5
    assert notebook.cells[-1].metadata == {"tags": ["kept"], "nbgrader": {"grade": True}}
    assert [cell.id for cell in notebook.cells] == [cell.id for cell in CELLS]


def test_widget_ids_are_numbered_in_order_of_appearance(executed):
    ids = [outputs(executed, cell)[0].data[notebooks.WIDGET_VIEW]["model_id"] for cell in (4, 5)]
    assert ids == [f"{0:032x}", f"{1:032x}"]


def test_the_stored_figure_does_not_name_the_program_that_drew_it(executed):
    [figure] = outputs(executed, 3)
    png = base64.b64decode(figure.data["image/png"])
    assert "Software" not in Image.open(io.BytesIO(png)).info


def test_removing_text_chunks_keeps_every_pixel():
    figure = plt.figure(figsize=(1, 1))
    figure.add_subplot().plot([0, 1], [1, 0])
    drawn = io.BytesIO()
    figure.savefig(drawn)
    plt.close(figure)
    comments = PngImagePlugin.PngInfo()
    comments.add_text("Comment", "plain")
    comments.add_itxt("Comment", "international")
    comments.add_text("Comment", "compressed", zip=True)
    commented = io.BytesIO()
    Image.open(drawn).save(commented, "png", pnginfo=comments, dpi=(100, 100))

    stripped = Image.open(io.BytesIO(notebooks.without_text_chunks(commented.getvalue())))
    assert Image.open(commented).text != {}
    assert stripped.text == {}
    assert stripped.tobytes() == Image.open(commented).tobytes()
    assert "dpi" in stripped.info


def test_check_names_the_first_cell_that_differs_and_writes_nothing(executed, tmp_path, capsys):
    path = tmp_path / "folder" / executed.name
    path.parent.mkdir()
    path.write_text(executed.read_text().replace("second line\\n\"", "another line\\n\""))
    before = path.read_bytes()
    assert notebooks.main(["--check", str(path)]) == 1
    assert path.read_bytes() == before
    report = capsys.readouterr().out
    assert f"{path}: cell 3 (print(Path.cwd().name)): outputs: stored" in report
    assert re.search("stored .*another line.*, now .*second line", report)


def test_a_failing_cell_is_named_and_the_other_notebooks_still_run(tmp_path, capsys):
    fails = write(tmp_path / "fails.ipynb", [v4.new_code_cell("x = 1"), v4.new_code_cell("1 / 0")])
    works = write(tmp_path / "works.ipynb", [v4.new_code_cell("print('ran')")])
    before = fails.read_bytes()
    assert notebooks.main(["--timings", str(fails), str(works)]) == 1
    assert fails.read_bytes() == before
    assert outputs(works, 0)[0].text == "ran\n"
    report = capsys.readouterr().out
    assert f"failed: {fails}: cell 2 (1 / 0): ZeroDivisionError: division by zero" in report
    assert "s  works.ipynb" in report


def test_a_dead_kernel_and_a_timeout_name_their_cell(tmp_path, monkeypatch):
    dies = write(tmp_path / "dies.ipynb", [v4.new_code_cell("import os\nos._exit(1)")])
    with pytest.raises(notebooks.NotebookError, match=r"dies.ipynb: cell 1 \(import os\): the kernel died"):
        notebooks.execute(dies)
    monkeypatch.setattr(notebooks, "CELL_TIMEOUT", 1)
    sleeps = write(tmp_path / "sleeps.ipynb", [v4.new_code_cell("import time\ntime.sleep(60)")])
    with pytest.raises(notebooks.NotebookError, match=r"cell 1 \(import time\): still running after 1 s"):
        notebooks.execute(sleeps)


@pytest.mark.parametrize("content", ["not json", '{"nbformat": 4}', None], ids=["text", "empty", "missing"])
def test_an_unreadable_notebook_is_named(tmp_path, capsys, content):
    path = tmp_path / "broken.ipynb"
    if content is not None:
        path.write_text(content)
    assert notebooks.main([str(path)]) == 1
    assert f"failed: {path}: not a readable notebook" in capsys.readouterr().out


def test_nothing_to_run_and_a_missing_package_are_said_plainly(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(notebooks, "NOTEBOOKS", tmp_path)
    assert notebooks.main([]) == 2
    assert f"no notebooks in {tmp_path}" in capsys.readouterr().err
    monkeypatch.setattr(notebooks.importlib.util, "find_spec", lambda name: name != "nbclient" or None)
    assert notebooks.main(["any.ipynb"]) == 2
    assert "nbclient is needed to run notebooks: python -m pip install" in capsys.readouterr().err
