"""A short slice of `python tests/fuzz.py`, which runs thousands of such cases."""

import fuzz
import pytest


@pytest.mark.parametrize("kind", fuzz.KINDS)
def test_what_is_damaged_ends_well_or_in_one_line(kind):
    few = {"study": 5, "tiny": 2, "names": 2}  # these filter, draw and write
    found = [fuzz.problem_of(kind, seed) for seed in range(10_000, 10_000 + few.get(kind, 12))]
    assert [problem for problem in found if problem] == []


@pytest.mark.parametrize(("kind", "seed"), [("numpy", 494), ("pickle", 953)])
def test_cases_that_once_failed(kind, seed):
    assert fuzz.problem_of(kind, seed) == ""
