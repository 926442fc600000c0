"""The control of a panel in a real browser, in a page without a kernel."""

import json

import pytest
from browser import NO_CHROMIUM

from vislam_edu.widgets.canvas import Choice
from vislam_edu.widgets.panel import Control

pytestmark = NO_CHROMIUM
PAGE = """<div id="here"></div><script type="module">
const listeners = [];
window.model = { values: %s, sent: [], get: (key) => model.values[key],
  set: (key, value) => { model.values[key] = value; listeners.forEach((tell) => tell()); },
  save_changes: () => model.sent.push(model.values.value), on: (_, tell) => listeners.push(tell), off() {} };
%s
render({ model, el: document.getElementById("here") });
</script>"""


@pytest.fixture
def opened(chromium):
    """Function that shows a control, and afterwards no other page is left."""
    page = chromium.new_page()

    def open_page(control):
        values = json.dumps({"spec": control.spec, "value": control.value})
        page.set_content(PAGE % (values, control._esm))
        page.wait_for_selector("#here input, #here select")
        return page

    yield open_page
    page.close()


def test_few_names_are_buttons_that_the_keyboard_reaches(opened):
    """One stop for Tab, arrows within; what is set from code shows; a click anywhere on a button counts."""
    page = opened(Control(Choice("after", "birth", ("birth", "look", "drive", "look again"))))
    group = page.get_by_role("radiogroup", name="after")
    checked = lambda: [radio.is_checked() for radio in group.get_by_role("radio").all()]  # noqa: E731
    assert checked() == [True, False, False, False]
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowRight")
    assert (page.evaluate("() => model.sent"), checked()) == (["look"], [False, True, False, False])
    page.evaluate("() => model.set('value', 'look again')")
    assert checked() == [False, False, False, True]
    page.get_by_text("drive").click(position={"x": 2, "y": 2})
    assert (page.evaluate("() => model.sent"), checked()) == (["look", "drive"], [False, False, True, False])


def test_more_names_are_a_list(opened):
    page = opened(Control(Choice("mistake", "a", tuple("abcde"))))
    page.get_by_label("mistake").select_option("d")
    assert page.evaluate("() => model.sent") == ["d"]
