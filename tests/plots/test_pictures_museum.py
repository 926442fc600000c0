"""What the museum's pictures show, read back from their artists."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import picture_checks
import pytest
from matplotlib.colors import to_hex
from matplotlib.text import Text

from vislam_edu import simulate
from vislam_edu.course.ch10.broken_filters import VARIANTS, visit
from vislam_edu.course.ch10.panel import LIMITS, MuseumPicture, gallery, view
from vislam_edu.error_state import RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.plots.style import COLOURS
from vislam_edu.studies import consistency
from vislam_edu.widgets import Panel


@pytest.fixture(scope="module")
def drive():
    return simulate.street_loop(seed=1, frames=20, visible=6, loop_length=250)


@pytest.fixture(scope="module")
def visits(drive):
    start = consistency.initial_pose(drive, consistency.FilterConfig(Noise(), RightPerturbation()), 1)
    return [visit(VARIANTS[name], drive, Noise(), start) for name in ("right", "sign", "bearings", "birth")]


@pytest.fixture(scope="module")
def picture(visits, drive):
    return MuseumPicture(visits, drive)


def test_a_piece_shows_its_own_path_and_numbers(picture, visits, drive):
    times = drive.times - drive.times[0]
    for seen in visits[1:]:
        picture.draw(seen.title)
        np.testing.assert_array_equal(picture.path.get_xydata(), seen.run.world_T_imu[:, :2, 3])
        for kind, line in picture.lines.items():
            values = getattr(seen, kind)
            x, y = line.get_data()
            np.testing.assert_array_equal(x, times[:len(values)])
            low, high = LIMITS[kind]
            assert line.axes.get_ylim() == (low, high)
            inside = (values > low) & (values < high)
            np.testing.assert_array_equal(np.asarray(y)[inside], values[inside])
            assert (np.isnan(y) | ((y >= low) & (y <= high))).all()  # the line does not leave its axes unseen
        assert picture.title.get_text() == seen.title


def test_right_filter_and_truth_stand_still(picture, visits, drive):
    truth, right = picture.map.get_lines()[:2]
    assert truth.get_color() == COLOURS["truth"]
    np.testing.assert_array_equal(truth.get_xydata(), drive.true_world_T_imu[:, :2, 3])
    np.testing.assert_array_equal(right.get_xydata(), visits[0].run.world_T_imu[:, :2, 3])
    assert picture.map.get_aspect() == 1.0


def test_the_list_offers_every_mistake_and_says_its_numbers(picture, visits):
    panel = Panel(picture)
    choice = panel.controls["piece"]
    assert choice.spec["names"] == tuple(seen.title for seen in visits[1:])
    pictures = set()
    for seen in visits[1:]:
        choice.value = seen.title
        pictures.add(panel.image.value)
        caption = picture.caption(seen.title)
        assert seen.title in caption
        assert all(number in caption for number in (*seen.numbers, *visits[0].numbers))
        assert caption in picture.alt(seen.title)
        assert ("could not go on" in caption) == (seen.run.stopped is not None)
    assert len(pictures) == len(visits) - 1


@pytest.mark.parametrize("check", picture_checks.ALL, ids=lambda check: check.__name__)
def test_what_every_picture_must_stand(check, picture, visits):
    check(picture, [{"piece": seen.title} for seen in visits[1:]])


def test_one_visit_is_no_museum(visits, drive):
    with pytest.raises(ValueError, match="at least one mistake"):
        MuseumPicture(visits[:1], drive)


def test_gallery_has_a_map_for_each_and_counts_who_is_lost(visits, drive):
    figure = gallery(visits, drive, columns=3)
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert len(shown) == len(visits)
    for axes, seen in zip(shown, visits):
        truth, path = axes.get_lines()
        np.testing.assert_array_equal(truth.get_xydata(), drive.true_world_T_imu[:, :2, 3])
        np.testing.assert_array_equal(path.get_xydata(), seen.run.world_T_imu[:, :2, 3])
        assert to_hex(path.get_color()).upper() == COLOURS["rejected" if seen.lost else "predicted"].upper()
        assert (*axes.get_xlim(), *axes.get_ylim()) == pytest.approx(view(drive))
    assert any(seen.lost for seen in visits)
    assert f"{sum(seen.lost for seen in visits)} of {len(visits)}" in figure.get_suptitle()


def test_gallery_is_large_enough_to_read(visits, drive):
    picture_checks.is_large_enough(gallery(visits, drive))


def test_titles_of_the_gallery_do_not_run_into_each_other(visits, drive):
    """With the longest title there is in every map."""
    longest = max((piece.title for piece in VARIANTS.values()), key=len)
    figure = gallery([replace(visits[1], title=longest)] * 8, drive)
    figure.draw_without_rendering()
    titles = [text.get_window_extent() for axes in figure.axes[:4] for text in axes.findobj(Text)
              if "NIS" in text.get_text()]
    assert len(titles) == 4
    assert all(left.x1 < right.x0 for left, right in pairwise(titles))


def test_view_is_a_square_around_the_true_path(drive):
    x0, x1, y0, y1 = view(drive)
    x, y = drive.true_world_T_imu[:, :2, 3].T
    assert x1 - x0 == pytest.approx(y1 - y0)
    assert x0 < x.min() < x.max() < x1
    assert y0 < y.min() < y.max() < y1
