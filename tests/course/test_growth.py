"""The explorer of chapter 16: its controls step it, it has a still picture, and its curves are what they say."""

import numpy as np
import pytest

from vislam_edu.course.ch16.panel import SOURCES, TIMES, GrowthPicture, growth
from vislam_edu.widgets import Panel


def test_every_control_moves_the_picture():
    panel = Panel(GrowthPicture())
    for control in panel.controls.values():
        before, caption = panel.image.value, panel.text.value
        control.value = control.value * 3 if control.value * 3 <= control.control.high else control.value / 3
        assert panel.image.value != before
        assert panel.text.value != caption
    assert panel._repr_mimebundle_()[0]["image/png"]


def test_parts_add_up_and_grow_as_in_the_text():
    """White noise of a gyro grows with t^2.5 in the position, its bias with t^3; of an accelerometer t^1.5 and t^2."""
    start = {name: value for name, value in GrowthPicture().start.items() if name != "seconds"}
    parts = growth(**start)
    assert growth(**start | {"gyro_bias": 0.0})[[0, 1, 3]] == pytest.approx(parts[[0, 1, 3]])
    powers = np.log2(parts[:, -1] / parts[:, len(TIMES) // 2])
    assert dict(zip(SOURCES, powers)) == pytest.approx(
        {"gyro noise": 2.5, "accel. noise": 1.5, "gyro bias": 3.0, "accel. bias": 2.0}, abs=0.02)
