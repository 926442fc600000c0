"""Mutants: a plain answer with one small change, the kind of change that a slip makes.

The change is made in the syntax tree of the answer. Each mutant comes with words for it that finish the sentence
"your result is what one gets ..." and quote nothing of the answer but names that the student knows: the arguments.
"""

import ast
import contextlib
import functools
import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ... import kalman, se3, stereo
from .edit import changed_lines, plain_source
from .exercise import Exercise

_SCOPE = {"np": np, "kalman": kalman, "se3": se3, "stereo": stereo}  # what a change may name

# Functions that are easily taken for each other, and words for that.
_TWINS = [("np.sin", "np.cos", "sine and cosine exchanged"), ("np.sum", "np.mean", "sum and mean exchanged"),
          ("np.log", "np.log10", "a logarithm to another base"),
          ("chi2.ppf", "chi2.cdf", "the distribution function of chi-square and its inverse exchanged"),
          ("np.zeros", "np.eye", "zeros and the identity exchanged"), ("min", "max", "minimum and maximum exchanged"),
          ("se3.left_jacobian", "se3.right_jacobian", "the left and the right Jacobian exchanged"),
          ("se3.so3_left_jacobian", "se3.so3_right_jacobian", "the left and the right Jacobian exchanged"),
          ("camera.cam_T_imu", "camera.imu_T_cam", "`cam_T_imu` and `imu_T_cam` exchanged")]
_IN_PLACE_OF = {a: (b, words) for one, two, words in _TWINS for a, b in ((one, two), (two, one))}
# What else people write for an expression, and words for that; X and Y stand for its arguments.
_REWRITTEN = {
    "np.linalg.inv": [("1 / X", "the inverse taken entry by entry"), ("X.T", "the transpose in place of the inverse"),
                      ("np.linalg.inv(np.diag(np.diag(X)))", "the inverse of a diagonal alone")],
    "se3.exp": [("np.eye(4) + se3.hat(X)", "the exponential to first order")],
    "se3.so3_exp": [("np.eye(3) + se3.so3_hat(X)", "the exponential to first order"),
                    ("np.eye(3)", "the identity in place of the exponential")],
    "np.linalg.solve": [("X @ Y", "a product in place of the solution of the linear system")],
    "np.diag": [("np.eye(len(X))", "ones on a diagonal")], "np.eye": [("np.ones((X, X))", "ones everywhere")],
    "np.zeros": [("np.zeros(X, dtype=int)", "an array of integers (dtype=int), which cuts what is written into it")],
    "se3.inverse": [("np.linalg.inv(X).T", "the inverse transposed")],
    "se3.so3_left_jacobian": [("np.eye(3)", "the identity in place of the left Jacobian")],
    "se3.left_jacobian": [("np.eye(6)", "the identity in place of the left Jacobian")],
    "se3.right_jacobian": [("np.eye(6)", "the identity in place of the right Jacobian")],
    "se3.adjoint": [("np.eye(6)", "the identity in place of the Adjoint"),
                    ("se3.adjoint(se3.inverse(X))", "the Adjoint of the inverse"),
                    ("se3.adjoint(X).T", "the Adjoint transposed")],
    "se3.so3_hat": [("np.diag(X)", "a diagonal matrix in place of the skew-symmetric one")],
}
# What a call is, in words.
_CALLED = {
    "np.eye": "the identity", "np.linalg.inv": "an inverse", "np.linalg.norm": "a length", "np.sin": "the sine",
    "np.cos": "the cosine", "np.sqrt": "a square root", "np.log": "the logarithm", "np.exp": "the exponential",
    "np.abs": "an absolute value", "np.radians": "the conversion to radians", "se3.exp": "the exponential",
    "se3.so3_exp": "the exponential", "se3.adjoint": "the Adjoint", "se3.so3_hat": "a skew-symmetric matrix",
    "se3.inverse": "the inverse of a pose", "se3.left_jacobian": "the left Jacobian", "len": "a number of entries",
    "se3.right_jacobian": "the right Jacobian", "np.sum": "a sum", "np.linalg.det": "the determinant",
    "abs": "an absolute value", "np.sign": "the sign",
}

_Found = tuple[int, str, ast.AST, tuple[ast.AST, ...]]  # kind, words with a {} for each of some nodes, the new node


@dataclass(frozen=True, eq=False)
class Mutant:
    """words : see above. kind : how common such a slip is, 0 the commonest."""

    words: str
    kind: int
    function: Callable
    tree: ast.Module
    scope: Callable
    changes: tuple["_Change", ...]

    def lines(self) -> str:
        """The lines of the plain answer that it changes, as a diff."""
        with contextlib.ExitStack() as stack:
            for change in self.changes:
                stack.enter_context(change.made())
            wrong = ast.unparse(self.tree)
        return changed_lines(wrong, ast.unparse(self.tree), around=0)


def pairs(mutants: list[Mutant]) -> Iterator[Mutant]:
    """Two of these at once, where they change the same answer."""
    for one, other in itertools.combinations(mutants, 2):
        if one.tree is other.tree and (made := _mutant(
                f"{one.words}, and {other.words}", other.kind, one.tree, one.scope, one.changes + other.changes)):
            yield made


def of_exercise(exercise: Exercise) -> list[Mutant]:
    """The mutants of the plain answers, the commonest kinds first."""
    known = " ".join([exercise.statement, *exercise.outputs])
    found = (mutant for answer in exercise.answers for mutant in of_source(plain_source(answer), answer, known))
    return sorted(found, key=lambda mutant: mutant.kind)


@functools.cache
def of_source(source: str, scope: Callable, statement: str) -> tuple[Mutant, ...]:
    """The mutants of one source, which reads the globals of the function `scope`. statement : whose names are known."""
    tree = ast.parse(source)
    known = {*re.findall(r"\w+", statement)} - {"a", "A", "I"}
    made = (_mutant(change.words, change.kind, tree, scope, (change,)) for change in _changes(tree, known))
    return tuple(filter(None, made))


def _mutant(words, kind, tree, scope, changes) -> Mutant | None:
    """None where the changed code does not compile."""
    made: dict[str, Any] = {}
    with contextlib.ExitStack() as stack:
        for change in changes:
            stack.enter_context(change.made())
        with contextlib.suppress(SyntaxError):
            exec(compile(tree, "<changed>", "exec"), _SCOPE | scope.__globals__, made)
    return Mutant(words, kind, made.popitem()[1], tree, scope, changes) if made else None


@dataclass(frozen=True, eq=False)
class _Change:
    """A new node for one place of a tree."""

    parent: ast.AST
    field: str
    index: int | None
    kind: int
    words: str
    new: ast.AST

    @contextlib.contextmanager
    def made(self):
        """The tree is changed within, and as it was afterwards."""
        holder: Any = vars(self.parent) if self.index is None else getattr(self.parent, self.field)
        key = self.field if self.index is None else self.index
        old, holder[key] = holder[key], self.new
        try:
            yield
        finally:
            holder[key] = old


# --- where, and into what ---------------------------------------------------------------------------------

def _changes(tree, known) -> list[_Change]:
    """known : names that words may quote, those of the statement."""
    function = tree.body[0]
    names = dict.fromkeys([argument.arg for argument in function.args.args] + [
        node.id for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)])
    said = _definitions(function, {name: f"`{name}`" for name in known})
    fixed = {id(part) for node in ast.walk(tree) for whole in _fixed(node) for part in ast.walk(whole)}
    returned = {id(part) for node in ast.walk(tree) if isinstance(node, ast.Return)
                for part in [node.value, *getattr(node.value, "elts", [])]}
    found = []
    for parent in ast.walk(tree):
        for field, value in ast.iter_fields(parent):
            for index, node in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if id(node) in fixed or node is function:
                    continue
                if isinstance(node, ast.stmt):
                    changes = _of_statement(node)
                elif isinstance(node, ast.expr) and not isinstance(node, ast.Slice | ast.Starred) and \
                        isinstance(getattr(node, "ctx", ast.Load()), ast.Load):
                    changes = _of_expression(node, parent, list(names))
                else:
                    continue
                for kind, words, new, nodes in changes:
                    text = words.format(*("the result" if id(one) in returned else _called(one, said) for one in nodes))
                    text = text.replace("a part in place of a part", "one variable in place of another")
                    found.append(_Change(parent, field, index, kind, text, ast.fix_missing_locations(new)))
    return found


def _fixed(node) -> list[ast.AST]:
    """What is left alone: how often a loop runs (it might never end) and how large an array is."""
    if isinstance(node, ast.comprehension):
        return [node.target, *node.ifs, *([] if ast.unparse(node.iter).startswith("range(") else [node.iter])]
    if isinstance(node, ast.Subscript) and ast.unparse(node.value) == "np.r_":
        return [node]
    called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    if called in ("zip", "enumerate", "np.arange"):
        return [node]
    return node.args if called in ("range", "np.zeros") else []


def _definitions(function, said: dict[str, str]) -> dict[str, str]:
    """Words for every name: those of `said`, and else for what is stored in the variable first."""
    for node in ast.walk(function):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name | ast.Tuple):
            target, value = node.targets[0], node.value
            pairs = zip(target.elts, value.elts) if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) \
                else [(one, value) for one in getattr(target, "elts", [target])]
            for one, stored in pairs:
                said.setdefault(ast.unparse(one), _called(stored, said))
    return said


def _called(node, said: dict[str, str]) -> str:
    """Words for a part of an answer: a variable's name where it is known, a call by what it gives, else "a part"."""
    if isinstance(node, ast.Name):
        return said.get(node.id, "a part")
    if isinstance(node, ast.Call):
        return _CALLED.get(ast.unparse(node.func), "a part")
    if isinstance(node, ast.Constant):
        return "a number"
    if isinstance(node, ast.Attribute) and node.attr == "T":
        return f"the transpose of {_called(node.value, said)}"
    if isinstance(node, ast.Attribute) and node.attr in said:
        return said[node.attr]
    if isinstance(node, ast.Subscript | ast.Attribute):
        whole = _called(node.value, said)
        return f"a part of {whole}" if whole.startswith("`") else whole
    if isinstance(node, ast.UnaryOp):
        return _called(node.operand, said)
    return "a part"


def _of_statement(node) -> Iterator[_Found]:
    text = ast.unparse(node)
    if isinstance(node, ast.If):
        yield 1, "without a special case", ast.Pass(), ()
        yield 3, "with a special case taken always", ast.If(ast.Constant(True), node.body, []), ()
    if isinstance(node, ast.AugAssign):
        yield 1, "without the step that adds {}", ast.Pass(), (node.value,)
        for words, sign in (("subtracted", ast.Sub()), ("multiplied", ast.Mult())):
            yield 0, f"with {{}} {words} in place of added", ast.AugAssign(node.target, sign, node.value), (node.value,)
        yield 3, "with {} stored in place of added (= for +=)", ast.Assign([node.target], node.value), (node.value,)
    if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Subscript):
        yield 1, "with {} never stored in its place", ast.Pass(), (node.value,)
        yield 3, "with {} added in place of stored (+= for =)", ast.AugAssign(
            node.targets[0], ast.Add(), node.value), (node.value,)
    if isinstance(node, ast.Expr) and ".append(" in text:
        yield 3, "with nothing appended", ast.Pass(), ()
    if isinstance(node, ast.For):
        yield 3, "with a loop left after its first pass", ast.For(
            node.target, node.iter, [*node.body, ast.Break()], []), ()


def _of_expression(node, parent, names) -> Iterator[_Found]:
    text = ast.unparse(node)
    if isinstance(node, ast.BinOp):
        yield from _of_operation(node)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield 0, "with the minus of {} forgotten", node.operand, (node.operand,)
    elif isinstance(node, ast.Compare):
        left, right = ast.unparse(node.left), ast.unparse(node.comparators[0])
        for sign in (">", ">=", "<", "!="):
            if f"{left} {sign} {right}" != text:
                yield 4, f"with {sign} in a comparison of {{}}", _expression(f"{left} {sign} {right}"), (node.left,)
        yield 4, "with a comparison of {} always true", _expression(f"({left} == {left}) | True"), (node.left,)
    elif isinstance(node, ast.Call):
        yield from _of_call(node, text)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not (
            isinstance(parent, ast.Slice) or (isinstance(parent, ast.BinOp) and isinstance(parent.op, ast.Pow))):
        others = [0, 1, 2, 3, 4, 0.95, 0.995, round(1 - node.value, 12), node.value + 1, node.value - 1]
        yield from ((5, f"with {other:.4g} in place of another number", ast.Constant(other), ())
                    for other in dict.fromkeys(others) if other != node.value)
    elif isinstance(node, ast.Subscript):
        yield from _of_subscript(node)
    if isinstance(node, ast.Attribute):
        if node.attr == "T":
            yield 2, "with the transpose of {} forgotten", node.value, (node.value,)
        if text in _IN_PLACE_OF:
            new, words = _IN_PLACE_OF[text]
            yield 4, f"with {words}", _expression(new), ()
    if isinstance(node, ast.Name) and node.id in names and not isinstance(parent, ast.Attribute):
        yield from ((6, "with {} in place of {}", other, (other, node))
                    for other in map(_expression, names) if ast.unparse(other) != node.id)
    if _is_a_quantity(node, parent):
        for kind, words, new in [
                (0, "with the sign of {} reversed", "-({})"), (2, "with {} transposed", "({}).T"),
                (5, "with only the diagonal of {}", "np.diag(np.diag({}))"), (5, "with twice {}", "2 * ({})"),
                (5, "with {} inverted", "np.linalg.inv({})"), (5, "with zero in place of {}", "0 * ({})"),
                (5, "with the two halves of {} exchanged", "np.roll({}, 3, axis=-1)"),
                (5, "without the first entry of {}", "({})[1:]"), (5, "without the last entry of {}", "({})[:-1]")]:
            yield kind, words, _expression(new.format(text)), (node,)
    if isinstance(parent, ast.Assign | ast.Return) and not isinstance(node, ast.Tuple):
        yield 5, "with the square root of {} taken", _expression(f"np.sqrt({text})"), (node,)
        yield 5, "with {} divided by its length", _expression(f"({text}) / np.linalg.norm({text})"), (node,)


def _is_a_quantity(node, parent) -> bool:
    """An operand, an argument, or the whole of what is stored or returned; no index, no module, no transpose."""
    if isinstance(node, ast.Constant | ast.Tuple | ast.List | ast.Slice | ast.UnaryOp | ast.Compare):
        return False
    text = ast.unparse(node)
    if isinstance(node, ast.Name | ast.Attribute) and (text.startswith(("np", "se3", "len", "stereo"))
                                                       or text.endswith(".T")):
        return False
    return isinstance(parent, ast.BinOp | ast.Call | ast.Assign | ast.Return | ast.Tuple | ast.List) and \
        node is not getattr(parent, "func", None)


def _of_operation(node) -> Iterator[_Found]:
    left, right, op = node.left, node.right, node.op
    if isinstance(op, ast.Add | ast.Sub):
        new, words = (ast.Sub(), "minus in place of a plus") if isinstance(op, ast.Add) else \
            (ast.Add(), "plus in place of a minus")
        yield 0, f"with a {words} before {{}}", ast.BinOp(left, new, right), (right,)
        yield 1, "with {} left out of a sum", left, (right,)
        yield 1, "with {} left out of a sum", right if isinstance(op, ast.Add) else ast.UnaryOp(ast.USub(), right), \
            (left,)
        if isinstance(op, ast.Sub):
            yield 0, "with a difference taken the other way round", ast.BinOp(right, op, left), ()
    if isinstance(op, ast.Mult | ast.MatMult):
        yield 1, "with {} left out of a product", left, (right,)
        yield 1, "with {} left out of a product", right, (left,)
    if isinstance(op, ast.MatMult):
        yield 2, "with the factors of a product exchanged", ast.BinOp(right, op, left), ()
        yield 4, "with `*` in place of `@`", ast.BinOp(left, ast.Mult(), right), ()
    if isinstance(op, ast.Mult):
        yield 4, "with a division by {} in place of a product", ast.BinOp(left, ast.Div(), right), (right,)
    if isinstance(op, ast.Div):
        yield 1, "without the division by {}", left, (right,)
        yield 4, "with a product with {} in place of the division by it", ast.BinOp(left, ast.Mult(), right), (right,)
        yield 5, "with the square root of a quotient", _expression(f"np.sqrt({ast.unparse(node)})"), ()
        yield 5, "with the square of a quotient", ast.BinOp(node, ast.Pow(), ast.Constant(2)), ()
    if isinstance(op, ast.Pow):
        yield 1, "without the power of {}" if ast.unparse(right) != "2" else "with {} not squared", left, (left,)
        yield 5, "with the square root of {} in place of a power", _expression(f"np.sqrt({ast.unparse(left)})"), (left,)
        for power in (3, 4):
            yield 5, f"with {{}} to the power of {power}", ast.BinOp(left, op, ast.Constant(power)), (left,)
    if isinstance(op, ast.Mult) and isinstance(right, ast.BinOp) and isinstance(right.op, ast.Pow):
        yield 5, "with the square on another factor", ast.BinOp(
            ast.BinOp(left, right.op, right.right), op, right.left), ()
    if isinstance(op, ast.Mult | ast.Div | ast.MatMult) and not isinstance(right, ast.BinOp):
        yield 5, "with {} squared", ast.BinOp(left, op, ast.BinOp(right, ast.Pow(), ast.Constant(2))), (right,)


def _of_call(node, text) -> Iterator[_Found]:
    function, arguments = ast.unparse(node.func), [ast.unparse(argument) for argument in node.args]
    if len(arguments) == 1 and not function.startswith(("range", "len", "np.zeros", "np.ones", "np.eye", "np.array")):
        yield 1, "without {}" if function in _CALLED else "without a function", node.args[0], (node,)
    if function in _IN_PLACE_OF:
        new, words = _IN_PLACE_OF[function]
        yield 4, f"with {words}", ast.Call(_expression(new), node.args, node.keywords), ()
    for pattern, words in _REWRITTEN.get(function, []):
        parts = {"X": f"({arguments[0]})", "Y": f"({arguments[-1]})"}
        yield 4, f"with {words}", _expression("".join(parts.get(letter, letter) for letter in pattern)), ()
    if len(arguments) == 2 and arguments[0] != arguments[1]:
        yield 4, "with two arguments of a function exchanged", ast.Call(node.func, node.args[::-1], node.keywords), ()
    if function.endswith(("ppf", "cdf", "gate_threshold")) and len(arguments) == 2:
        for dof in (1, 2, 3, 4, 6):
            yield 4, f"with {dof} degree{'s' if dof > 1 else ''} of freedom", _expression(
                f"{function}({arguments[0]}, {dof})"), ()
    if function == "range":
        first, end = ["0", *arguments][-2:]
        yield 4, "with a loop that begins one step later", _expression(f"range({first} + 1, {end})"), ()
        yield 4, "with a loop that ends one step earlier", _expression(f"range({first}, {end} - 1)"), ()
    if function == "np.kron":
        yield 4, "with np.tile in place of np.kron", _expression(f"np.tile({arguments[1]}, (n, n))"), ()
    if function == "np.array" or function == "np.diag":
        yield 4, "with absolute values", _expression(f"np.abs({text})"), ()
    if ".reshape" in function and arguments == ["-1", "3"]:
        yield 4, "with rows and columns mixed by reshape", _expression(f"{function}(3, -1).T"), ()
    for keyword in node.keywords:
        if keyword.arg == "axis":
            other = text.replace("axis=1", "axis=0") if "axis=1" in text else text.replace("axis=0", "axis=1")
            yield 4, "with another axis", _expression(other), ()
            yield 4, "with the mean in place of a sum", _expression(text.replace("np.sum", "np.mean")), ()
    if isinstance(node.func, ast.Attribute) and node.func.attr == "copy":
        yield 4, "without a copy", node.func.value, ()


def _of_subscript(node) -> Iterator[_Found]:
    base, index = ast.unparse(node.value), ast.unparse(node.slice)
    other = {":3": "3:", "3:": ":3", "n:": ":6", ":n": "6:", ":3, :3": "3:, 3:", ":3, 3:": "3:, :3",
             "n:, n:": ":6, :6", ":3, 3": "3, :3"}.get(index)
    if other:
        yield 4, "with another block of {}", _expression(f"{base}[{other}]"), (node.value,)
    if isinstance(node.slice, ast.Tuple):
        first, second = (ast.unparse(part) for part in node.slice.elts[:2])
        if first != second:
            yield 4, "with row and column of {} exchanged", _expression(f"{base}[{second}, {first}]"), (node.value,)
        if first.isdigit() and second.isdigit():
            for other in ("0, 0", "1, 1", "0, 2", "1, 2"):
                if other != index:
                    yield 4, f"with the entry [{other}] of {{}} in place of another", _expression(
                        f"{base}[{other}]"), (node.value,)
    elif index.isidentifier():
        yield 3, "with the first of {} used for all", _expression(f"{base}[0]"), (node.value,)
        yield 5, "with {} summed up to there", _expression(f"{base}[:{index} + 1].sum(0)"), (node.value,)
    if not index.isdigit():
        yield 4, "with the whole of {} in place of a part of it", node.value, (node.value,)


def _expression(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body
