"""The web pages, built as the workflow builds them, in a browser that may not reach anything else.

Only the chapters that are looked at here are built; VISLAM_EDU_WHOLE=1 builds all pages.
"""

import functools
import http.server
import json
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from browser import NO_CHROMIUM, violations
from whole import WHOLE

pytest.importorskip("myst_nb", reason="the web pages need environment-dev.txt")

CLONE = Path(__file__).resolve().parents[2]
CHAPTERS = sorted(path.stem for path in (CLONE / "notebooks").glob("*.ipynb"))
BUILT = CHAPTERS if WHOLE else [CHAPTERS[i] for i in (1, 2, 5, 7)]


@pytest.fixture(scope="module")
def site(tmp_path_factory, chromium):
    """Address of the built pages; of the explorers only that of chapter 05, which the first page shows."""
    out = tmp_path_factory.mktemp("site")
    left_out = [] if WHOLE else ["api.md", *(f"notebooks/{name}.ipynb" for name in CHAPTERS if name not in BUILT)]
    subprocess.run([sys.executable, "-m", "sphinx", "-q", "-b", "html", "-D", "live=05_vi_slam",
                    "-D", f"exclude_patterns={','.join(['_live', *left_out])}", "docs", str(out)],
                   cwd=CLONE, check=True)
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=out)
    handler.log_message = lambda *_: None
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()


@pytest.fixture
def page(chromium, site):
    """A page that notes every request that would leave."""
    left = []
    opened = chromium.new_page(viewport={"width": 1300, "height": 950})
    opened.on("request", lambda request: request.url.startswith(("http:", "https:", "ws:"))
              and not request.url.startswith(site) and left.append(request.url))
    opened.left = left
    yield opened
    opened.close()
    assert left == []


def test_the_first_page_shows_an_explorer_that_the_keyboard_steps(page, site):
    page.goto(site)
    explorer = page.frame_locator("iframe")
    slider = explorer.locator("input[type=range]").first
    slider.wait_for()
    before = slider.input_value()
    explorer.locator("canvas").first.click()
    page.keyboard.press("ArrowRight")
    page.wait_for_function("before => document.querySelector('iframe').contentDocument"
                           ".querySelector('input[type=range]').value !== before", arg=before)
    assert "environment.txt" in page.locator("pre").first.inner_text()
    for width in (1300, 700):  # in a narrow page its parts stand in other lines; the frame is as high as they are
        page.set_viewport_size({"width": width, "height": 950})
        page.wait_for_function("""() => {
            const frame = document.querySelector('iframe');
            const room = frame.clientHeight - frame.contentDocument.body.offsetHeight;
            return room >= 0 && room < 80;
        }""")


def test_no_page_is_wider_than_a_small_laptop(page, site):
    page.set_viewport_size({"width": 1366, "height": 768})
    for name in ["index", "commands", "teaching", "notation", *(f"notebooks/{name}" for name in BUILT)]:
        page.goto(f"{site}{name}.html")
        assert page.evaluate("document.documentElement.scrollWidth") <= 1366, name


def test_every_chapter_is_one_click_away_and_its_mathematics_is_set(page, site):
    page.goto(site)
    links = page.locator(".sidebar-tree a").evaluate_all("links => links.map(link => link.href)")
    listed = re.findall(r"^notebooks/(\w+)$", (CLONE / "docs" / "index.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert listed == CHAPTERS
    assert [link for link in links if "/notebooks/" in link] == [f"{site}notebooks/{name}.html" for name in BUILT]
    for name in CHAPTERS if WHOLE else [CHAPTERS[7]]:
        page.goto(f"{site}notebooks/{name}.html")
        page.wait_for_selector("mjx-container")
        assert page.locator("mjx-merror").count() == 0
        assert page.locator("img:not([alt])").count() == 0


def test_a_chapter_shows_its_live_explorer(page, site):
    page.goto(f"{site}notebooks/05_vi_slam.html")
    page.locator("iframe").first.scroll_into_view_if_needed()  # it is loaded when it is looked at
    page.frame_locator("iframe").first.locator("input[type=range]").first.wait_for()


def test_a_result_that_is_guessed_first_is_folded_until_it_is_asked_for(page, site):
    for name in (CHAPTERS[1], CHAPTERS[5]):
        page.goto(f"{site}notebooks/{name}.html")
        cells = page.locator(".cell.tag_guessed")
        assert cells.count() > 3
        results = cells.locator(".cell_output")
        assert not any(result.is_visible() for result in results.all())
        cells.locator("summary").first.click()
        assert results.first.is_visible()


def test_pictures_keep_their_alternative_text(page, site):
    page.goto(f"{site}notebooks/02_stereo_triangulation.html")
    alts = page.locator("article img").evaluate_all("images => images.map(image => image.alt)")
    assert alts
    assert all(len(alt) > 30 for alt in alts), alts


@pytest.mark.parametrize(("name", "width", "colours"), [
    ("index", 1300, "dark"), ("teaching", 500, "light"), ("notebooks/05_vi_slam", 1300, "light")])
def test_axe_finds_no_violation(page, site, name, width, colours):
    page.emulate_media(color_scheme=colours)
    page.set_viewport_size({"width": width, "height": 950})
    page.goto(f"{site}{name}.html")
    page.wait_for_load_state("networkidle")
    assert violations(page) == []


@NO_CHROMIUM
def test_the_pdf_has_tags_an_outline_and_a_language(tmp_path):
    page, pdf = tmp_path / "page.html", tmp_path / "page.pdf"
    page.write_text('<html lang="en"><title>Series</title><h1>One</h1><p>text</p><h2>Two</h2></html>')
    subprocess.run([sys.executable, "docs/print.py", page, pdf], cwd=CLONE, check=True)
    content = pdf.read_bytes()
    assert all(key in content for key in (b"/StructTreeRoot", b"/Outlines", b"/Lang (en)"))


def test_search_finds_a_word_without_a_server(page, site):
    page.goto(f"{site}search.html?q=banana")
    page.wait_for_selector("#search-results a")
    assert "01" in page.locator("#search-results a").first.inner_text()


def test_what_one_click_platforms_read_is_well_formed():
    binder = CLONE / ".binder"
    assert (binder / (binder / "requirements.txt").read_text().removeprefix("-r").strip()).samefile(
        CLONE / "environment.txt")
    container = json.loads((CLONE / ".devcontainer" / "devcontainer.json").read_text())
    assert container["postCreateCommand"] == "python -m pip install -r environment.txt"
