"""The figures of chapters 06 and 07: what their artists hold, and the words of their titles."""

import numpy as np
import picture_checks
import pytest
from scipy.stats import chi2

from vislam_edu import metrics
from vislam_edu.course.ch06 import figures
from vislam_edu.course.ch07 import figures as chapter07

TIMES = 100 + 0.1 * np.arange(40)  # s


def title(figure):
    return " ".join(figure.axes[0].get_title(loc="left").split())


def test_density_of_a_mean_has_area_one_and_is_shaded_within_its_band():
    [axes] = figures.mean_nees_densities(6, (1, 10, 50)).axes
    assert [line.get_label() for line in axes.get_lines()] == ["one run", "mean of 10 runs", "mean of 50 runs"]
    for line, runs, shade in zip(axes.get_lines(), (1, 10, 50), axes.collections):
        x, density = line.get_data()
        assert np.trapezoid(density, x) == pytest.approx(chi2.cdf(runs * x[-1], 6 * runs), abs=2e-3)
        low, high = metrics.chi2_band(6, runs, 0.95)
        shaded = shade.get_paths()[0].vertices[:, 0]
        assert low <= shaded.min() < low + 0.1
        assert high - 0.1 < shaded.max() <= high


def test_worst_and_best_run_and_the_mean_of_all():
    nees = np.random.default_rng(0).chisquare(6, (30, 40))
    nees[7] = 99.0  # outside in every frame
    nees[3] = 6.0  # inside in every frame
    figure = figures.nees_of_runs(TIMES, nees)
    worst, best, mean = figure.axes[0].get_lines()
    np.testing.assert_array_equal(worst.get_ydata(), nees[7])
    assert best.get_label() in {f"run {i} alone" for i in range(30) if i != 7}
    np.testing.assert_allclose(mean.get_ydata(), nees.mean(axis=0))
    assert worst.get_xdata()[0] == 0
    assert "run 7 alone in 0 %" in title(figure)


def test_filters_inside_their_band_are_named():
    figure = figures.mean_nees_of_filters(TIMES, {"bad": np.full(40, 60.0), "good": np.full(40, 6.0)}, 5)
    assert [line.get_ydata()[0] for line in figure.axes[0].get_lines()] == [60.0, 6.0]
    assert title(figure).endswith(": good")
    assert title(figures.mean_nees_of_filters(TIMES, {"bad": np.full(40, 60.0)}, 5)).endswith(": none")


def test_the_frame_of_full_rank_is_named():
    figure = chapter07.ranks({"a": np.array([9, 9, 9]), "b": np.array([9, 13, 15])}, 3)
    np.testing.assert_array_equal(figure.axes[0].get_lines()[1].get_ydata(), [9, 13, 15])
    assert title(figure) == "b: full rank after 3 frames"
    assert title(chapter07.ranks({"a": np.array([9, 9])}, 3)) == "The rank stays at 3n"


@pytest.mark.parametrize("figure", [
    figures.mean_nees_densities(6, (1, 10)), chapter07.ranks({"a": np.array([9, 9])}, 3),
    figures.nees_of_runs(TIMES, np.full((3, 40), 6.0)), figures.mean_nees_of_filters(TIMES, {"a": np.ones(40)}, 5)],
    ids=["densities", "ranks", "runs", "filters"])
def test_figures_are_640_px_wide_and_large_enough_to_read(figure):
    assert figure.get_figwidth() == 6.4
    picture_checks.is_large_enough(figure)
