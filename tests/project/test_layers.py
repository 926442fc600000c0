"""The order of the files, as pyproject.toml states it: a file imports only from those before it."""

from importlinter.cli import EXIT_STATUS_SUCCESS, lint_imports


def test_a_file_imports_only_from_those_before_it(capsys):
    assert lint_imports(no_cache=True) == EXIT_STATUS_SUCCESS, capsys.readouterr().out
