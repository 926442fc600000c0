"""The pictures: their artists hold what was measured, and nothing is drawn where it cannot be read."""

import base64
import inspect
import itertools
from dataclasses import replace

import numpy as np
import picture_checks
import pytest
from matplotlib import rcParams
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from matplotlib.text import Text

from vislam_edu import ekf_slam, odometry, plots, se3, window_slam
from vislam_edu.course.ch00 import figures as chapter00
from vislam_edu.course.ch01 import figures as chapter01
from vislam_edu.course.ch02 import figures as chapter02
from vislam_edu.course.ch03 import figures as chapter03
from vislam_edu.course.ch05 import figures as chapter05
from vislam_edu.error_state import RightInvariant, RightPerturbation, right_pose_covariance, world_landmark_covariance
from vislam_edu.motion import Belief
from vislam_edu.noise import Noise
from vislam_edu.odometry import Trajectory
from vislam_edu.plots import report_figures, style
from vislam_edu.simulate import street_loop
from vislam_edu.studies import pipeline

NOISE = Noise()


@pytest.fixture(scope="module")
def drive():
    return street_loop(seed=3, frames=120, visible=25)


@pytest.fixture(scope="module")
def result(drive):
    return pipeline.run_pipeline(drive, NOISE)


def lines(axes):
    return {line.get_label(): line for line in axes.get_lines() if not line.get_label().startswith("_")}


def labelled(axes, start):
    found = [line for label, line in lines(axes).items() if label.startswith(start)]
    assert len(found) == 1, f"{start!r} in {list(lines(axes))}"
    return np.column_stack(found[0].get_data())


def outlines(axes):
    return [c for c in axes.collections if isinstance(c, LineCollection)]


# --- style ------------------------------------------------------------------------------------------------


def test_a_users_settings_ask_for_nothing_that_may_be_missing(result, monkeypatch):
    monkeypatch.setitem(rcParams, "text.usetex", True)
    monkeypatch.setitem(rcParams, "font.family", ["No such font"])
    for draw in report_figures.FIGURES.values():
        texts = draw(result).findobj(Text)
        assert not any(text.get_usetex() for text in texts)
        assert {family for text in texts for family in text.get_fontfamily()} == {"DejaVu Sans"}


def test_ellipse_holds_the_share_of_samples_that_it_promises():
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    mean = np.array([10.0, -3.0])
    samples = np.random.default_rng(0).multivariate_normal(mean, covariance, 200_000)
    ellipse = style.ellipse_points(mean, covariance) - mean
    d2 = np.einsum("ni,ij,nj->n", ellipse, np.linalg.inv(covariance), ellipse)
    np.testing.assert_allclose(d2, d2[0], rtol=1e-9)  # one level of the density
    inside = np.einsum("ni,ij,nj->n", samples - mean, np.linalg.inv(covariance), samples - mean) <= d2[0]
    # 200 000 samples: five standard deviations of the share
    assert abs(inside.mean() - 0.95) < 5 * np.sqrt(0.95 * 0.05 / 200_000)


def test_ellipse_broadcasts_closes_and_takes_a_singular_covariance():
    means = np.arange(6.0).reshape(3, 2)
    covariances = np.array([np.eye(2), np.diag([4.0, 0.0]), np.zeros((2, 2))])
    points = style.ellipse_points(means, covariances, n=33)
    assert points.shape == (3, 33, 2)
    np.testing.assert_allclose(points[:, 0], points[:, -1], atol=1e-12)
    np.testing.assert_allclose(points[1, :, 1], means[1, 1], atol=1e-12)
    np.testing.assert_array_equal(points[2], np.broadcast_to(means[2], (33, 2)))


def lightness(colour, seen_as=None):
    """CIE L* (0 to 100) of a colour, after the matrix of a colour blindness on linear RGB."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = linear if seen_as is None else np.clip(seen_as @ linear, 0, 1)
    Y = linear @ [0.2126, 0.7152, 0.0722]
    return 116 * np.cbrt(Y) - 16 if Y > 0.008856 else 903.3 * Y


# Machado, Oliveira, Fernandes, A physiologically-based model for simulation of color vision deficiency (2009)
DEUTERANOPIA = np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                         [-0.011820, 0.042940, 0.968881]])
PROTANOPIA = np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                       [-0.003882, -0.048116, 1.051998]])


TRITANOPIA = np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                       [0.004733, 0.691367, 0.303900]])
VISIONS = {"grey": None, "deuteranopia": DEUTERANOPIA, "protanopia": PROTANOPIA, "tritanopia": TRITANOPIA}
SHARED = [  # by the lines or dots of a map, by the bars or marks of a stepper
    ("truth", "invariant", "slam", "report", "dead_reckoning"),
    ("truth", "mapping", "dead_reckoning", "slam"),
    ("truth", "mapping", "dead_reckoning", "invariant"),
    ("accepted", "rejected"),
    ("accepted", "invariant"),
    ("accepted", "slam"),
    ("measured", "predicted"),
    ("measured", "rejected"),
    ("measured", "smoother"),
    ("prior", "posterior"),
]


def apart(a, b):
    """Least difference in lightness of two of the style's colours, whoever looks."""
    a, b = style.COLOURS[a], style.COLOURS[b]
    return min(abs(lightness(a, seen_as) - lightness(b, seen_as)) for seen_as in VISIONS.values())


@pytest.mark.parametrize("names", SHARED, ids="-".join)
def test_colours_that_share_a_picture_differ_in_lightness_in_grey_and_for_the_colour_blind(names):
    for a, b in itertools.combinations(names, 2):
        assert apart(a, b) > 8, f"{a} and {b} are {apart(a, b):.1f} apart"


def test_every_two_methods_differ_in_lightness_or_in_line_style():
    for a, b in itertools.combinations(style.LABELS, 2):
        assert apart(a, b) > 8 or style.LINESTYLES[a] != style.LINESTYLES[b], (a, b)


def test_every_label_has_a_colour_and_lines_differ():
    assert style.LABELS.keys() <= style.COLOURS.keys()
    assert style.LABELS.keys() <= style.LINESTYLES.keys()
    assert len({style.COLOURS[m] for m in style.LABELS}) == len(style.LABELS)


@pytest.fixture
def shell(monkeypatch):
    """An IPython shell that is not running, as if it were the notebook's."""
    from IPython.core.interactiveshell import InteractiveShell

    monkeypatch.delenv("VIRTUAL_ENV", raising=False)  # another one than this Python's makes the shell warn
    shell = InteractiveShell()
    monkeypatch.setattr(style, "_ipython", lambda: shell)
    return shell


def test_a_notebook_stores_a_figure_without_versions_and_with_its_alternative_text(shell):
    from IPython.core.pylabtools import print_figure

    style.use()
    figure, axes = plots.new_figure()
    axes.plot([0, 1], label="a line")
    plots.finish(figure, "Found: 1")
    data, metadata = shell.display_formatter.format(figure)
    png = base64.b64decode(data["image/png"])
    assert b"Software" not in png
    assert png == print_figure(figure, metadata={"Software": None})  # what IPython would store by itself
    assert data["text/plain"].startswith("<Figure size 640x")
    assert metadata == {"image/png": {"alt": "Found: 1. a line."}}


def test_alternative_text_says_title_scales_and_names_of_all_axes_that_are_shown():
    figure = Figure()
    figure.suptitle("Three of four")
    first, second, hidden, fourth = figure.subplots(1, 4)
    first.set(xlabel="time (s)", ylabel="error (m)")
    fourth.set(xlabel="time (s)", ylabel="error (m)", title="EKF and band again")
    first.set_title("Two lines\nof title", loc="left")
    for axes in (first, fourth):
        axes.plot([0, 1], label="EKF")
        axes.axhspan(0, 1, label="95 % band")
    first.plot([1, 0])
    second.set(title="Only a title?")
    hidden.set(title="nobody sees this", visible=False)
    assert style.alt_text(figure) == (
        "Three of four. Two lines of title. error (m) against time (s): EKF; 95 % band. Only a title? "
        "EKF and band again."
    )


def test_every_figure_of_the_report_says_in_words_what_it_found_and_shows(result):
    for draw in report_figures.FIGURES.values():
        figure = draw(result)
        title = figure.axes[0].get_title(loc="left").split("\n")[0]
        alt = style.alt_text(figure)
        assert alt.startswith(" ".join(title.split()))
        assert all(text.get_text() in alt for text in figure.legends[0].get_texts())


def test_axes_keep_the_place_that_their_cell_gave_them():
    """Long names beside the axes need more room than numbers."""
    figure, axes = plots.new_figure()
    left, width = axes.get_position().x0, axes.get_position().width
    plots.finish(figure, "numbers")
    assert (axes.get_position().x0, axes.get_position().width) == (left, width)
    axes.set_position((0.33, 0, 0.65, 1))
    plots.finish(figure, "names")
    assert (axes.get_position().x0, axes.get_position().width) == pytest.approx((0.33, 0.65))


# --- geometry ---------------------------------------------------------------------------------------------


def turned(angle, tilt=0.0):
    return se3.exp(np.array([0, 0, 0, 0, 0, angle])) @ se3.exp(np.array([0, 0, 0, 0, tilt, 0]))


@pytest.mark.parametrize("angle", [-3.0, -0.4, 0.0, 2.9])
def test_heading_and_its_error(angle):
    T = turned(angle, tilt=0.2)
    np.testing.assert_allclose(plots.heading(T), angle, atol=1e-12)
    # over the seam at 180 degrees too
    np.testing.assert_allclose(plots.heading_error(T, turned(0.5) @ T), 0.5, atol=1e-12)


def test_covariances_in_the_world_are_those_of_sampled_poses():
    rng = np.random.default_rng(1)
    T = se3.exp(np.array([5.0, 2, 1, 0.3, -0.2, 1.0]))
    A = 1e-3 * rng.normal(size=(6, 6))
    trajectory = Trajectory(np.zeros(1), T[None], (A @ A.T)[None])
    samples = T @ se3.exp(rng.multivariate_normal(np.zeros(6), A @ A.T, 40_000))
    np.testing.assert_allclose(plots.position_covariance(trajectory)[0], np.cov(samples[:, :3, 3].T),
                               rtol=0.1, atol=0.03 * np.trace(A @ A.T))
    rotation = se3.so3_log(samples[:, :3, :3] @ T[:3, :3].T)
    np.testing.assert_allclose(plots.heading_sigma(trajectory)[0], rotation[:, 2].std(), rtol=0.03)


def test_view_holds_the_path_and_ignores_rows_without_a_position():
    path = np.array([[0.0, 0, 9], [100, 50, 9], [np.nan, np.nan, np.nan]])
    x0, x1, y0, y1 = plots.view_around(path, margin=10.0)
    assert (x0, x1, y0, y1) == (-10, 110, -10, 60)
    assert plots.inside((x0, x1, y0, y1), np.array([[0.0, 0], [110, 60], [111, 0], [0, -11]])).tolist() == [
        True, True, False, False]


@pytest.mark.parametrize("path", [np.array([[0.0, 0], [1000, 0]]), np.array([[0.0, 0], [0, 1000]]),
                                  np.zeros((1, 2)), np.full((2, 2), np.nan)])
def test_map_of_any_shape_is_a_readable_page_with_equal_scales(path):
    figure, axes = plots.new_map(plots.view_around(path))
    plots.finish(figure, "title")
    width, height = axes.get_position().size * figure.get_size_inches()
    assert 2.9 < height < 7.1
    assert axes.get_aspect() == 1
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    assert (x1 - x0) / width == pytest.approx((y1 - y0) / height)  # the axes are filled, so limits stay


def test_filter_that_knows_nothing_does_not_shrink_the_map():
    path = np.array([[0.0, 0], [100, 0]])
    huge = style.ellipse_points(np.zeros((1, 2)), 1e8 * np.eye(2)[None])
    x0, x1, _, _ = plots.view_with_outlines([path], [huge])
    assert x0 > -100
    assert x1 < 200


# --- pipeline ---------------------------------------------------------------------------------------------


def test_first_sight_is_the_triangulation_of_the_first_good_view(drive):
    poses = drive.true_world_T_imu
    belief = pipeline.first_sight(drive, NOISE, poses, min_disparity=8.0)
    expected = np.full((drive.n_landmarks, 3), np.nan)
    for k in reversed(range(drive.n_frames)):
        ids, pixels = drive.observed(k)
        points, ok = drive.camera.triangulate(pixels, 8.0)
        expected[ids[ok]] = drive.camera.to_world(poses[k], points[ok])
    seen = np.isfinite(expected[:, 0])
    assert 0 < seen.sum() < drive.n_landmarks
    np.testing.assert_array_equal(belief.seen, seen)
    np.testing.assert_allclose(belief.landmarks[seen], expected[seen], atol=1e-9)


def test_first_sight_claims_what_it_is_wrong_by():
    drive = street_loop(seed=4, frames=300)
    belief = pipeline.first_sight(drive, NOISE, drive.true_world_T_imu)
    first = drive.true_world_T_imu[drive.first_seen]
    near = drive.camera.to_cam(first, drive.true_landmarks)[:, 2] < 15  # m: the covariance is of first order
    error = (drive.true_landmarks - belief.landmarks)[near]
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(belief.covariance[near]), error)
    assert len(nees) > 50
    assert nees.mean() == pytest.approx(3, abs=4 * np.sqrt(6 / len(nees)))


@pytest.mark.parametrize("error_state", [RightPerturbation(), RightInvariant()], ids=lambda e: e.name)
def test_listening_keeps_what_the_steps_said(drive, error_state):
    steps = list(window_slam.run(drive, NOISE, error_state))
    told = pipeline.collect_slam(drive, iter(steps), error_state)
    np.testing.assert_array_equal(told.trajectory.world_T_imu, [s.posterior.world_T_imu for s in steps])
    last = {}
    for step in steps:
        last |= {i: (step.posterior, row) for row, i in enumerate(step.posterior.ids)}
    np.testing.assert_array_equal(np.flatnonzero(told.map.seen), sorted(last))
    for i, (belief, row) in last.items():
        np.testing.assert_array_equal(told.map.landmarks[i], belief.landmarks[row])
        np.testing.assert_allclose(told.map.covariance[i],
                                   world_landmark_covariance(belief, error_state)[row])
    assert told.measurements == sum(len(s.innovation.ids) for s in steps)
    assert told.rejected_share * told.measurements == pytest.approx(sum((~s.innovation.accepted).sum() for s in steps))


@pytest.mark.parametrize("error_state", [RightPerturbation(), RightInvariant()], ids=lambda e: e.name)
def test_covariances_for_the_map_are_those_of_states_drawn_from_the_belief(error_state):
    rng = np.random.default_rng(2)
    T, landmarks = se3.exp(np.array([30.0, 10, 1, 0.1, 0, 0.8])), rng.normal(scale=40, size=(3, 3))
    A = rng.normal(size=(15, 15)) * np.repeat([1e-3, 1e-3, 1e-5], [9, 3, 3])[:, None]
    belief = Belief(T.copy(), landmarks.copy(), np.arange(3), A @ A.T)
    drawn = [error_state.retract(T, landmarks, delta) for delta in (A @ rng.normal(size=(15, 8000))).T]
    errors = np.array([m for _, m in drawn]) - landmarks
    for i, covariance in enumerate(world_landmark_covariance(belief, error_state)):
        np.testing.assert_allclose(covariance, np.cov(errors[:, i].T), atol=0.07 * np.trace(covariance))
    poses = se3.log(se3.inverse(T) @ np.array([p for p, _ in drawn]))
    P = right_pose_covariance(belief, error_state)
    scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    np.testing.assert_allclose(np.cov(poses.T) / scale, P / scale, atol=0.07)


# --- the report's figures -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", report_figures.FIGURES)
def test_figure_is_readable(result, name):
    figure = report_figures.FIGURES[name](result)
    FigureCanvasAgg(figure).draw()
    axes, = figure.axes
    assert axes.get_aspect() == 1
    assert axes.get_xlabel().endswith("(m)")
    assert axes.get_ylabel().endswith("(m)")
    assert any(c.isdigit() for c in axes.get_title(loc="left"))  # the finding, with its number
    renderer = figure.canvas.get_renderer()
    legend, = figure.legends
    page, below = figure.bbox, legend.get_window_extent(renderer)
    whole = axes.get_tightbbox(renderer)  # with title, labels and ticks
    assert page.x0 <= whole.x0 < whole.x1 <= page.x1
    assert page.x0 <= below.x0 < below.x1 <= page.x1
    assert page.y0 <= below.y0 < below.y1 < whole.y0 < whole.y1 <= page.y1
    picture_checks.is_large_enough(figure)
    truth = labelled(axes, "ground truth")
    np.testing.assert_array_equal(truth, result.drive.true_world_T_imu[:, :2, 3])
    assert lines(axes)["ground truth"].get_color() == "#000000"


MAPS = {
    "fig2_initial_landmarks": ["dead_reckoning"],
    "fig3_mapped_landmarks": ["mapping"],
    "fig4_initial_and_mapped_landmarks": ["dead_reckoning", "mapping"],
    "fig5_slam_landmarks": ["slam"],
    "fig7_all_landmarks": ["dead_reckoning", "mapping", "slam"],
}


@pytest.mark.parametrize("name", MAPS)
def test_map_shows_its_landmarks(result, name):
    axes, = report_figures.FIGURES[name](result).axes
    beliefs = {"dead_reckoning": result.initial, "mapping": result.mapped.map, "slam": result.slam.map}
    for method in MAPS[name]:
        belief = beliefs[method]
        shown = labelled(axes, f"landmarks, {style.LABELS[method]}")
        np.testing.assert_array_equal(shown, belief.landmarks[belief.seen, :2])
    assert len([label for label in lines(axes) if label.startswith("landmarks")]) == len(MAPS[name])


def test_trajectory_figures_show_the_paths_and_their_ellipses(result):
    axes, = report_figures.FIGURES["fig6_initial_and_slam_trajectory"](result).axes
    dead_reckoned = result.dead_reckoning.world_T_imu[:, :2, 3]
    np.testing.assert_array_equal(labelled(axes, "dead reckoning"), dead_reckoned)
    np.testing.assert_array_equal(labelled(axes, "SLAM"), result.slam.trajectory.world_T_imu[:, :2, 3])
    dead, joint = outlines(axes)
    last = style.ellipse_points(result.slam.trajectory.world_T_imu[-1, :2, 3],
                                plots.position_covariance(result.slam.trajectory)[-1, :2, :2])
    np.testing.assert_allclose(joint.get_segments()[-1], last)
    assert len(dead.get_segments()) == 12


@pytest.mark.parametrize("which", ["initial", "slam"])
def test_ellipses_of_landmarks_belong_to_landmarks_in_the_view_and_are_short(result, which):
    draw, belief = {"initial": (report_figures.FIGURES["fig2_initial_landmarks"], result.initial),
                    "slam": (report_figures.FIGURES["fig5_slam_landmarks"], result.slam.map)}[which]
    axes, = draw(result).axes
    collection, = outlines(axes)
    width = np.ptp(axes.get_xlim())
    assert 5 < len(collection.get_segments()) <= report_figures.ELLIPSES
    for outline in collection.get_segments():
        centre = (outline[:-1].min(axis=0) + outline[:-1].max(axis=0)) / 2
        i = np.argmin(np.linalg.norm(belief.landmarks[:, :2] - centre, axis=1))
        mine = style.ellipse_points(belief.landmarks[i, :2], belief.covariance[i, :2, :2])
        np.testing.assert_allclose(outline, mine, atol=1e-9)
        assert np.ptp(outline, axis=0).max() <= width / 10 + 1e-9


def test_landmark_far_away_is_counted_and_does_not_move_the_view(result):
    from dataclasses import replace

    before = report_figures.FIGURES["fig2_initial_landmarks"](result).axes[0]
    landmarks = result.initial.landmarks.copy()
    view = (*before.get_xlim(), *before.get_ylim())
    already = np.count_nonzero(~plots.inside(view, landmarks[result.initial.seen]))
    near = np.flatnonzero(plots.inside(view, landmarks) & result.initial.seen)[:2]
    landmarks[near] = 1e5
    far = replace(result, initial=replace(result.initial, landmarks=landmarks))
    axes, = report_figures.FIGURES["fig2_initial_landmarks"](far).axes
    assert (*axes.get_xlim(), *axes.get_ylim()) == view
    assert any(label.endswith(f"({already + 2} outside)") for label in lines(axes))


def test_without_truth_nothing_black_is_drawn_and_no_error_is_claimed(result):
    from dataclasses import replace

    blind = replace(result, drive=result.drive.replace(truth_world_T_cam=None, truth_landmarks=None))
    for draw in report_figures.FIGURES.values():
        axes, = draw(blind).axes
        assert "ground truth" not in lines(axes)
        assert "truth" not in axes.get_title(loc="left")


def test_titles_tell_the_errors(result):
    figure = report_figures.FIGURES["fig6_initial_and_slam_trajectory"](result)
    title = figure.axes[0].get_title(loc="left").replace("\n", " ")
    truth = result.drive.true_world_T_imu[-1, :3, 3]
    slam_error = np.linalg.norm(result.slam.trajectory.world_T_imu[-1, :3, 3] - truth)
    error = np.linalg.norm(result.dead_reckoning.world_T_imu[-1, :3, 3] - truth)
    title = title.replace("\N{NO-BREAK SPACE}", " ")
    assert title.startswith(f"SLAM ends {slam_error:.1f} m from the truth, dead reckoning {error:.1f} m")


def test_heading_band_is_the_claim_and_the_line_the_error(drive):
    trajectory = odometry.dead_reckon(drive, NOISE)
    axes, = chapter01.heading_band(drive, trajectory).axes
    band = np.degrees(1.959964 * plots.heading_sigma(trajectory))
    outline = axes.collections[0].get_paths()[0].vertices
    assert outline[:, 1].max() == pytest.approx(band.max(), rel=1e-6)
    error = labelled(axes, "estimated minus true")[:, 1]
    expected = plots.heading_error(drive.true_world_T_imu, trajectory.world_T_imu)
    np.testing.assert_allclose(np.radians(error), expected, rtol=1e-12)
    assert "°" in axes.get_ylabel()
    blind = drive.replace(truth_world_T_cam=None, truth_landmarks=None)
    assert not lines(chapter01.heading_band(blind, trajectory).axes[0])


# --- chapters 00 to 05 ------------------------------------------------------------------------------------


def test_figures_of_the_chapters_fit_their_page_and_can_be_read(drive, result):
    """Each figure is 640 px wide, with its title, labels and legend inside, and holds what its chapter shows."""
    truth, trajectory = drive.true_world_T_imu, result.dead_reckoning
    outlines = {name: np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 5.0]]) for name in ("ellipse", "banana")}
    depths = np.geomspace(4, 150, 50)
    drawn = [
        chapter00.gyro_and_truth(drive),
        chapter00.feature_tracks(drive, 20),
        chapter02.disparities(drive, 20),
        chapter00.two_paths_and_a_map(result.drive, result.dead_reckoning, result.slam),
        chapter01.sigmas_over_time(trajectory),
        chapter01.cloud_and_outlines(truth, truth[:, :3, 3], outlines, {"ellipse": 0.7, "banana": 0.9}),
        chapter02.depth_law(depths, depths**2, {10.0: 100.0}),
        chapter02.landmarks_of_one_frame(drive, 20, 0.7),
        chapter03.nis_histogram(np.linspace(0, 12, 100), 13.28),
        chapter05.jacobian_pattern(np.eye(8, 18)),
    ]
    for figure in drawn:
        FigureCanvasAgg(figure).draw()
        box = figure.get_tightbbox()
        assert box.x0 > -0.05, figure.axes[0].get_title("left")
        assert box.x1 < plots.WIDTH + 0.05, figure.axes[0].get_title("left")
        picture_checks.is_large_enough(figure)


def test_figures_of_the_chapters_hold_the_data(drive, result):
    ids, pixels = drive.observed(20)
    axes = chapter00.feature_tracks(drive, 20).axes[0]
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), pixels[:, :2])
    tracks = axes.collections[0].get_segments()
    assert len(tracks) == len(ids)
    np.testing.assert_array_equal([track[-1] for track in tracks], pixels[:, :2])
    axes = chapter01.sigmas_over_time(result.dead_reckoning).axes[0]
    P = plots.position_covariance(result.dead_reckoning)
    np.testing.assert_allclose(labelled(axes, "position")[:, 1]**2, (P[:, 0, 0] + P[:, 1, 1]) / 2)
    axes = chapter02.landmarks_of_one_frame(drive, 20, 0.7, reach=1000).axes[0]
    np.testing.assert_array_equal(labelled(axes, "true landmark"), drive.true_landmarks[ids, :2])
    assert len(outlines(axes)[0].get_segments()) == len(ids)


@pytest.mark.parametrize(("name", "before", "after"), [
    ("fig4_initial_and_mapped_landmarks", "initial", "mapped"), ("fig7_all_landmarks", "mapped", "slam")])
def test_inset_has_an_arrow_for_each_landmark_that_moved_there(result, name, before, after):
    beliefs = {"initial": result.initial, "mapped": result.mapped.map, "slam": result.slam.map}
    axes = report_figures.FIGURES[name](result).axes[0]
    [inset] = axes.child_axes
    [arrows] = [c for c in inset.collections if isinstance(c, Quiver)]
    starts, moves = np.column_stack([arrows.X, arrows.Y]), np.column_stack([arrows.U, arrows.V])
    assert len(starts) >= 3
    for start, move in zip(starts, moves):
        i = np.argmin(np.linalg.norm(beliefs[before].landmarks[:, :2] - start, axis=1))
        np.testing.assert_allclose(start + move, beliefs[after].landmarks[i, :2])


def test_moves_too_long_for_an_inset_are_arrows_on_the_map(result):
    mapped, shift = result.mapped.map, np.array([30.0, 10.0, 0.0])
    far = replace(result.slam, map=replace(mapped, landmarks=mapped.landmarks + shift))
    axes = report_figures.all_landmarks(result.drive, result.dead_reckoning, result.initial, result.mapped, far).axes[0]
    [arrows] = [c for c in axes.collections if isinstance(c, Quiver)]
    assert not axes.child_axes
    np.testing.assert_allclose(np.column_stack([arrows.U, arrows.V]), np.tile(shift[:2], (len(arrows.U), 1)))
    assert 3 <= len(arrows.U) <= report_figures.ELLIPSES
    assert "moves of one landmark in" in axes.figure.legends[0].get_texts()[-1].get_text()


@pytest.mark.parametrize("corner", [(0.1, 0.1), (0.1, 0.56), (0.62, 0.1), (0.62, 0.56), (0.33, 0.33)])
def test_an_inset_hides_as_little_as_it_can(corner):
    points = np.random.default_rng(0).uniform((-100, 0), (100, 50), (2000, 2))
    share = (points - [-100, 0]) / [200, 50]
    free = ((share > np.array(corner) - 0.03) & (share < np.array(corner) + 0.45)).all(axis=1)
    assert report_figures._emptiest((-100, 100, 0, 50), points[~free])[:2] == corner


def test_source_is_shown_without_docstrings_and_with_comments(capsys):
    plots.show_source(ekf_slam.new_landmark, ekf_slam.joint_jacobian)  # docstrings of five lines and of more
    shown, source = capsys.readouterr().out, inspect.getsource(ekf_slam.new_landmark)
    assert '"""' not in shown
    assert "# old errors to new errors" in shown
    assert shown.startswith(source[:source.index('    """')] + source[source.rindex('"""') + 4:])


def test_a_table_aligns_its_columns(capsys):
    plots.table({"name": "", "sigma (m)": ".2f", "n": "d"}, [("a", 1.5, 10), ("longer", 20.25, 7)])
    assert capsys.readouterr().out.splitlines() == [
        "name     sigma (m)    n", "a             1.50   10", "longer       20.25    7"]
    with pytest.raises(ValueError, match="zip"):
        plots.table({"a": ""}, [(1, 2)])
