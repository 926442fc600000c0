"""The links of chapter 00, followed on the server that the README's command starts. Needs no browser."""

import re
import shlex
import urllib.parse
import urllib.request
from pathlib import Path

import nbformat
from browser import jupyter

ROOT = Path(__file__).resolve().parents[2]


def test_every_link_of_chapter_00_is_answered(tmp_path):
    command = (ROOT / "README.md").read_text(encoding="utf-8").partition("<!-- command: open -->")[2]
    words = shlex.split(command.split("```")[1].removeprefix("sh\n").partition("&&")[2])
    [root] = [word.partition("=")[2] for word in words if word.startswith("--ServerApp.root_dir=")]
    first = ROOT / words[-1]
    text = "".join(cell.source for cell in nbformat.read(first, as_version=4).cells if cell.cell_type == "markdown")
    links = {link for link in re.findall(r"\]\(([^)#]+)", text) if "://" not in link}
    assert len(links) > 15
    with jupyter("jupyter_server", tmp_path, root=ROOT / root) as address:
        for link in links:
            place = urllib.parse.urljoin(f"{address}/files/{words[-1]}", link)
            request = urllib.request.Request(place, headers={"Referer": f"{address}/lab"})  # as a click in it sends
            with urllib.request.urlopen(request, timeout=20) as answer:
                assert answer.status == 200, link
