"""The plans for instructors add up: their hours are those of the chapters that they name."""

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "instructor.md").read_text(encoding="utf-8")


def table(heading):
    """The cells of the rows below a heading, without the two that name the columns."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


HOURS = {row[0].split()[0]: sum(float(cell) for cell in row[1:3] if cell) for row in table("Hours")}
TIME = re.compile(r"\*\*Time\*\*: ([\d.]+) hours?(?:, and ([\d.]+) more)?")


@pytest.mark.parametrize(("plan", "said"), [("Eight weeks", 44.5), ("Fourteen weeks", 61)])
def test_a_plan_has_the_hours_of_its_chapters(plan, said):
    rows = table(plan)
    named = {chapter for row in rows for chapter in re.findall(r"\b\d\db?\b", row[1])}
    assert sum(float(row[2]) for row in rows) == sum(HOURS[chapter] for chapter in named) == said
    assert max(float(row[2]) for row in rows) <= 7
    assert f"{said}" in PAGE.partition(f"## {plan}")[2].partition("|")[0]


@pytest.mark.parametrize("chapter", sorted(HOURS.keys() - {"13", "14"}))  # those say it by stage and by patient
def test_a_chapter_states_the_hours_of_the_table(chapter):
    [path] = (Path(__file__).parents[2] / "notebooks").glob(f"{chapter}_*.ipynb")
    assert sum(float(hours) for hours in TIME.search(path.read_text(encoding="utf-8")).groups("0")) == HOURS[chapter]
