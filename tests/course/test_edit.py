"""A wrong function is an edit of a right one."""

import numpy as np
import pytest

from vislam_edu import kalman
from vislam_edu.course.checks.edit import diff, edited
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.error_state import RightInvariant


class Base:
    def value(self):
        return 2


class Derived(Base):
    def value(self, further=3):
        """Twice the value of the class above, and more."""
        return 2 * super().value() + further


def test_an_edit_of_a_function_keeps_its_globals():
    P, H, V = np.diag([4.0, 9.0]), np.eye(2), np.eye(2)
    wrong = edited(kalman.innovation_covariance, ("+ V", "- V"))
    np.testing.assert_allclose(wrong(P, H, V), kalman.innovation_covariance(P, H, V) - 2 * V)


def test_an_edit_of_a_method_keeps_super_and_defaults():
    wrong = edited(Derived.value, ("2 * super", "5 * super"))
    assert (Derived().value(), wrong(Derived())) == (7, 13)
    assert edited(RightInvariant.retract).__code__.co_varnames == RightInvariant.retract.__code__.co_varnames


@pytest.mark.parametrize("old", ["value", "no such text"])
def test_an_edit_matches_exactly_once(old):
    with pytest.raises(ValueError, match="times in its source, not once"):
        edited(Derived.value, (old, "x"))


def test_the_diff_shows_the_wrong_line_and_the_right_one():
    assert diff(Derived.value, ("2 * super", "5 * super")).splitlines() == [
        " def value(self, further=3):", "-    return 5 * super().value() + further",
        "+    return 2 * super().value() + further"]


@pytest.mark.parametrize("name", EXERCISES)
def test_every_edit_of_an_exercise_applies_and_changes_its_plain_answer(name):
    exercise = EXERCISES[name]
    for mistake in exercise.mistakes:
        assert callable(mistake.function)
        assert diff(mistake.base, *mistake.edits)
