"""What every picture of a panel must stand, whatever it shows.

picture : `vislam_edu.pictures.canvas.Picture`. states : those in which it is looked at, dicts of keyword arguments.
"""

import itertools

from matplotlib.mathtext import MathTextParser

from vislam_edu.plots import style
from vislam_edu.widgets import Panel

GITHUB = 830  # px (CSS), the width to which GitHub shrinks a wider picture; JupyterLab's output area is wider
SMALLEST = 8  # points of 1/72 inch, an inch being 96 px (CSS)


def is_large_enough(figure):
    """No lettering is smaller than 8 points where the figure is shown, not even an exponent."""
    width = figure.dpi * max(figure.get_figwidth(), figure.get_tightbbox().width)
    shown = min(1, GITHUB / width) * figure.dpi / 96
    for text in _lettering(figure):
        if text.get_visible() and text.get_text().strip():
            size = shown * _smallest_glyph(text)
            assert size >= SMALLEST, f"{text.get_text()!r}: {size:.1f} points in a figure {width:.0f} px wide"


def _smallest_glyph(text):
    """Points of the smallest letter; mathematics has smaller ones than the text's own."""
    if "$" not in text.get_text():
        return text.get_fontsize()
    glyphs = MathTextParser("path").parse(text.get_text(), 72, text.get_fontproperties())[3]
    return min(size for _, size, *_ in glyphs)


def lettering_is_legible(picture, states):
    """No text is too small to read, outside the figure or over another."""
    for state in states:
        picture.png(**state)
        with style.context():  # measuring draws again
            is_large_enough(picture.figure)
        renderer = picture.canvas.get_renderer()
        boxes = {}
        for text in _lettering(picture.figure):
            if text.get_visible() and text.get_text().strip():
                boxes[text] = box = text.get_window_extent(renderer).padded(-1)
                inside = [picture.figure.bbox.containsx(x) for x in box.intervalx]
                inside += [picture.figure.bbox.containsy(y) for y in box.intervaly]
                assert all(inside), (picture.name, state, text.get_text())
        for (a, box), (b, other) in itertools.combinations(boxes.items(), 2):
            assert not box.overlaps(other), (picture.name, state, a.get_text(), b.get_text())


def _lettering(figure):
    """All texts that are drawn. Tick labels beyond the limits exist too, but are not."""
    yield from figure.texts
    yield from itertools.chain.from_iterable(legend.get_texts() for legend in figure.legends)
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
    assert picture.name in repr(Panel(picture))
    assert len(picture.alt(**states[0])) > 100
    assert picture.caption(**states[0]) != picture.caption(**states[1])


ALL = [lettering_is_legible, depends_on_the_state_only, can_be_said_and_shown]
