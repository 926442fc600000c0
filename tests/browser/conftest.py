"""One Chromium for each file of browser tests."""

import pytest
from browser import launch, sync_playwright


@pytest.fixture(scope="module")
def chromium():
    with sync_playwright() as playwright:
        browser = launch(playwright)
        yield browser
        browser.close()
