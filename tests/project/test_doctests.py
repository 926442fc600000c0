"""The examples in the docstrings of the core run and print what they say."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

import vislam_edu

CORE = sorted(path.stem for path in Path(vislam_edu.__file__).parent.glob("*.py")
              if path.stem not in ("__init__", "__main__"))


@pytest.mark.parametrize("name", CORE)
def test_the_example_of_a_core_file(name):
    failed, tried = doctest.testmod(import_module(f"vislam_edu.{name}"))
    assert tried, f"{name} has no example"
    assert not failed
