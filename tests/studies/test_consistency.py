"""Statistics over seeds: which filters are honest, which are not, and that the study itself is repeatable."""

import functools
import json

import joblib
import numpy as np
import pytest

from vislam_edu import metrics, se3, simulate, window_slam
from vislam_edu.cli import main
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.studies import consistency

# Small drives for speed. The gyro is bad and the car fast, so that second-order effects of rotation, which the
# left Jacobian of the retraction is there for, stand out; pixels are good, so a landmark's depth is Gaussian.
SENSORS = {"sigma_omega": 0.1, "sigma_px": 0.3}
NOISE = Noise(**SENSORS)
SEEDS = range(16)
make_drive = functools.partial(simulate.street_loop, frames=100, speed=20, loop_length=500, visible=16,
                               **SENSORS)
make_short_drive = functools.partial(simulate.street_loop, frames=12, loop_length=500, visible=10)


class NoLeftJacobian(RightInvariant):
    """Broken on purpose: every translation is corrected by x instead of J_l x."""

    def retract(self, world_T_imu, landmarks, delta):
        n = len(landmarks)
        turn = se3.so3_exp(delta[3 * n + 3:])
        points = np.concatenate([landmarks, world_T_imu[None, :3, 3]]) @ turn.T
        points += delta[:3 * n + 3].reshape(-1, 3)
        return se3.pose(turn @ world_T_imu[:3, :3], points[-1]), points[:-1]


class NoNoiseOnLandmarks(RightInvariant):
    """Broken on purpose: noise turns the pose but, in these coordinates, leaves the landmarks alone."""

    def landmark_transition(self, landmarks, B):
        return np.zeros((len(landmarks), 3, 6))


def study_of(error_state, seeds, **options):
    filters = {"it": consistency.FilterConfig(NOISE, error_state, options)}
    return consistency.monte_carlo(make_drive, filters, seeds)["it"]


# --- honest and dishonest filters ---------------------------------------------------------------------------


def test_the_right_invariant_filter_is_honest():
    study = study_of(RightInvariant(), SEEDS)
    for nees, dof in [(study.nees_pose, 6), (study.nees_rotation, 3), (study.nees_position, 3)]:
        low, high = metrics.chi2_band(dof, len(SEEDS))
        assert low < nees.mean() < high


def test_it_is_not_without_the_left_jacobian():
    assert study_of(NoLeftJacobian(), SEEDS).nees_pose.mean() > metrics.chi2_band(6, len(SEEDS))[1]


@pytest.mark.parametrize(("error_state", "options"), [
    (NoNoiseOnLandmarks(), {}),
    (RightPerturbation(), {}),
    (RightPerturbation(), {"process_frame": window_slam.as_report}),
], ids=["noise on the pose alone", "right perturbation", "as report"])
def test_four_drives_show_these_to_be_overconfident(error_state, options):
    seeds = SEEDS[:4]
    high = metrics.chi2_band(6, len(seeds), probability=0.9999)[1]
    assert study_of(error_state, seeds, **options).nees_pose.mean() > high


def in_world_coordinates(error_state, belief):
    W = error_state.world_pose(belief.world_T_imu)
    return W @ belief.pose_covariance @ W.T


def last(drive, noise, error_state):
    *_, step = window_slam.run(drive, noise, error_state, gate=1)
    return step.posterior


def test_with_tiny_noise_both_errors_make_the_same_filter():
    """They differ in the second order only: noise ten times as small leaves a hundredth of the difference."""
    tiny = {"sigma_v": 1e-6, "sigma_omega": 1e-7, "sigma_px": 1e-6}
    drive = simulate.street_loop(seed=1, frames=60, visible=16, loop_length=500, **tiny)
    noise = Noise(**tiny, initial_pose_covariance=1e-14 * np.eye(6))
    right, invariant = (last(drive, noise, error_state)
                        for error_state in (RightPerturbation(), RightInvariant()))
    # They agree with each other far better than with the truth, so there was something to agree on.
    assert np.abs(right.world_T_imu - drive.true_world_T_imu[-1]).max() > 5e-8
    np.testing.assert_allclose(right.world_T_imu, invariant.world_T_imu, rtol=0, atol=1e-9)
    np.testing.assert_allclose(right.landmarks, invariant.landmarks, rtol=0, atol=1e-9)


@pytest.mark.usefixtures("first_order")
def test_where_nothing_is_corrected_both_errors_make_the_same_filter():
    """On a noise-free drive no estimate moves, so all Jacobians are taken at the truth."""
    drive = simulate.perfect_street_loop(seed=1, frames=60, visible=16, loop_length=500)
    right, invariant = RightPerturbation(), RightInvariant()
    a, b = last(drive, Noise(), right), last(drive, Noise(), invariant)
    np.testing.assert_allclose(a.world_T_imu, b.world_T_imu, rtol=0, atol=1e-9)
    np.testing.assert_allclose(in_world_coordinates(right, a), in_world_coordinates(invariant, b),
                               rtol=1e-6, atol=1e-9)


# --- the study itself ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("error_state", [RightPerturbation(), RightInvariant()], ids=lambda e: e.name)
def test_the_initial_pose_is_as_far_off_as_the_filter_claims(error_state):
    drive = make_short_drive(0)
    candidate = consistency.FilterConfig(Noise(), error_state)
    starts = np.array([consistency.initial_pose(drive, candidate, seed) for seed in range(1000)])
    nees = metrics.pose_nees(error_state, drive.true_world_T_imu[0], starts,
                             candidate.noise.initial_pose_covariance).pose
    low, high = metrics.chi2_band(6, len(starts))
    assert low < nees.mean() < high


def same(a, b):
    return all(np.array_equal(getattr(a[name], key), getattr(b[name], key))
               for name in a for key in ("seeds", *consistency._FIELDS))


def test_a_study_is_the_same_on_any_number_of_workers_and_when_resumed(tmp_path):
    filters = consistency.standard_filters(Noise())
    alone = consistency.monte_carlo(make_short_drive, filters, range(3), tmp_path)
    with joblib.parallel_config(n_jobs=2):
        assert same(alone, consistency.monte_carlo(make_short_drive, filters, range(3)))

    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files] == [f"seed_{seed:05d}.npz" for seed in range(3)]
    files[1].unlink()
    before = [files[i].stat().st_mtime_ns for i in (0, 2)]
    assert same(alone, consistency.monte_carlo(make_short_drive, filters, range(3), tmp_path))
    assert [files[i].stat().st_mtime_ns for i in (0, 2)] == before


@pytest.mark.filterwarnings("ignore")  # dask's own, of its sockets and event loop
def test_a_study_is_the_same_on_a_dask_cluster():
    distributed = pytest.importorskip("distributed", reason="dask is an extra: pip install distributed")
    filters = consistency.standard_filters(Noise())
    alone = consistency.monte_carlo(make_short_drive, filters, range(3))
    with (distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
          distributed.Client(cluster), joblib.parallel_config(backend="dask")):
        assert same(alone, consistency.monte_carlo(make_short_drive, filters, range(3)))


def test_runs_of_another_study_are_not_taken_for_this_one(tmp_path):
    filters = consistency.standard_filters(Noise())
    consistency.monte_carlo(make_short_drive, filters, [0], tmp_path)
    with pytest.raises(ValueError, match=r"seed_00000\.npz belongs to a study of other drives or filters"):
        consistency.monte_carlo(functools.partial(make_short_drive, sigma_v=0.4), filters, [0], tmp_path)
    with pytest.raises(ValueError, match="another directory"):
        consistency.monte_carlo(make_short_drive, consistency.standard_filters(Noise(sigma_v=0.4)), [0], tmp_path)


@pytest.mark.parametrize("seeds", [[], [3, 3]])
def test_seeds_must_be_there_and_differ(seeds):
    with pytest.raises(ValueError, match="seeds"):
        consistency.monte_carlo(make_short_drive, {}, seeds)


@pytest.mark.usefixtures("first_order")
def test_the_error_is_seen_from_the_start_and_in_the_world():
    """A start with a wrong heading on a noise-free drive: wrong in the world, right as seen from the start."""
    drive = simulate.perfect_street_loop(seed=1, frames=40, visible=16, loop_length=500)
    start = se3.exp(np.array([0, 0, 0, 0, 0, 0.1]))
    run = consistency.judge(drive, consistency.FilterConfig(Noise(), RightInvariant()), start)
    from_axis = np.linalg.norm(drive.true_world_T_imu[:, :2, 3], axis=-1)
    np.testing.assert_allclose(run["error_world"], 2 * np.sin(0.05) * from_axis, atol=1e-6)
    np.testing.assert_allclose(run["error"], 0, atol=1e-6)
    assert run["nees_rotation"][0] == pytest.approx(0.1**2 / 1e-4)


def test_the_command_writes_its_summary(tmp_path, capsys):
    assert main(["consistency", "--seeds", "2", "--frames", "6", "--out", str(tmp_path), "--sigma-v", "0.2"]) == 0
    figures = json.loads((tmp_path / "summary.json").read_text())
    assert figures["band_99"] == list(metrics.chi2_band(6, 2))
    assert (figures["runs"], figures["frames"], figures["sigma_v"]) == (2, 6, 0.2)
    printed = capsys.readouterr().out
    for name in ["report_values", "report", "right_perturbation", "right_invariant", "inverse_depth"]:
        assert name in printed
        assert {"nees_pose", "nees_rotation", "nees_position", "nis", "rmse_m"} <= figures[name].keys()


@pytest.mark.parametrize(("options", "said"), [
    (["--seeds", "0"], "--seeds: 0 is not a whole number of at least 1"),
    (["--sigma-px", "0"], "--sigma-px: 0 is not a number above 0"),
    (["--frames", "3"], "frames must be at least 2 and at least the shortest life 5"),
], ids=lambda value: value[0] if isinstance(value, list) else "")
def test_bad_input_to_the_command_ends_in_one_line(options, said, tmp_path, capsys):
    try:
        status = main(["consistency", "--out", str(tmp_path), *options])
    except SystemExit as stopped:  # argparse leaves this way
        status = stopped.code
    assert status == 2
    assert said in capsys.readouterr().err.splitlines()[-1]  # after what the progress bar wrote
