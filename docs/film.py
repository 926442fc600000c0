"""The README's animated picture, an explorer that steps by itself:

    python -m sphinx -b html -D live=05_vi_slam docs PAGES
    python docs/film.py PAGES/explorers/05_vi_slam-stepper.html notebooks/images/explorer.webp
"""

import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

STEPS, MILLISECONDS = 40, 300


def main(page_file, film):
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        page = browser.new_page(viewport={"width": 820, "height": 640})
        page.goto(Path(page_file).resolve().as_uri())
        canvas = page.locator("canvas").first
        canvas.wait_for()
        page.evaluate("() => document.querySelector('h1').remove()")
        page.locator("input[type=range]").first.focus()
        for _ in range(60):
            page.keyboard.press("ArrowLeft")
        frames = []
        for _ in range(STEPS):
            page.wait_for_timeout(60)
            frames.append(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
            page.keyboard.press("ArrowRight")
        browser.close()
    frames[0].save(film, save_all=True, append_images=frames[1:], duration=MILLISECONDS, loop=0, quality=70, method=6)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(*sys.argv[1:])
