"""The widgets, driven without a browser: moving a slider draws at once."""

import base64
import io
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from traitlets import TraitError

from vislam_edu import simulate
from vislam_edu.course.ch05.panel import WhatIf
from vislam_edu.noise import Noise
from vislam_edu.plots import style
from vislam_edu.widgets import Panel
from vislam_edu.widgets.canvas import Choice, Decades, Number, Picture, Switch
from vislam_edu.widgets.panel import Control

CHOICE = Choice("mistake", "sign", ("sign", "order"))
CONTROLS = {"height": Number("height, m", 1.0, 0.0, 4.0, 0.5), "filled": Switch("filled", False)}


class Bar(Picture):
    """A line as high as its control says."""

    name = "bar"
    size = (2, 1)
    controls = CONTROLS

    def build(self):
        axes = self.figure.add_axes((0.1, 0.1, 0.8, 0.8), xlim=(0, 1), ylim=(0, 4))
        (self.line,) = axes.plot([0.2, 0.8], [0, 0], "k", lw=3)  # clear of the frame
        self.moves(self.line)

    def draw(self, height, filled):
        self.line.set_ydata([height, height])
        self.line.set_color("red" if filled else "black")

    def caption(self, height, filled):
        return f"height {height} < 5"

    def alt(self, height, filled):
        return f"a line {height} m high"


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)))


def test_a_control_draws_at_once_and_reaches_the_artist():
    panel = Panel(Bar())
    before = panel.image.value
    panel.controls["height"].value = 3.0
    assert list(panel.picture.line.get_ydata()) == [3.0, 3.0]
    assert panel.image.value != before
    panel.controls["filled"].value = True
    assert panel.picture.line.get_color() == "red"


def test_caption_is_escaped():
    assert "height 1.0 &lt; 5" in Panel(Bar()).text.value


def test_picture_has_an_alternative_text_of_what_it_shows():
    panel = Panel(Bar())
    assert panel.image.alt == "a line 1.0 m high"
    panel.controls["height"].value = 3.0
    assert panel.image.alt == "a line 3.0 m high"


def test_picture_depends_on_the_state_only_not_on_the_way_there():
    """A ghost of an earlier frame in the kept background would show here."""
    moved = Bar()
    for height in (0.5, 3.5, 2.0):
        png = moved.png(height=height, filled=False)
    fresh = Bar().png(height=2.0, filled=False)
    np.testing.assert_array_equal(pixels(png), pixels(fresh))


def test_blitted_picture_has_the_pixels_of_a_whole_redraw():
    picture = Bar()
    blitted = pixels(picture.png(height=2.0, filled=True))
    with style.context():
        picture.canvas.draw()
    whole = np.asarray(picture.canvas.buffer_rgba())[..., :3]
    np.testing.assert_array_equal(blitted, whole)


def test_live_picture_is_sharp_on_a_screen_of_two_pixels_a_point_and_the_still_is_small():
    panel = Panel(Bar())
    live, still = pixels(panel.image.value), pixels(panel.picture.still(height=1.0).png)
    assert live.shape[:2] == (200, 400)
    assert still.shape[:2] == (100, 200)
    assert [part.layout.width for part in panel.children] == ["200px"] * 3  # controls, picture, caption
    panel.controls["height"].value = 2.0    # the still has not left its resolution behind
    assert pixels(panel.image.value).shape == live.shape


def test_still_says_what_it_shows_and_starts_from_the_controls():
    still = Bar().still(height=2.0, filled=False)
    data, metadata = still._repr_mimebundle_()
    assert base64.b64decode(data["image/png"]) == still.png
    assert metadata["image/png"]["alt"] == "a line 2.0 m high"
    assert Bar().still(filled=True).png == Bar().still(height=1.0, filled=True).png


def test_representation_is_fixed_and_holds_a_still_picture():
    panel = Panel(Bar())
    first = repr(panel)
    panel.controls["height"].value = 2.0
    assert repr(panel) == first == "Panel(bar)"
    data, metadata = panel._repr_mimebundle_()
    assert data["text/plain"] == first
    assert "application/vnd.jupyter.widget-view+json" in data
    assert base64.b64decode(data["image/png"]) == panel.picture.still(height=2.0).png
    assert metadata["image/png"]["alt"] == "a line 2.0 m high"


@pytest.mark.parametrize("make", [
    lambda drive: Panel(Bar()), lambda drive: WhatIf(drive, Noise()), lambda drive: WhatIf(drive, Noise()).explorer,
], ids=["panel", "what if", "explorer"])
def test_what_colab_is_sent_names_the_manager_that_loads_anywidget(make, monkeypatch):
    """Colab loads no widget but ipywidgets' own unless the metadata of what is shown name a manager for the others.

    Its module is a stand-in with the two names that anywidget uses.
    """
    output = ModuleType("google.colab.output")
    output.enable_custom_widget_manager = lambda: None
    output._widgets = SimpleNamespace(_installed_url="manager.js")
    monkeypatch.setitem(sys.modules, "google.colab.output", output)
    _, metadata = make(simulate.first_steps().slice(0, 3))._repr_mimebundle_()
    manager = {"colab": {"custom_widget_manager": {"url": "manager.js"}}}
    assert metadata["application/vnd.jupyter.widget-view+json"] == manager
    assert metadata["image/png"]["alt"]


def test_a_control_tells_the_browser_its_label_kind_and_range():
    assert Control(CONTROLS["height"]).spec == {"label": "height, m", "value": 1.0, "kind": "number", "low": 0.0,
                                                "high": 4.0, "step": 0.5}
    assert Control(CONTROLS["filled"]).spec == {"label": "filled", "value": False, "kind": "switch"}
    assert Control(Decades("sigma", 1.0, 0.1, 10.0, 0.1)).spec["kind"] == "decades"
    assert Control(CHOICE).spec == {"label": "mistake", "value": "sign", "kind": "choice", "names": ("sign", "order")}


def test_a_control_keeps_to_its_range_and_to_whole_numbers():
    control = Control(Number("landmarks", 3, 1, 9, 1))
    for given, kept in ((12, 9), (-1, 1), (4.4, 4)):
        control.value = given
        assert control.value == kept
        assert isinstance(control.value, int)


def test_a_choice_is_one_of_its_names():
    control = Control(CHOICE)
    control.value = "order"
    with pytest.raises(TraitError, match="'units' is not one of sign, order"):
        control.value = "units"
    assert control.value == "order"
    with pytest.raises(ValueError, match="'units' is not one of"):
        Choice("mistake", "units", ("sign", "order"))


@pytest.mark.parametrize(("value", "step"), [(5.0, 0.1), (0.5, 0.0), (np.nan, 0.1)])
def test_number_outside_its_range_is_refused(value, step):
    with pytest.raises(ValueError, match="depth"):
        Number("depth", value, 0.0, 1.0, step)


def test_unknown_control_is_refused():
    picture = Bar()
    picture.controls = {"height": 3.0}
    with pytest.raises(TypeError, match=r"a Choice, got 3\.0"):
        Panel(picture)
