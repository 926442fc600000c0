"""The package does not grow unnoticed, and is counted in the evenings in which README has it read."""

import re
from pathlib import Path

import lines

README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")


def test_neither_floor_has_more_lines_than_it_may():
    found = lines.parts()
    for floor, most in lines.MOST.items():
        assert found[floor][0] <= most, f"{floor}: let something go, or say in tools/lines.py why it may grow"


def test_the_evenings_are_those_of_the_readme():
    evenings = {name: tuple(re.findall(r"`(\w+)`", names)) for name, names in
                re.findall(r"(first evening|second evening): ((?:`\w+`(?:, )?)+)", README)}
    assert evenings == {"first evening": lines.FIRST, "second evening": lines.SECOND}
