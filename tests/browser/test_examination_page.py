"""The page of an examination in a real browser."""

import threading

import pytest
from browser import NO_CHROMIUM, violations

from vislam_edu.course.clinic import examination

pytestmark = NO_CHROMIUM


@pytest.fixture
def address(tmp_path):
    exam = examination.Examination(tmp_path / "log.txt", "a secret")
    exam.start({"Zoë": ["", "", ""]}, 1, 1)
    exam.order("Zoë", 1, "birth")
    with examination.server(exam, ("127.0.0.1", 0)) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/{exam.token('Zoë')}"
        server.shutdown()


def test_axe_finds_no_violation(chromium, address):
    page = chromium.new_page(viewport={"width": 500, "height": 900})
    page.goto(address)
    page.locator("summary").click()
    assert violations(page) == []
    page.close()
