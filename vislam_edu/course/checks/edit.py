"""A wrong function is an edit of a right one: a few words of its source exchanged, compiled beside the original.

    edited(predict_joint, ("covariance[:n, n:] @ F.T", "covariance[:n, n:]"))

The mistakes of the exercises are made this way, so an algorithm is written once and a mistake is shown as a diff.
"""

import ast
import difflib
import inspect
import textwrap
import types
from collections.abc import Callable
from typing import Any

Edit = tuple[str, str]  # what stands in the source, what is put in its place


def edited(function: Callable, *edits: Edit) -> Callable:
    """The function or method with these edits made one after the other in its source.

    The result reads the same globals, defaults and enclosing variables as the original; its decorators are left out.
    Raises ValueError where the text of an edit does not occur exactly once.
    """
    inner = function.__code__.co_freevars
    source = f"def outer({', '.join(inner)}):\n{textwrap.indent(wrong_source(function, *edits), '    ')}\n" \
             f"    return {function.__name__}"
    scope: dict[str, Any] = {}
    exec(compile(source, f"<{function.__qualname__}, edited>", "exec"), function.__globals__, scope)
    result = scope["outer"](*(cell.cell_contents for cell in function.__closure__ or ()))
    result.__defaults__, result.__kwdefaults__ = function.__defaults__, function.__kwdefaults__
    result.__qualname__ = function.__qualname__
    return result


def calling(function: Callable, **others: Callable) -> Callable:
    """The function with other functions behind these of its global names."""
    return types.FunctionType(function.__code__, function.__globals__ | others, function.__name__,
                              function.__defaults__, function.__closure__)


def wrong_source(function: Callable, *edits: Edit) -> str:
    """The source of the function after the edits, without decorators and docstring."""
    source = plain_source(function)
    for old, new in edits:
        if source.count(old) != 1:
            raise ValueError(f"{function.__qualname__}: {old!r} stands {source.count(old)} times in its source, "
                             f"not once:\n{source}")
        source = source.replace(old, new)
    return source


def plain_source(function: Callable) -> str:
    """The source of the function, dedented, without decorators and docstring."""
    text = textwrap.dedent(inspect.getsource(function))
    node = ast.parse(text).body[0]
    assert isinstance(node, ast.FunctionDef)
    lines = text.splitlines()
    if ast.get_docstring(node) and len(node.body) > 1:
        del lines[node.body[0].lineno - 1:node.body[0].end_lineno]
    return "\n".join(lines[node.lineno - 1:]) + "\n"


def diff(function: Callable, *edits: Edit, around: int = 1) -> str:
    """The lines that the edits change: `-` before those of the wrong function, `+` before those of the right one."""
    return changed_lines(wrong_source(function, *edits), plain_source(function), around)


def changed_lines(wrong: str, right: str, around: int) -> str:
    """The lines in which two sources differ, `-` and `+` before them. around : lines shown before and after each."""
    lines = difflib.unified_diff(wrong.splitlines(), right.splitlines(), n=around, lineterm="")
    return "\n".join(line for line in list(lines)[2:] if not line.startswith("@@"))
