"""The inputs of an exercise tell a right answer from one with a small change: its mutants are refused.

Mutants are those of `checks.mutants`, and each constant and each comparison changed. Those that give the right
result on every input that the statement allows are listed with the reason.
"""

import ast
import copy
import re
from functools import cache

import numpy as np
import pytest

from vislam_edu.course.checks.edit import plain_source
from vislam_edu.course.checks.explain import same
from vislam_edu.course.checks.mutants import mutants
from vislam_edu.course.checks.running import arrays, copied, outcome_of
from vislam_edu.course.exercises import EXERCISES

SIGNS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)

# Words of mutants that are no mistakes, and why: in every exercise, and in one.
NO_CHANGE = {
    r"transposed|only the diagonal|halves of": "of vectors, of three columns or of a symmetric matrix: as before",
    r"\+= .* in place of .* = ": "what stood there is zero",
    r"in `len\(|in place of `(landmarks|covariance|residual|e|d|z)`$": "only its length is taken",
    r"square (root )?of `(np.eye|d > 0|\(np.abs)|np.eye.*inverted": "ones and zeros are their own roots and squares",
    r"\b3 -> -3 in|\b[12] -> -[12] in .*(K\[|axis|q\[2)": "the same index counted from the end",
    r"sign of .*\*\* 2|sign of `t` reversed in `np.cos|np.abs` of": "no sign is left",
    r"1 -> 2 in .*reshape|`2` in place of `1`": "reshape takes any negative number",
    r"`np.sqrt\(rate\)`|`covariance` in place of `P`|`_v_right` in": "another word for the same",
}
SMALL = "a turn below 1e-6 rad counts for none: many right answers take it so"
TWICE = "the factor comes twice or is divided by itself: its sign, or its size, cancels"
RAY = "a ray has no length and no sign"
SYMMETRIC = "with a symmetric matrix it is the same number"
EQUIVALENT = {
    "so3_exp": {r"1e-06|`(np.eye\(3\) - )?S`|of `S`": SMALL, r"of `phi` reversed": TWICE},
    "se3_exp": {r"1e-06|S / 2|of `2`|of `S`": SMALL, r"of `omega` reversed": TWICE},
    "left_jacobian": {r"30 ->": "the series has converged", r"X @ term": "powers of one matrix commute"},
    "predict_covariance": {r"sign of `(se3.adjoint|tau|se3.right)": TWICE},
    "datasheet_noise": {r"sign of|1 -> -1": TWICE},
    "triangulate_bearings": {r"bearing|`K`|z2|`-R`": RAY, r"b @ a": SYMMETRIC},
    "triangulation_covariance": {r"sign of `K": TWICE},
    "project": {r"np.stack": RAY, r"`2` in place of `0`": "K[2, 2] of K_s is K[0, 2]: both cameras have one centre"},
    "kalman_update": {r"K @ H - np|sign of `np.eye": TWICE},
    "nees": {r"sign of `errors": TWICE, r"@": SYMMETRIC},
    "axis_signs": {r">= 0.5": "no correlation is exactly 0.5", r"corrcoef": SYMMETRIC + "; without a unit",
                   r"sign of `r`|np.sign": TWICE},
    "whiteness": {r"innovations": TWICE},
    "schur": {r"@ np.linalg.inv": SYMMETRIC},
    "joint_nis": {r"sign of": TWICE, r"d @": SYMMETRIC, r"inv\(S\) @ d": SYMMETRIC},
    "merge_ids": {r"min\(b, a\)": SYMMETRIC},
    "curved_mean": {r"C\[2, \d\]|`covariance` in": SYMMETRIC},
    "row_check": {r"v_right - v_left|sign of": TWICE, r"< tolerance": "the statement leaves the very border open"},
    "rectify_point": {r"sign of|twice|length": RAY},
    "rotation_bias_jacobian": {r"3 -> 1": "one row of zeros is as good as three"},
    "project_track": {r"H_f": "the sign and the size of H_f do not change its null space"},
}


def changed_numbers(function):
    """(words, function) for each constant and each comparison of the function changed in each usual way."""
    source = plain_source(function)
    tree = ast.parse(source)
    for place, node in enumerate(ast.walk(tree)):
        new: list[ast.expr] = []
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            c = node.value
            half = c // 2 if isinstance(c, int) else c / 2
            new = [ast.Constant(value) for value in {2 * c, half, c + 1, c - 1, -c} - {c}]
        elif isinstance(node, ast.Compare):
            others = [sign() for sign in SIGNS if sign is not type(node.ops[0])]
            new = [ast.Compare(node.left, [sign], node.comparators) for sign in others]
        for other in new:
            mutant = copy.deepcopy(tree)
            vars(list(ast.walk(mutant))[place]).update(vars(other))
            scope = dict(function.__globals__)
            exec(compile(ast.fix_missing_locations(mutant), "<changed>", "exec"), scope)
            line = source.splitlines()[node.lineno - 1].strip()
            yield f"{ast.unparse(node)} -> {ast.unparse(other)} in `{line}`", scope[function.__name__]


@cache
def survivors(exercise):
    """Words of the mutants that the inputs of an exercise do not tell from its plain answers."""
    cases = exercise.inputs()
    expected = [arrays(exercise.expected(*map(copied, arguments)), exercise.outputs)[0] for _, arguments in cases]
    accepted: list[str] = []
    found = [one for answer in exercise.answers for one in changed_numbers(answer)]
    found += [(words, function) for words, function, _ in mutants(exercise.name)]
    for words, function in found:
        with np.errstate(all="ignore"):
            outcomes = (outcome_of(exercise, function, arguments) for _, arguments in cases)
            if all(all(same(exercise, outcome, should)) and not outcome.changed
                   for outcome, should in zip(outcomes, expected)):
                accepted.append(words)
    return accepted


@pytest.mark.parametrize("name", [name for name in EXERCISES if not name.startswith("filter_")])
def test_mutants_of_the_plain_answers_are_refused(name):
    reasons = NO_CHANGE | EQUIVALENT.get(name, {})
    assert [words for words in survivors(EXERCISES[name]) if not any(re.search(text, words) for text in reasons)] == []


@pytest.mark.parametrize("name", EQUIVALENT)
def test_the_listed_mutants_are_there(name):
    words = survivors(EXERCISES[name])
    for text in EQUIVALENT[name]:
        assert any(re.search(text, one) for one in words)


@pytest.mark.parametrize("name", EXERCISES)
def test_every_number_among_the_arguments_changes(name):
    """Else an answer may hold the number itself."""
    for argument, *values in zip(EXERCISES[name].arguments, *(arguments for _, arguments in EXERCISES[name].inputs())):
        if isinstance(values[0], int | float):
            assert len(set(values)) > 1, argument
