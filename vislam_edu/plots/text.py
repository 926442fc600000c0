"""What is printed in a notebook: numbers to two digits, tables, long lines broken, and the code of functions."""

import inspect
import re
import textwrap

__all__ = ["on_a_page", "show_source", "table", "two_digits"]

PAGE = 100  # characters of a line that JupyterLab shows whole


def two_digits(x) -> str:
    """A number below a million to two significant digits, without an exponent: the third depends on the machine."""
    return f"{float(f'{x:.2g}'):g}"


def table(columns, rows) -> None:
    """Print a table: the first column to the left, the others to the right.

    columns : dict from each heading to the format of its values, as in f"{value:.2f}". rows : one value a column.
    """
    lines = [list(columns)]
    lines += [[format(value, form) for value, form in zip(row, columns.values(), strict=True)] for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines)]
    for first, *others in lines:
        texts = [first.ljust(widths[0]), *(text.rjust(width) for text, width in zip(others, widths[1:]))]
        print("   ".join(texts).rstrip())


def on_a_page(text) -> str:
    """A text whose long lines are broken between words, as JupyterLab would break them anywhere."""
    broken = []
    for line in text.splitlines():
        indent = line[:len(line) - len(line.lstrip())] + "  "
        broken.append(textwrap.fill(line, PAGE, subsequent_indent=indent) if len(line) > PAGE else line)
    return "\n".join(broken)


def show_source(*functions) -> None:
    """Print the code of functions of the package, without their docstrings."""
    for function in functions:
        lines = inspect.getsource(function).rstrip()
        print(re.sub(r'    """.*?"""\n', "", lines, count=1, flags=re.DOTALL), end="\n\n")
