"""Mutants: a plain answer with one small change, the kind of change that a slip makes.

The change is made in the syntax tree of the answer. Each mutant comes with words for it that finish the sentence
"your result is what one gets ...".
"""

import ast
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ... import kalman, se3, stereo
from .edit import plain_source
from .exercise import find

_SCOPE = {"np": np, "kalman": kalman, "se3": se3, "stereo": stereo}  # what a change may name

# Functions that are easily taken for each other.
_TWINS = [("np.sin", "np.cos"), ("np.log", "np.log10"), ("chi2.ppf", "chi2.cdf"), ("np.zeros", "np.eye"),
          ("se3.left_jacobian", "se3.right_jacobian"), ("se3.so3_left_jacobian", "se3.so3_right_jacobian"),
          ("camera.cam_T_imu", "camera.imu_T_cam"), ("min", "max")]
_IN_PLACE_OF = {twin: other for pair in _TWINS for twin, other in (pair, pair[::-1])}
# What else people write for an expression; X and Y stand for its arguments.
_REWRITTEN = {
    "np.linalg.inv": ["1 / X", "np.linalg.inv(np.diag(np.diag(X)))", "X.T"], "se3.exp": ["np.eye(4) + se3.hat(X)"],
    "se3.so3_exp": ["np.eye(3) + se3.so3_hat(X)", "np.eye(3)"], "np.linalg.solve": ["X @ Y"],
    "np.diag": ["np.eye(len(X))"], "np.eye": ["np.ones((X, X))"], "se3.inverse": ["np.linalg.inv(X).T"],
    "se3.so3_left_jacobian": ["np.eye(3)"], "se3.left_jacobian": ["np.eye(6)"], "se3.right_jacobian": ["np.eye(6)"],
    "se3.adjoint": ["np.eye(6)", "se3.adjoint(se3.inverse(X))", "se3.adjoint(X).T"], "se3.so3_hat": ["np.diag(X)"],
}


@functools.cache
def mutants(name: str) -> tuple[tuple[str, Callable, int], ...]:
    """(words, function, kind) of each mutant of the plain answers to an exercise, the commonest kinds first."""
    found = []
    for answer in find(name).answers:
        tree = ast.parse(plain_source(answer))
        for change in _changes(tree):
            found.append((change.words, _changed(tree, change, answer.__globals__), change.kind))
    return tuple(sorted(found, key=lambda mutant: mutant[2]))


@dataclass(frozen=True, eq=False)
class _Change:
    """A new node for one place of a tree; kind : how common such a slip is, 0 the commonest."""

    parent: ast.AST
    field: str
    index: int | None
    kind: int
    words: str
    new: ast.AST

    @property
    def place(self):
        return id(self.parent), self.field, self.index

    def swap(self, node):
        """Put a node there and return the one that it replaces."""
        holder: Any = vars(self.parent) if self.index is None else getattr(self.parent, self.field)
        key = self.field if self.index is None else self.index
        old, holder[key] = holder[key], node
        return old


def _changed(tree, change, scope) -> Callable:
    """The function with this change; the tree itself stays as it is."""
    old = change.swap(change.new)
    try:
        made: dict[str, Any] = {}
        exec(compile(tree, "<changed>", "exec"), _SCOPE | scope, made)
        return made[tree.body[0].name]
    finally:
        change.swap(old)


# --- where, and into what ---------------------------------------------------------------------------------

def _changes(tree) -> list[_Change]:
    function = tree.body[0]
    names = _names(function)
    fixed = {id(part) for node in ast.walk(tree) if _is_fixed(node) for part in ast.walk(node)}
    found = []
    for parent in ast.walk(tree):
        for field, value in ast.iter_fields(parent):
            for index, node in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if id(node) in fixed or node is function:
                    continue
                if isinstance(node, ast.stmt):
                    changes = _of_statement(node)
                elif isinstance(node, ast.expr) and not isinstance(node, ast.Slice) and \
                        isinstance(getattr(node, "ctx", ast.Load()), ast.Load):
                    changes = _of_expression(node, parent, names)
                else:
                    continue
                found += [_Change(parent, field, index, kind, words, ast.fix_missing_locations(new))
                          for kind, words, new in changes]
    return found


def _is_fixed(node) -> bool:
    """What is left alone: how often a loop runs (it might never end) and how large an array is."""
    return isinstance(node, ast.comprehension) or (isinstance(node, ast.Call) and ast.unparse(node.func) in (
        "range", "zip", "enumerate", "np.zeros", "np.arange")) or (isinstance(node, ast.Subscript) and \
        ast.unparse(node.value) == "np.r_")


def _names(function) -> list[str]:
    """The arguments and the variables."""
    stored = {node.id: None for node in ast.walk(function) if isinstance(node, ast.Name)
              and isinstance(node.ctx, ast.Store)}
    return [argument.arg for argument in function.args.args] + list(stored)


def _of_statement(node) -> Iterator[tuple[int, str, ast.AST]]:
    text = ast.unparse(node)
    if isinstance(node, ast.If):
        test = ast.unparse(node.test)
        yield 1, f"without the case `if {test}`", ast.Pass()
        yield 3, f"with the case `if {test}` taken always", ast.If(ast.Constant(True), node.body, [])
    if isinstance(node, ast.AugAssign):
        yield 1, f"without `{text}`", ast.Pass()
        for sign, words in (("-=", ast.Sub()), ("*=", ast.Mult())):
            yield 0, _instead(text, text.replace("+=", sign)), ast.AugAssign(node.target, words, node.value)
        yield 3, _instead(text, text.replace("+=", "=")), _statement(text.replace("+=", "="))
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript):
        target, value = text.split(" = ")
        yield 1, f"without `{text}`", ast.Pass()
        yield 3, _instead(text, f"{target} += {value}"), _statement(f"{target} += {value}")
    if isinstance(node, ast.Expr) and ".append(" in text:
        yield 3, f"without `{text}`", ast.Pass()
    if isinstance(node, ast.For):
        yield 3, f"with the loop `for {ast.unparse(node.target)} in ...` left after its first pass", ast.For(
            node.target, node.iter, [*node.body, ast.Break()], [])


def _of_expression(node, parent, names) -> Iterator[tuple[int, str, ast.AST]]:
    text = ast.unparse(node)

    def instead(new: str, kind: int):
        return kind, _instead(text, new), _expression(new)

    if isinstance(node, ast.BinOp):
        yield from _of_operation(node, text)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield 0, f"with the minus of `{text}` forgotten", node.operand
    elif isinstance(node, ast.Compare):
        left, right = ast.unparse(node.left), ast.unparse(node.comparators[0])
        for sign in (">", ">=", "<", "!="):
            if f"{left} {sign} {right}" != text:
                yield instead(f"{left} {sign} {right}", 4)
        yield 4, f"with `{text}` always true", _expression(f"({left} == {left}) | True")
    elif isinstance(node, ast.Call):
        yield from _of_call(node, text)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(parent, ast.Slice):
        yield from (instead(repr(new), 5) for new in {0, 1, 2, node.value + 1, node.value - 1, 0.95} - {node.value})
    elif isinstance(node, ast.Subscript):
        yield from _of_subscript(node, text)
    if isinstance(node, ast.Attribute):
        if node.attr == "T":
            yield 2, f"with the transpose of `{ast.unparse(node.value)}` forgotten in " \
                f"`{ast.unparse(parent)}`", node.value
        if text in _IN_PLACE_OF:
            yield instead(_IN_PLACE_OF[text], 4)
    if isinstance(node, ast.Name) and node.id in names and not isinstance(parent, ast.Attribute):
        yield from (instead(other, 6) for other in names if other != node.id)
    if _is_a_quantity(node, parent):
        where = "" if isinstance(parent, ast.Assign | ast.Return | ast.Tuple) else f" in `{ast.unparse(parent)}`"
        yield 0, f"with the sign of `{text}` reversed{where}", _expression(f"-({text})")
        yield 2, f"with `{text}` transposed{where}", _expression(f"({text}).T")
        yield 5, f"with only the diagonal of `{text}`{where}", _expression(f"np.diag(np.diag({text}))")
        yield 5, f"with `{text}` inverted{where}", _expression(f"np.linalg.inv({text})")
        yield 5, f"with twice `{text}`{where}", _expression(f"2 * ({text})")
        yield 5, f"with zero in place of `{text}`{where}", _expression(f"0 * ({text})")
        yield 5, f"with the two halves of `{text}` exchanged{where}", _expression(f"np.roll({text}, 3, axis=-1)")
    if isinstance(parent, ast.Assign | ast.Return) and not isinstance(node, ast.Tuple):
        yield 5, f"with the square root of `{text}`", _expression(f"np.sqrt({text})")
        yield 5, f"with `{text}` divided by its length", _expression(f"({text}) / np.linalg.norm({text})")


def _is_a_quantity(node, parent) -> bool:
    """An operand, an argument, or the whole of what is stored or returned; no index, no name of a module."""
    if isinstance(node, ast.Constant | ast.Tuple | ast.List | ast.Slice | ast.UnaryOp | ast.Compare):
        return False
    if isinstance(node, ast.Name | ast.Attribute) and ast.unparse(node).startswith(("np", "se3", "len", "stereo")):
        return False
    return isinstance(parent, ast.BinOp | ast.Call | ast.Assign | ast.Return | ast.Tuple | ast.List) and \
        node is not getattr(parent, "func", None)


def _of_operation(node, text) -> Iterator[tuple[int, str, ast.AST]]:
    left, right = ast.unparse(node.left), ast.unparse(node.right)
    if isinstance(node.op, ast.Add | ast.Sub):
        other = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
        yield 0, _instead(text, ast.unparse(ast.BinOp(node.left, other, node.right))), \
            ast.BinOp(node.left, other, node.right)
        yield 1, f"without the term `{right}` in `{text}`", node.left
        yield 1, f"without the term `{left}` in `{text}`", node.right if isinstance(node.op, ast.Add) else \
            ast.UnaryOp(ast.USub(), node.right)
        if isinstance(node.op, ast.Sub):
            swapped = ast.BinOp(node.right, node.op, node.left)
            yield 0, _instead(text, ast.unparse(swapped)), swapped
    if isinstance(node.op, ast.Mult | ast.MatMult):
        yield 1, f"without `{right}` in `{text}`", node.left
        yield 1, f"without `{left}` in `{text}`", node.right
    if isinstance(node.op, ast.MatMult):
        swapped = ast.BinOp(node.right, node.op, node.left)
        yield 2, _instead(text, ast.unparse(swapped)), swapped
        yield 4, f"with `*` in place of `@` in `{text}`", ast.BinOp(node.left, ast.Mult(), node.right)
    if isinstance(node.op, ast.Mult):
        yield 4, f"with a division in place of the product `{text}`", ast.BinOp(node.left, ast.Div(), node.right)
    if isinstance(node.op, ast.Div):
        yield 1, f"without the division by `{right}` in `{text}`", node.left
        yield 4, f"with a product in place of the division `{text}`", ast.BinOp(node.left, ast.Mult(), node.right)
        yield 5, f"with the square root of `{text}`", _expression(f"np.sqrt({text})")
        yield 5, f"with the square of `{text}`", _expression(f"({text})**2")
    if isinstance(node.op, ast.Pow):
        yield 1, _instead(text, left), node.left
        yield 5, _instead(text, f"np.sqrt({left})"), _expression(f"np.sqrt({left})")
        yield 5, _instead(text, f"{left} ** 4"), _expression(f"({left})**4")
        yield 5, _instead(text, f"{left} ** 3"), _expression(f"({left})**3")
    if isinstance(node.op, ast.Mult | ast.Div | ast.MatMult) and not isinstance(node.right, ast.BinOp):
        square = _expression(f"({right})**2")
        yield 5, f"with the square of `{right}` in `{text}`", ast.BinOp(node.left, node.op, square)


def _of_call(node, text) -> Iterator[tuple[int, str, ast.AST]]:
    function, arguments = ast.unparse(node.func), [ast.unparse(argument) for argument in node.args]
    if len(arguments) == 1 and not function.startswith(("range", "len", "np.zeros", "np.ones", "np.eye", "np.array")):
        yield 1, _instead(text, arguments[0]), node.args[0]
    if function in _IN_PLACE_OF:
        new = ast.Call(_expression(_IN_PLACE_OF[function]), node.args, node.keywords)
        yield 4, _instead(text, ast.unparse(new)), new
    for pattern in _REWRITTEN.get(function, []):
        parts = {"X": f"({arguments[0]})", "Y": f"({arguments[-1]})"}
        rewritten = _expression("".join(parts.get(letter, letter) for letter in pattern))
        yield 4, _instead(text, ast.unparse(rewritten)), rewritten
    if len(arguments) == 2 and arguments[0] != arguments[1]:
        new = ast.Call(node.func, node.args[::-1], node.keywords)
        yield 4, _instead(text, ast.unparse(new)), new
    if function == "np.kron":
        yield 4, _instead(text, f"np.tile({arguments[1]}, (n, n))"), _expression(f"np.tile({arguments[1]}, (n, n))")
    if function == "np.array" or function == "np.diag":
        yield 4, f"with `np.abs` of `{text}`", _expression(f"np.abs({text})")
    if ".reshape" in function and arguments == ["-1", "3"]:
        yield 4, _instead(text, f"{function}(3, -1).T"), _expression(f"{function}(3, -1).T")
    for keyword in node.keywords:
        if keyword.arg == "axis":
            other = text.replace("axis=1", "axis=0") if "axis=1" in text else text.replace("axis=0", "axis=1")
            yield 4, _instead(text, other), _expression(other)
            yield 4, _instead(text, f"{function.replace('sum', 'mean')}(...)"), \
                _expression(text.replace("np.sum", "np.mean"))
    if isinstance(node.func, ast.Attribute) and node.func.attr == "copy":
        yield 4, _instead(text, ast.unparse(node.func.value)), node.func.value


def _of_subscript(node, text) -> Iterator[tuple[int, str, ast.AST]]:
    base, index = ast.unparse(node.value), ast.unparse(node.slice)
    swaps = {":3": "3:", "3:": ":3", "n:": ":6", ":n": "6:", ":3, :3": "3:, 3:", ":3, 3:": "3:, :3", "n:, n:": ":6, :6"}
    if index in swaps:
        yield 4, _instead(text, f"{base}[{swaps[index]}]"), _expression(f"{base}[{swaps[index]}]")
    if index == ":3, 3":
        yield 4, _instead(text, f"{base}[3, :3]"), _expression(f"{base}[3, :3]")
    if isinstance(node.slice, ast.Tuple):
        first, second = (ast.unparse(part) for part in node.slice.elts[:2])
        if first != second:
            yield 4, _instead(text, f"{base}[{second}, {first}]"), _expression(f"{base}[{second}, {first}]")
        if first.isdigit() and second.isdigit():
            for other in ("0, 0", "1, 1", "0, 2", "1, 2"):
                if other != index:
                    yield 4, _instead(text, f"{base}[{other}]"), _expression(f"{base}[{other}]")
    elif index.isidentifier():
        yield 3, _instead(text, f"{base}[0]"), _expression(f"{base}[0]")
        yield 5, _instead(text, f"{base}[:{index} + 1].sum(0)"), _expression(f"{base}[:{index} + 1].sum(0)")
    if not index.isdigit():
        yield 4, _instead(text, base), node.value


def _instead(old: str, new: str) -> str:
    return f"with `{new}` in place of `{old}`"


def _expression(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _statement(text: str) -> ast.stmt:
    return ast.parse(text).body[0]
