"""The widgets, driven without a browser: moving a slider draws at once."""

import base64
import io

import ipywidgets
import numpy as np
import pytest
from PIL import Image

from vislam_edu import kalman
from vislam_edu.plots import style
from vislam_edu.widgets import SPEEDS, UNSEEN, Panel, Stepper
from vislam_edu.widgets.canvas import Number, Picture, StepPicture, Switch

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


class Half(StepPicture):
    name = "half"
    size = (2, 1)

    def build(self):
        axes = self.figure.add_axes((0, 0, 1, 1), xlim=(0, 10), ylim=(-1, 1))
        (self.dot,) = axes.plot([0], [0], "o")
        self.moves(self.dot)

    def draw(self, i):
        self.dot.set_xdata([self.belief(i)])

    def caption(self, i):
        return self.when(i)

    def alt(self, i):
        return f"a dot at {self.belief(i)}"


def history(n):
    nobody = np.empty(0, int)
    return [kalman.Step(k, 0.1 * k, k, k + 0.5, kalman.NO_INNOVATION, nobody, nobody) for k in range(n)]


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)))


@pytest.fixture
def stepper():
    return Stepper(Half(history(5)))


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


def test_screen_reader_finds_the_picture_in_words_beside_it(stepper):
    assert f'<div style="{UNSEEN}">a dot at 0</div>' in stepper.text.value
    stepper.slider.value = 3
    assert f'<div style="{UNSEEN}">a dot at 1.5</div>' in stepper.text.value


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


def test_still_has_the_pixels_of_the_live_picture_and_says_what_it_shows():
    picture = Bar()
    still = picture.still(height=2.0, filled=False)
    np.testing.assert_array_equal(pixels(still.png), pixels(picture.png(height=2.0, filled=False)))
    data, metadata = still._repr_mimebundle_()
    assert base64.b64decode(data["image/png"]) == still.png
    assert metadata["image/png"]["alt"] == "a line 2.0 m high"


def test_still_starts_from_the_controls_and_takes_the_half_step_first():
    assert Bar().still(filled=True).png == Bar().still(height=1.0, filled=True).png
    assert Half(history(3)).still(5).alt == "a dot at 2.5"


def test_half_steps_show_prior_then_posterior(stepper):
    shown = []
    for i in range(10):
        stepper.slider.value = i
        shown.append(stepper.picture.dot.get_xdata()[0])
    assert shown == [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5]
    assert "frame 4, 0.4 s, updated" in stepper.text.value


def test_buttons_walk_and_stop_at_the_ends(stepper):
    def press(name):
        stepper.buttons[name].click()
        return stepper.slider.value

    assert [
        press(b) for b in ("back", "forward", "forward", "back", "last", "back", "forward", "forward", "first")
    ] == [0, 1, 2, 1, 9, 8, 9, 9, 0]
    assert stepper.picture.dot.get_xdata()[0] == 0


def test_buttons_and_play_can_be_reached_and_say_what_they_do(stepper):
    assert all(button.tooltip and button.tabbable is not False for button in stepper.buttons.values())
    bar = stepper.children[0].children
    assert [type(child) for child in bar] == [
        ipywidgets.Button,
        ipywidgets.Button,
        ipywidgets.Play,
        ipywidgets.Button,
        ipywidgets.Button,
        ipywidgets.IntSlider,
        ipywidgets.Dropdown,
    ]


def test_speed_sets_the_interval_of_play(stepper):
    assert (stepper.play.min, stepper.play.max) == (0, 9)
    stepper.speed.value = SPEEDS["fast"]
    assert stepper.play.interval == SPEEDS["fast"]


def test_representation_is_fixed_and_holds_a_still_picture(stepper):
    first = repr(stepper)
    stepper.slider.value = 3
    assert repr(stepper) == first == "Stepper(half, 10 half-steps)"
    data, metadata = stepper._repr_mimebundle_()
    assert data["text/plain"] == first
    assert "application/vnd.jupyter.widget-view+json" in data
    np.testing.assert_array_equal(pixels(base64.b64decode(data["image/png"])), pixels(stepper.image.value))
    assert metadata["image/png"]["alt"] == "a dot at 1.5"


def test_an_error_in_a_picture_reaches_whoever_moved_the_slider(stepper):
    stepper.picture.steps = stepper.picture.steps[:2]
    with pytest.raises(IndexError, match="half-step 9"):
        stepper.slider.value = 9


def test_empty_history_is_refused():
    with pytest.raises(ValueError, match="at least one step"):
        Half([])


@pytest.mark.parametrize(("value", "step"), [(5.0, 0.1), (0.5, 0.0), (np.nan, 0.1)])
def test_number_outside_its_range_is_refused(value, step):
    with pytest.raises(ValueError, match="depth"):
        Number("depth", value, 0.0, 1.0, step)


def test_unknown_control_is_refused():
    picture = Bar()
    picture.controls = {"height": 3.0}
    with pytest.raises(TypeError, match=r"Number or a Switch, got 3\.0"):
        Panel(picture)
