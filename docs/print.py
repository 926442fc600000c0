"""The whole series as one PDF, mathematics rendered, with tags and an outline, by Chromium's print:

    python -m sphinx -b singlehtml -D live= docs PAGES && python docs/print.py PAGES/index.html series.pdf
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright


def main(page_file, pdf):
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        page = browser.new_page()
        page.goto(Path(page_file).resolve().as_uri())
        page.evaluate("() => window.MathJax ? MathJax.startup.promise : null")
        page.pdf(path=pdf, format="A4", margin=dict.fromkeys(("top", "bottom", "left", "right"), "15mm"), scale=0.8,
                 tagged=True, outline=True)
        browser.close()


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(*sys.argv[1:])
