"""The inputs of an exercise tell a right answer from one with a small change: mutants of its plain answers are refused.

A mutant has one constant, comparison, operator, name or statement changed. Those that give the right result on every
input that the statement allows are listed with the reason.
"""

import ast
import re
from functools import cache

import numpy as np
import pytest

from vislam_edu.course.checks.comparing import differs
from vislam_edu.course.checks.edit import plain_source
from vislam_edu.course.checks.running import copied, outcome_of, read
from vislam_edu.course.exercises import EXERCISES

COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
OTHER = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.MatMult: ast.Mult}

# Mutants that are no mistakes, and why: in every exercise, and in one.
NO_CHANGE = {
    r"\b3 -> -3 in|\b([12]) -> -\1 in .*(K\[|axis|q\[2|0, 1\])": "the same index counted from the end",
    r"^\w+ -> \w+ in `.*\blen\(": "only its length is taken",
    r"1 -> 2 in .*reshape": "reshape takes any negative number",
}
SMALL = "a turn below 1e-6 rad counts for none: many right answers take it so"
TWICE = "the sign comes twice and cancels"
SYMMETRIC = "the same for a symmetric matrix"
SAME = "another name for the same numbers"
EQUIVALENT = {
    "so3_exp": {r"1e-6|in `return np.eye\(3\) \+ S`": SMALL},
    "se3_exp": {r"1e-6|in `V = np.eye\(3\) \+ S / 2`": SMALL},
    "left_jacobian": {"^30 ->": "the series has converged", "X @ term": "powers of one matrix commute"},
    "datasheet_noise": {"^1 -> -1": TWICE},
    "triangulate_bearings": {"b @ a": SYMMETRIC, "^-R -> R": "the second depth is not asked for"},
    "triangulate": {"_v_right": SAME},
    "kalman_update": {"-> K @ H - np": TWICE},
    "predict_joint": {"covariance -> P": "that block has not been written yet"},
    "nees": {r"np.linalg.inv\(P\)": SYMMETRIC},
    "invariant_jacobian": {"J -> H_landmark": "only its shape is taken"},
    "axis_signs": {">= 0.5": "no correlation is exactly 0.5"},
    "whiteness": {"^innovations -": TWICE},
    "schur": {"np.linalg.inv": SYMMETRIC},
    "pair_covariance": {"P -> covariance": SAME},
    "joint_nis": {r"^d @ np.linalg.inv\(S\)": SYMMETRIC},
    "curved_mean": {"C -> covariance": SAME},
    "row_check": {"v_right - v_left": TWICE, "< tolerance": "the statement leaves the border itself open"},
    "rotation_bias_jacobian": {"^3 -> 1": "one row of zeros is as good as three"},
}


def changes(node, names):
    """What else may stand in the place of a node."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        c = node.value
        half = c // 2 if isinstance(c, int) else c / 2
        yield from (ast.Constant(value) for value in {2 * c, half, c + 1, c - 1, -c} - {c})
    elif isinstance(node, ast.Compare):
        yield from (ast.Compare(node.left, [sign()], node.comparators) for sign in COMPARISONS
                    if sign is not type(node.ops[0]))
    elif isinstance(node, ast.BinOp) and type(node.op) in OTHER:
        yield from (node.left, node.right, ast.BinOp(node.left, OTHER[type(node.op)](), node.right))
        if isinstance(node.op, ast.MatMult | ast.Sub) and ast.dump(node.left) != ast.dump(node.right):
            yield ast.BinOp(node.right, node.op, node.left)
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in names:
        yield from (ast.Name(name, ast.Load()) for name in names if name != node.id)
    elif isinstance(node, ast.Name) and node.id in ("min", "max"):
        yield ast.Name("min" if node.id == "max" else "max", ast.Load())
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.Attribute) and node.attr == "T":
        yield node.value
    elif isinstance(node, ast.If):
        yield from (ast.If(ast.Constant(taken), node.body, node.orelse) for taken in (True, False))
    elif isinstance(node, ast.AugAssign) or isinstance(getattr(node, "targets", [None])[0], ast.Subscript):
        yield ast.Pass()


def mutants(function):
    """(words, function) of each."""
    source = plain_source(function)
    tree = ast.parse(source)
    nodes = list(ast.walk(tree))
    names = {node.arg for node in nodes if isinstance(node, ast.arg)} | {
        node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    for node in nodes:
        for new in changes(node, sorted(names)):
            words = f"{ast.unparse(node)} -> {ast.unparse(new)} in `{source.splitlines()[node.lineno - 1].strip()}`"
            old = type(node), vars(node)
            node.__class__, node.__dict__ = type(new), vars(new) | {"lineno": 1, "col_offset": 0}
            code = compile(ast.fix_missing_locations(tree), "<mutant>", "exec")
            node.__class__, node.__dict__ = old
            scope = dict(function.__globals__)
            exec(code, scope)
            yield words, scope[function.__name__]


@cache
def accepted(name):
    """Words of the mutants that the inputs of an exercise do not tell from its plain answers."""
    exercise = EXERCISES[name]
    cases = exercise.inputs()
    expected = [read(exercise.expected(*map(copied, arguments)), exercise.outputs)[0] for _, arguments in cases]

    def right(function):
        for (_, arguments), should in zip(cases, expected):
            outcome = outcome_of(exercise, function, arguments)
            if outcome.values is None or outcome.changed or differs(exercise, outcome, should):
                return False
        return True

    with np.errstate(all="ignore"):
        return [words for answer in exercise.answers for words, function in mutants(answer) if right(function)]


@pytest.mark.parametrize("name", [name for name in EXERCISES if not name.startswith("filter_")])
def test_the_inputs_tell_the_plain_answers_from_their_mutants(name):
    listed = EQUIVALENT.get(name, {})
    passed = [words for words in accepted(name) if not any(re.search(text, words) for text in NO_CHANGE | listed)]
    assert passed == [], "add inputs that tell these from the answer, or, where none can, the reason to EQUIVALENT"
    assert all(any(re.search(text, words) for words in accepted(name)) for text in listed)


@pytest.mark.parametrize("name", EXERCISES)
def test_every_number_among_the_arguments_changes(name):
    """Else an answer may hold the number itself."""
    for argument, *values in zip(EXERCISES[name].arguments, *(arguments for _, arguments in EXERCISES[name].inputs())):
        if isinstance(values[0], int | float):
            assert len(set(values)) > 1, argument
