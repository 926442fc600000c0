"""What the explorer sends to the browser, held against the steps that it was made from."""

import base64
import dataclasses
import io
import json
import re

import numpy as np
import pytest
from numerical import central_difference
from PIL import Image
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, multivariate_normal

from vislam_edu import mapping, odometry, plots, se3, simulate, window_slam
from vislam_edu.belief import Step
from vislam_edu.course.ch05.panel import AS_IT_WAS, FRAME, LANDMARK, NOTHING, WHAT_IF, WhatIf
from vislam_edu.error_state import RightInvariant, RightPerturbation, right_pose_covariance, world_landmark_covariance
from vislam_edu.motion import TwistAndBias
from vislam_edu.noise import Noise
from vislam_edu.plots import style
from vislam_edu.widgets import BOTH, Explorer, PathBelief, history, packing
from vislam_edu.widgets.explorer import MODULE
from vislam_edu.widgets.explorer_still import leave_out_covering

NOISE = Noise()
STATES = {"right": RightPerturbation(), "invariant": RightInvariant()}


@pytest.fixture(scope="module")
def drive():
    return simulate.first_steps()


@pytest.fixture(scope="module")
def runs(drive):
    return {name: list(window_slam.run(drive, NOISE, error)) for name, error in STATES.items()}


@pytest.fixture(scope="module")
def explorer(drive, runs):
    return Explorer(runs, drive, STATES)


@pytest.fixture(scope="module")
def mapped(drive):
    steps = list(mapping.run(drive, NOISE, drive.true_world_T_imu))
    return steps, Explorer(steps, drive, world_T_imu=drive.true_world_T_imu)


@pytest.fixture(scope="module")
def localised(drive):
    steps = list(odometry.localize(drive, NOISE, drive.true_landmarks))
    return steps, Explorer(steps, drive)


class Unpacked:
    """One run of an explorer as it arrives, its arrays (n, numbers a row) by name; the header has been through JSON."""

    def __init__(self, run, data):
        self.header = json.loads(json.dumps(run))
        self.arrays = {}
        for name in packing.LAYOUT.keys() & self.header.keys() - {"series"}:
            dtype, at, n = self.header[name]
            row = packing.LAYOUT[name][1]
            assert dtype == packing.LAYOUT[name][0]
            array = np.frombuffer(data, np.dtype(dtype).newbyteorder("<"), n, at)
            self.arrays[name] = array.reshape(-1, len(row)) if len(row) > 1 else array

    def __getattr__(self, name):
        return self.arrays[name] if name in self.arrays else self.header[name]

    def of(self, i):
        """Rows of the landmarks of snapshot i."""
        return slice(*self.first[i:i + 2])

    def ellipses(self, i):
        """(n, 2, 2) m^2, covariance of the landmarks of snapshot i on the ground."""
        return self.block[self.of(i)][:, [0, 1, 1, 2]].reshape(-1, 2, 2)

    def covariance(self, i):
        """(d, d), the joint covariance of snapshot i."""
        sizes = 3 * np.diff(self.first) + len(self.rows[1])
        d, a, b = sizes[i], sizes[:i].sum(), (sizes[:i] * (sizes[:i] + 1) // 2).sum()
        sigma = self.sigma[a:a + d].astype(float)
        R = np.zeros((d, d))
        R[np.triu_indices(d)] = self.correlation[b:b + d * (d + 1) // 2] / packing.ONE
        return (R + np.triu(R, 1).T) * np.outer(sigma, sigma)


def unpacked(explorer):
    return [Unpacked(run, explorer.data) for run in explorer.header["runs"]]


def beliefs(steps):
    """Of each half-step: predicted, updated, and born where landmarks are."""
    for step in steps:
        yield step.prior
        yield window_slam.marginalise(step.posterior, ~np.isin(step.posterior.ids, step.born))
        if len(step.born):
            yield step.posterior


def test_the_front_end_has_the_same_layout():
    """The tables at the top of explorer.js, and the indices that it reads from rows of measurements and insets."""
    module = MODULE.read_text(encoding="utf-8")
    row = dict(re.findall(r"(\w+): (\d+)", re.search(r"const ROW = \{(.*?)\};", module, re.DOTALL)[1]))
    assert {name: int(n) for name, n in row.items()} == {name: len(row) for name, (_, row) in packing.LAYOUT.items()}
    types = re.findall(r"(\w\d): ", re.search(r"const ARRAYS = \{(.*?)\};", module)[1])
    assert {dtype for dtype, _ in packing.LAYOUT.values()} == set(types)
    assert f"const ONE = {packing.ONE};" in module
    sight = packing.LAYOUT["sights"][1]
    fields = {"measured": ["u", "v"], "predicted": ["predicted u", "predicted v"], "S": ["S uu", "S uv", "S vv"],
              "projected": ["projected u", "projected v"], "pull": ["pull forward", "pull left"]}
    for name, numbers in fields.items():
        assert f"{name}: [{', '.join(f'v[{sight.index(number)}]' for number in numbers)}]" in module
    assert f"nis: v[{sight.index('nis')}], accepted: v[{sight.index('accepted')}]" in module


# --- joint filter ---


@pytest.mark.parametrize("name", STATES)
def test_every_half_step_arrives_with_its_means_and_covariance(runs, explorer, name):
    run = unpacked(explorer)[list(STATES).index(name)]
    for i, belief in enumerate(beliefs(runs[name])):
        np.testing.assert_array_equal(run.ids[run.of(i)], belief.ids)
        np.testing.assert_allclose(run.landmark[run.of(i)], belief.landmarks, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(run.pose[i, :3], belief.world_T_imu[:3, 3], rtol=1e-6, atol=1e-6)
        sigma = np.sqrt(np.diag(belief.covariance))
        error = (run.covariance(i) - belief.covariance) / np.outer(sigma, sigma)
        assert np.abs(error).max() < 2e-5, i
    assert run.name == name


@pytest.mark.parametrize("name", STATES)
def test_ellipses_are_those_of_positions_in_the_world(runs, explorer, name):
    """For the invariant filter that takes the correlation with the pose."""
    run = unpacked(explorer)[list(STATES).index(name)]
    for i, belief in list(enumerate(beliefs(runs[name])))[2::13]:
        world = world_landmark_covariance(belief, STATES[name])
        np.testing.assert_allclose(run.ellipses(i), world[:, :2, :2], rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(run.axes[run.of(i)], history.principal_sigmas(world), rtol=1e-4, atol=1e-7)


def test_series_are_the_errors_of_a_right_perturbation_with_three_sigma(runs, explorer, drive):
    for one, (name, steps) in zip(explorer.histories, runs.items()):
        heading = one["heading error"]
        for k in (0, 15, 20, 59):
            i, belief, T = one.at(k, 1), steps[k].posterior, drive.true_world_T_imu[k]
            error = se3.log(se3.inverse(belief.world_T_imu) @ T)
            claimed = right_pose_covariance(belief, STATES[name])
            assert one["forward error"].values[i] == pytest.approx(error[0], rel=1e-9)
            assert heading.values[i] == pytest.approx(np.degrees(error[5]), rel=1e-9)
            assert heading.high[i] == -heading.low[i] == pytest.approx(np.degrees(3 * np.sqrt(claimed[5, 5])))
            turn = T[:3, :3] @ belief.world_T_imu[:3, :3].T
            about_vertical = np.degrees(Rotation.from_matrix(turn).as_rotvec()[2])
            assert heading.values[i] == pytest.approx(about_vertical, abs=0.05)


def test_nis_of_a_frame_is_that_of_its_joint_gaussian(runs, drive):
    for k in (1, 30):
        step = runs["right"][k]
        prior, innovation = step.prior, step.innovation
        H = np.zeros((len(innovation.ids), 4, len(prior.covariance)))
        rows = [int(np.flatnonzero(prior.ids == j)[0]) for j in innovation.ids]
        H_landmark = drive.camera.landmark_jacobian(prior.world_T_imu, prior.landmarks)
        for j, row in enumerate(rows):
            H[j, :, 3 * row:3 * row + 3] = H_landmark[row]
        H[:, :, prior.pose] = drive.camera.pose_jacobian(prior.world_T_imu, prior.landmarks)[rows]
        H = H.reshape(-1, len(prior.covariance))
        gaussian = multivariate_normal(cov=H @ prior.covariance @ H.T + NOISE.sigma_px**2 * np.eye(len(H)))
        r = innovation.residual.ravel()
        expected = 2 * (gaussian.logpdf(0 * r) - gaussian.logpdf(r))
        value, numbers = history.frame_nis(step, drive, STATES["right"])
        assert (value, numbers) == (pytest.approx(expected, rel=1e-6), len(r))


def test_nis_of_a_frame_is_chi_square(runs, drive):
    """59 frames of a filter that is honest about its measurements: the sum of their NIS, at 99.9 %."""
    values, numbers = np.transpose([history.frame_nis(step, drive, STATES["right"]) for step in runs["right"][1:]])
    low, high = chi2.ppf([0.0005, 0.9995], numbers.sum())
    assert low < values.sum() < high


@pytest.mark.parametrize("name", STATES)
def test_pulls_add_up_to_the_correction(runs, drive, name):
    """To first order in the correction, which is a few centimetres and a few milliradians."""
    for step in runs[name][5::11]:
        pulls = history.pulls(step, drive, STATES[name])
        correction = se3.log(se3.inverse(step.prior.world_T_imu) @ step.posterior.world_T_imu)
        np.testing.assert_allclose(pulls.sum(axis=0), correction, atol=0.02 * np.abs(correction).max())
        assert not pulls[~step.innovation.accepted].any()


def test_sights_hold_the_frames_measurements(runs, explorer):
    run = unpacked(explorer)[0]
    rows, ids, numbers = run.sight, run.sight_ids, run.sights
    for k in (1, 20, 59):
        innovation = runs["right"][k].innovation
        for stage in (0, 1, 2):
            of = slice(*rows[explorer.histories[0].at(k, stage)])
            np.testing.assert_array_equal(ids[of], innovation.ids)
            np.testing.assert_allclose(numbers[of, :2], innovation.measured[:, :2], rtol=1e-6)
            np.testing.assert_allclose(numbers[of, 2:4], innovation.predicted[:, :2], rtol=1e-6)
            np.testing.assert_allclose(numbers[of, 6:9], innovation.covariance[:, [0, 0, 1], [0, 1, 1]], rtol=1e-5)
            np.testing.assert_allclose(numbers[of, 9], innovation.nis, rtol=1e-5)
            np.testing.assert_array_equal(numbers[of, 10] > 0, innovation.accepted)


def test_inset_stands_in_the_axes_of_the_belief_it_came_from(runs, explorer, drive):
    inset = unpacked(explorer)[0].inset
    step = runs["right"][20]
    prior_T_world = se3.inverse(step.prior.world_T_imu)
    moved, truth = prior_T_world @ step.posterior.world_T_imu, prior_T_world @ drive.true_world_T_imu[20]
    P = moved[:3, :3] @ step.posterior.pose_covariance[:3, :3] @ moved[:3, :3].T
    before = step.prior.pose_covariance
    expected = [P[0, 0], P[0, 1], P[1, 1], np.sqrt(step.posterior.pose_covariance[5, 5]),
                before[0, 0], before[0, 1], before[1, 1], np.sqrt(before[5, 5]),
                *moved[:2, 3], np.arctan2(moved[1, 0], moved[0, 0]),
                *truth[:2, 3], np.arctan2(truth[1, 0], truth[0, 0])]
    i = explorer.histories[0].at(20)
    np.testing.assert_allclose(inset[i], expected, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(inset[i - 1, 8:11], 0, atol=1e-7)  # a prediction stands where it stands


def test_born_and_retired_stand_in_the_half_step_in_which_they_are(runs, explorer):
    run, at = unpacked(explorer)[0], explorer.histories[0].at
    half_steps = 0
    for k, step in enumerate(runs["right"]):
        frame = [("predicted", [], step.retired.tolist()), ("updated", [], [])]
        frame += [("born", step.born.tolist(), [])] * bool(len(step.born))
        for stage, (name, born, retired) in enumerate(frame):
            assert (run.born[at(k, stage)], run.retired[at(k, stage)]) == (born, retired)
            assert explorer.header["labels"][at(k, stage)] == f"frame {k}, {step.time:.1f} s, {name}"
        half_steps += len(frame)
    assert explorer.n == half_steps == 130  # ten frames have births


def test_between_update_and_birth_stands_what_the_update_gave(runs, explorer, drive):
    """The update done again: a birth changes nothing of what is there."""
    settings = window_slam.UpdateSettings(drive.camera, NOISE, STATES["right"], chi2.ppf(0.99, 4), 1.0)
    run, one = unpacked(explorer)[0], explorer.histories[0]
    for step in (step for step in runs["right"][1:] if len(step.born)):
        i, seen = one.at(step.k, 1), step.innovation
        updated, _ = window_slam.update(step.prior, seen.ids, seen.measured, settings)
        assert run.ids[run.of(i)].tolist() == updated.ids.tolist()
        np.testing.assert_allclose(one.snapshots[i].covariance, updated.covariance, rtol=1e-9)
        np.testing.assert_allclose(one.snapshots[i].world_T_imu, updated.world_T_imu, rtol=1e-12)
        assert explorer.caption(i + 1).endswith(f"new: {', '.join(map(str, step.born))}; nothing else changes.")
    assert "nothing changes, because no landmark of the state is measured" in explorer.caption(1)


def test_two_runs_have_the_same_half_steps_where_only_one_has_a_birth(drive, runs):
    """The report's frame births first and measures after: its prior has the new landmarks, the third is idle."""
    report = list(window_slam.run(drive.slice(0, 6), NOISE, process_frame=window_slam.as_report))
    alone, both = Explorer(report, drive), Explorer({"right": runs["right"][:6], "report": report}, drive)
    assert (alone.n, both.n) == (12, 14)
    one, other = both.histories
    i = other.at(4, 0)
    assert (one.snapshots[i].born.tolist(), other.snapshots[i].born.tolist()) == ([], [14])
    assert np.allclose(other.snapshots[i].triangulated, NOISE.landmark_prior * np.eye(3))
    assert "new: 14" in both.caption(i, 1)
    assert both.caption(i + 2) == "frame 4, 0.4 s, born: new: 14; nothing else changes."
    assert both.caption(i + 2, 1) == "frame 4, 0.4 s, born: nothing changes, no birth here."


def test_motion_states_get_rows_and_names(drive):
    steps = list(window_slam.run(drive.slice(0, 4), NOISE, motion_model=TwistAndBias))
    run = unpacked(Explorer(steps, drive))[0]
    assert run.rows[1][6:] == history.MOTION_ROWS
    assert len(run.covariance(8)) == 3 * len(steps[3].posterior.ids) + 15


# --- map on given poses, pose on a given map ---


def test_map_history_holds_the_seen_landmarks_and_the_given_poses(drive, mapped):
    steps, explorer = mapped
    run = unpacked(explorer)[0]
    belief, i = steps[20].posterior, explorer.histories[0].at(20)
    np.testing.assert_array_equal(run.ids[run.of(i)], np.flatnonzero(belief.seen))
    np.testing.assert_allclose(run.ellipses(i), belief.covariance[belief.seen][:, :2, :2], rtol=1e-5)
    np.testing.assert_allclose(run.pose[i, :3], drive.true_world_T_imu[20, :3, 3], rtol=1e-6, atol=1e-6)
    assert "sigma" not in run.arrays
    assert [one["name"] for one in run.series] == ["NIS / landmark"]


def test_map_stands_still_in_the_prediction_and_shrinks_in_the_update(mapped):
    steps, explorer = mapped
    run = unpacked(explorer)[0]
    for k in range(1, len(steps)):
        i = explorer.histories[0].at(k, 0)
        np.testing.assert_array_equal(run.axes[run.of(i)], run.axes[run.of(i - 1)])
        assert "nothing changes" in explorer.caption(i)
        used = np.isin(run.ids[run.of(i)], steps[k].innovation.ids[steps[k].innovation.accepted])
        assert (run.axes[run.of(i + 1)][used].prod(axis=1) < run.axes[run.of(i)][used].prod(axis=1)).all()


def test_nis_on_a_given_map_and_on_given_poses_is_that_of_the_innovations(drive, mapped, localised):
    """Known poses make landmarks independent: the sum. A known map: the joint Gaussian over the pose."""
    step = mapped[0][20]
    value, numbers = history.frame_nis(step, drive, None, drive.true_world_T_imu[20])
    assert (value, numbers) == (pytest.approx(step.innovation.nis.sum(), rel=1e-9), 4 * len(step.innovation.ids))
    step = localised[0][13]
    H = drive.camera.pose_jacobian(step.prior.world_T_imu, drive.true_landmarks[step.innovation.ids]).reshape(-1, 6)
    S = H @ step.prior.covariance @ H.T + NOISE.sigma_px**2 * np.eye(len(H))
    r = step.innovation.residual.ravel()
    assert history.frame_nis(step, drive, None)[0] == pytest.approx(r @ np.linalg.solve(S, r), rel=1e-6)


def test_pose_history_swells_in_the_prediction_and_shrinks_in_the_update(localised):
    for i in range(1, localised[1].n):
        assert ("σ shrinks" if i % 2 else "σ grows") in localised[1].caption(i)


# --- other histories ---


def test_steps_of_a_students_own_generator_are_shown_like_the_packages(drive, runs):
    def own():
        for step in runs["right"][:3]:
            yield Step(**{f.name: getattr(step, f.name) for f in dataclasses.fields(step)})

    theirs, ours = Explorer(own(), drive), Explorer(runs["right"][:3], drive)
    assert (theirs.data, theirs.header) == (ours.data, ours.header)


def test_iterations_of_a_batch_estimate(drive):
    rng = np.random.default_rng(0)
    path = drive.true_world_T_imu[:20]
    spread = np.broadcast_to(np.eye(6), (20, 6, 6))
    ids, landmarks = np.arange(3, 8), drive.true_landmarks[3:8]
    states = [PathBelief(path, ids, landmarks + rng.normal(size=(5, 3)), np.tile(s * np.eye(3), (5, 1, 1)), s * spread)
              for s in (4.0, 1.0)]
    explorer = Explorer.from_beliefs(["iteration 0", "iteration 1"], states, drive, frames=[19, 19],
                                     series={"cost": [9.0, 2.0]})
    run = unpacked(explorer)[0]
    np.testing.assert_allclose(run.path.reshape(2, 20, 2)[1], path[:, :2, 3], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(run.path_block.reshape(2, 20, 3), [[[4, 0, 4]] * 20, [[1, 0, 1]] * 20], atol=1e-6)
    assert run.series[0]["name"] == "cost"
    assert not run.series[0]["log"]
    steep = Explorer.from_beliefs(["iteration 0", "iteration 1"], states, drive, series={"cost": [1e6, 2.0]}, start=0)
    assert (steep.half_step, steep.header["runs"][0]["series"][0]["log"]) == (0, True)
    assert "landmark 3 gains most, σ 2 → 1 m" in explorer.caption(1)
    assert repr(explorer) == "Explorer(estimate, 2 iterations)"
    assert explorer.still().png[:4] == b"\x89PNG"


def test_pairs_of_a_loop_closure_are_joint_beliefs_one_after_the_other(drive, runs):
    states = [step.posterior for step in runs["right"][:3]]
    explorer = Explorer.from_beliefs(["before", "1 pair fused", "2 pairs fused"], states, drive, unit="pair fused",
                                     frames=[0, 1, 2], captions=["a", "b", "c"])
    run = unpacked(explorer)[0]
    assert explorer.header["stage"] == [1, 1, 1]
    assert run.captions == ["a", "b", "c"]
    np.testing.assert_allclose(np.diag(run.covariance(2)), np.diag(states[2].covariance), rtol=1e-5)


def test_it_does_without_the_truth(drive, runs):
    bare = dataclasses.replace(drive, truth_world_T_cam=None, truth_landmarks=None)
    explorer = Explorer(runs["right"][:4], bare)
    assert explorer.header["truth"] == {}
    assert np.isnan(explorer.histories[0]["forward error"].values).all()
    assert explorer.still().png[:4] == b"\x89PNG"


# --- the widget ---


def test_what_cannot_be_shown_is_refused(drive, runs):
    with pytest.raises(ValueError, match="128 half-steps, expected 130 as in right"):
        Explorer({"right": runs["right"], "short": runs["right"][:-1]}, drive)
    with pytest.raises(ValueError, match="at least one step"):
        Explorer([], drive)
    with pytest.raises(ValueError, match="2 labels for 1 beliefs"):
        Explorer.from_beliefs(["a", "b"], [runs["right"][0].posterior], drive)
    with pytest.raises(KeyError, match="heading error"):
        Explorer(runs["right"][:2], drive, quantity="height")
    with pytest.raises(ValueError, match="one run or two, got 3"):
        Explorer(dict.fromkeys("abc", runs["right"][:2]), drive)


def test_more_than_a_megabyte_is_refused(drive, runs, monkeypatch):
    assert len(Explorer(runs, drive, STATES).data) < packing.LIMIT
    monkeypatch.setattr(packing, "LIMIT", 100_000)
    with pytest.raises(ValueError, match=r"takes 0\.1 MB: give fewer steps"):
        Explorer(runs["right"], drive)


def test_colours_of_both_themes_are_those_of_the_style(explorer):
    colours = explorer.header["colours"]
    assert {key: colours["light"][key] for key in style.COLOURS} == style.COLOURS
    assert set(colours["dark"]) == set(colours["light"])
    assert [run.role for run in unpacked(explorer)] == ["slam", "invariant"]


def test_numbers_in_the_still_do_not_cover_each_other_and_the_chosen_one_stays():
    figure, axes = plots.new_figure()
    numbers = [axes.annotate(name, (x, 0.5)) for name, x in (("1", 0.1), ("22", 0.101), ("3", 0.5), ("22", 0.9))]
    figure.canvas.draw()
    leave_out_covering(numbers, "22")
    assert [number.get_visible() for number in numbers] == [False, True, True, True]


def test_representation_is_fixed_and_holds_a_still_picture_with_words(explorer):
    first = repr(explorer)
    explorer.half_step = 41
    data, metadata = explorer._repr_mimebundle_()
    assert data["text/plain"] == repr(explorer) == first == "Explorer(right and invariant, 130 half-steps)"
    assert "application/vnd.jupyter.widget-view+json" in data
    assert Image.open(io.BytesIO(base64.b64decode(data["image/png"]))).size == (1000, 600)
    assert explorer.histories[0].snapshots[41].caption in metadata["image/png"]["alt"]
    assert explorer.still(41).png == base64.b64decode(data["image/png"])
    assert explorer.still(40).png != explorer.still(41).png


def test_a_page_holds_everything_and_fetches_nothing(explorer, tmp_path):
    page = explorer.save_html(tmp_path / "page.html", title="a < b").read_text(encoding="utf-8")
    assert "<title>a &lt; b</title>" in page
    assert base64.b64encode(explorer.data).decode() in page
    assert "http" not in page.replace("http-equiv", "")


def test_update_sends_other_steps_and_keeps_what_is_chosen(drive, runs):
    explorer = Explorer(runs["right"], drive, start=25, landmark=8)
    explorer.update(runs["right"][:10])
    assert (explorer.n, explorer.half_step, explorer.landmark) == (22, 21, 8)
    np.testing.assert_allclose(unpacked(explorer)[0].pose[21, :3], runs["right"][9].posterior.world_T_imu[:3, 3],
                               rtol=1e-5, atol=1e-6)


def test_what_if_runs_the_filter_again(drive, runs):
    """Twice the sigma of V: pose and NIS as a filter run here says. A measurement left out is not in its innovation."""
    what_if = WhatIf(drive, NOISE)

    def show(frame):
        what_if.explorer.half_step = what_if.explorer.histories[0].at(frame)

    what_if.factor.value = 4.0
    other = list(window_slam.run(drive, dataclasses.replace(NOISE, sigma_px=2 * NOISE.sigma_px)))
    before, after = unpacked(what_if.explorer)
    assert (before.name, after.name, what_if.explorer.show) == (AS_IT_WAS, WHAT_IF, BOTH)
    np.testing.assert_allclose(after.covariance(129).diagonal(), other[-1].posterior.covariance.diagonal(), rtol=1e-5)
    np.testing.assert_allclose(before.covariance(129).diagonal(), runs["right"][-1].posterior.covariance.diagonal(),
                               rtol=1e-5)
    what_if.factor.value = 1.0
    show(10)
    what_if.explorer.landmark = 9
    what_if.leave_out.value = LANDMARK
    assert what_if.left_out == (LANDMARK, 9)
    seen = [step.k for step in what_if.after if 9 in step.innovation.ids]
    assert not seen
    assert any(9 in step.born for step in what_if.after)
    show(20)
    ratios = what_if.ratios()
    assert ratios["9"] == max(ratios.values()) > 1.5
    assert np.mean([ratio > 1 for name, ratio in ratios.items() if name != "9"]) > 0.7
    assert "landmark 9" in what_if.text.value
    what_if.leave_out.value = FRAME
    assert what_if.left_out == (FRAME, 20)
    assert len(what_if.after[20].innovation.ids) == 0
    assert what_if.after[20].posterior.pose_covariance[0, 0] > runs["right"][20].posterior.pose_covariance[0, 0]
    assert what_if.ratios()["pose"] > 1.1
    show(25)  # the text keeps saying what was left out
    assert "Without frame 20" in what_if.text.value
    what_if.leave_out.value = NOTHING
    assert what_if.left_out is None
    show(12)  # its births come a frame later: one half-step more, and the same one is shown
    what_if.leave_out.value = FRAME
    labels = what_if.explorer.header["labels"]
    assert (what_if.explorer.n, labels[what_if.explorer.half_step]) == (131, "frame 12, 1.2 s, born")
    assert "nothing changes, no birth here" in what_if.explorer.caption(what_if.explorer.half_step, 1)


@pytest.mark.parametrize("error_state", [RightPerturbation(), RightInvariant()])
def test_world_covariance_of_the_landmarks_against_central_differences(drive, error_state):
    belief = list(window_slam.run(drive.slice(0, 20), NOISE, error_state))[-1].posterior

    def landmarks(delta):
        return error_state.retract(belief.world_T_imu, belief.landmarks, delta)[1].ravel()

    J = central_difference(landmarks, len(belief.covariance))
    full = J @ belief.covariance @ J.T
    expected = [full[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] for j in range(len(belief.ids))]
    np.testing.assert_allclose(world_landmark_covariance(belief, error_state), expected, rtol=1e-6, atol=1e-9)
