"""Results that a reader guesses first are out of sight until asked for, and guesses are kept."""

import json
import re
from pathlib import Path

import nbformat
import pytest

from vislam_edu.course import guesses
from vislam_edu.course.cli import start

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
PROMPT = re.compile(r"^> .*\?|\b[Gg]uess\b", re.MULTILINE)
# Prompts that the cell after them does not answer: an explorer or panel to step through, a rule of the chapter.
ANSWERED_BY_HAND = {
    "00": {"claims-note", "how"}, "01": {"euler-note"}, "05": {"napkin-drive-after", "stepper-after"},
    "07": {"watch", "H"},
    "13": {"stage-update", "score-text", "extensions"}, "14": {"first-read"}, "10": {"camera"},
}


def read(path):
    return json.loads(path.read_text(encoding="utf-8"))


def guessed(cell):
    return guesses.GUESSED in cell["metadata"].get("tags", ())


@pytest.fixture
def somebody(monkeypatch, tmp_path):
    """A reader in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(guesses, "can_answer", lambda: True)
    monkeypatch.setattr(guesses, "COMPARED", {})
    return tmp_path / guesses.FILE


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_a_prompt_asks_for_is_a_guessed_result(path):
    cells = read(path)["cells"]
    for place, cell in enumerate(cells):
        if cell["cell_type"] == "markdown" and PROMPT.search("".join(cell["source"])) and "exercises" not in cell["id"]:
            after = [c for c in cells[place + 1:] if c["cell_type"] == "code" and "guess(" not in "".join(c["source"])]
            assert cell["id"] in ANSWERED_BY_HAND.get(path.stem[:2], ()) or guessed(after[0]), cell["id"]


def test_no_guessed_result_is_on_screen_in_a_started_notebook(tmp_path):
    start.copy_notebooks(tmp_path)
    tags = 0
    for path in NOTEBOOKS:
        stored, started = (read(each)["cells"] for each in (path, tmp_path / "notebooks" / path.name))
        assert [cell["source"] for cell in started] == [cell["source"] for cell in stored]
        for old, new in zip(stored, started):
            assert new.get("outputs") == ([] if guessed(old) else old.get("outputs")), f"{path.name}: {old['id']}"
        tags += sum(map(guessed, stored))
    assert tags > 20


def test_the_copy_is_a_valid_notebook_and_the_original_keeps_its_results(tmp_path):
    notebook = nbformat.read(NOTEBOOKS[0], as_version=4)
    before = json.dumps(notebook)
    nbformat.validate(guesses.without_guessed_outputs(notebook))
    assert json.dumps(notebook) == before


def test_a_guess_is_kept_shown_beside_the_value_and_replaced_by_the_next(somebody, capsys):
    asked = guesses.Guess("How far?", "m")
    asked.compare(3.14159)
    assert capsys.readouterr().out == ""
    guesses.field(asked).value = " 10 m"
    guesses.field(guesses.Guess("Why?")).value = "a sign"
    asked.compare(3.14159)
    guesses.Guess("Why?").compare("a missing minus")
    assert capsys.readouterr().out == "Your guess: 10 m. Here: 3.1 m.\nYour guess: a sign. Here: a missing minus.\n"
    assert guesses.field(asked).value == "10"
    guesses.field(asked).value = "2"
    assert json.loads(somebody.read_text(encoding="utf-8")) == {"How far?": "2", "Why?": "a sign"}


def test_the_guesses_of_a_chapter_stand_together_at_its_end(somebody, capsys):
    near, far, unanswered = (guesses.Guess(question, "m") for question in ("How near?", "How far?", "How deep?"))
    near.keep("1")
    far.keep("10")
    for asked, value in ((far, 3.0), (near, 0.5), (unanswered, 7.0), (far, 4.0)):
        asked.compare(value)
    capsys.readouterr()
    guesses.your_guesses()
    assert capsys.readouterr().out == ("How far?\n    Your guess: 10 m. Here: 4 m.\n"
                                       "How near?\n    Your guess: 1 m. Here: 0.5 m.\n")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_chapter_that_asks_ends_with_all_guesses(path):
    code = ["".join(cell["source"]) for cell in read(path)["cells"] if cell["cell_type"] == "code"]
    asks = [place for place, source in enumerate(code) if re.search(r"(?<!capstone)\.compare\(", source)]
    ends = [place for place, source in enumerate(code) if "your_guesses()" in source]
    assert not asks or (len(ends) == 1 and ends[0] > asks[-1])


@pytest.mark.parametrize("text", ["{", "[]", '{"a": 1}', "\0"])
def test_another_file_of_this_name_is_named(somebody, text):
    somebody.write_text(text)
    with pytest.raises(ValueError, match=r"guesses\.json: not a file of guesses; rename or delete it"):
        guesses.Guess("How far?").keep("1")
    assert somebody.read_text() == text


@pytest.mark.parametrize(("allowed", "asked"), [(True, 1), (False, 0), (None, 0)])
def test_it_asks_only_where_the_notebook_takes_input(monkeypatch, tmp_path, allowed, asked):
    class Kernel:
        def get_parent(self, channel):
            return {"shell": {"content": {"allow_stdin": allowed}}}[channel]

    class Shell:
        kernel = Kernel()

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("IPython.get_ipython", lambda: None if allowed is None else Shell())
    shown = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    assert guesses.guess("How far?", "m") == guesses.Guess("How far?", "m")
    assert len(shown) == asked
