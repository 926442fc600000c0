"""One address of the repository and one version, wherever they are written."""

import re
import tomllib
from pathlib import Path

import vislam_edu

CLONE = Path(__file__).resolve().parents[2]


def text(name):
    return (CLONE / name).read_text(encoding="utf-8")


def test_every_file_names_the_same_repository():
    urls = tomllib.loads(text("pyproject.toml"))["project"]["urls"]
    owner, name = urls["Repository"].removeprefix("https://github.com/").split("/")
    assert urls["Documentation"] == f"https://{owner}.github.io/{name}"
    citation = dict(re.findall(r"^(repository-code|url): (.*)$", text("CITATION.cff"), re.MULTILINE))
    assert citation == {"repository-code": urls["Repository"], "url": urls["Documentation"]}
    readme = text("README.md")
    assert re.findall(r"git clone ([^`\s]+)", readme) == [urls["Repository"]]
    assert set(re.findall(r"https://(\w+)\.github\.io/(\w+)", readme)) == {(owner, name)}
    served = r"(?:/gh|research\.google\.com/github|github\.com)/(\w[\w-]*)/(\w+)"
    assert set(re.findall(served, readme)) == {(owner, name)}
    opened = re.findall(r"(?:lab/tree|blob/main)/(notebooks/\w+\.ipynb)", readme)
    assert len(opened) == 2
    assert all((CLONE / path).exists() for path in opened)


def test_every_file_names_the_same_version():
    version = vislam_edu.__version__
    assert f"\nversion: {version}\n" in text("CITATION.cff")
    assert re.search(r"^## \[(.*?)\] - ([\d-]+)", text("CHANGELOG.md"), re.MULTILINE).groups() == (
        version, re.search(r"date-released: (.*)", text("CITATION.cff"))[1])
    named = [found for page in ("docs/install.md", "docs/teaching.md", "docs/commands.md")
             for found in re.findall(r"vislam_edu-([\d.]+)-py3", text(page))]
    assert set(named) == {version}
