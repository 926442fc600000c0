"""One Chromium for each file of browser tests."""

import pytest
from browser import CHROMIUM, launch, sync_playwright


@pytest.fixture(scope="module")
def chromium():
    if CHROMIUM is None:
        pytest.skip("no Chromium found; set CHROMIUM to its path")
    with sync_playwright() as playwright:
        browser = launch(playwright)
        yield browser
        browser.close()
