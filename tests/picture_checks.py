"""What every picture of a stepper or a panel must stand, whatever it shows.

picture : `vislam_edu.pictures.canvas.Picture`. states : those in which it is looked at, dicts of keyword arguments.
"""

import itertools

from vislam_edu.widgets import Panel, Stepper


def lettering_is_legible(picture, states):
    """No text is too small to read, outside the figure or over another."""
    for state in states:
        picture.png(**state)
        renderer = picture.canvas.get_renderer()
        boxes = {}
        for text in _lettering(picture.figure):
            if text.get_visible() and text.get_text().strip():
                assert text.get_fontsize() >= 8, (picture.name, text.get_text())
                boxes[text] = box = text.get_window_extent(renderer).padded(-1)
                inside = [picture.figure.bbox.containsx(x) for x in box.intervalx]
                inside += [picture.figure.bbox.containsy(y) for y in box.intervaly]
                assert all(inside), (picture.name, state, text.get_text())
        for (a, box), (b, other) in itertools.combinations(boxes.items(), 2):
            assert not box.overlaps(other), (picture.name, state, a.get_text(), b.get_text())


def _lettering(figure):
    """All texts that are drawn. Tick labels beyond the limits exist too, but are not."""
    yield from figure.texts
    for axes in figure.axes:
        yield from [*axes.texts, axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label]
        yield from axes.get_legend().get_texts() if axes.get_legend() else []
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            yield from (tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high)


def depends_on_the_state_only(picture, states):
    """Every state after the first looks different from it, and the way back leads to the same bytes."""
    first = picture.png(**states[0])
    for state in states[1:]:
        assert picture.png(**state) != first, (picture.name, state)
    assert picture.png(**states[0]) == first


def can_be_said_and_shown(picture, states):
    """It has words for each state, and a widget that knows its name."""
    widget = Stepper(picture) if "i" in states[0] else Panel(picture)
    assert picture.name in repr(widget)
    assert len(picture.alt(**states[0])) > 100
    assert picture.caption(**states[0]) != picture.caption(**states[1])


ALL = [lettering_is_legible, depends_on_the_state_only, can_be_said_and_shown]
