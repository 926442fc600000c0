"""One wrong reading of a file is named as such, and what the audit cannot judge it leaves alone."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from whole import few

from vislam_edu import metrics, odometry, recordings, robust, se3, simulate
from vislam_edu.audit import audit, imu_alignment, visual_odometry, whole
from vislam_edu.cli import main
from vislam_edu.error_state import RightInvariant
from vislam_edu.noise import Noise
from vislam_edu.recordings.extrinsics import REGULAR_T_OPTICAL
from vislam_edu.recordings.features import drive_from_features
from vislam_edu.simulate import faults
from vislam_edu.stereo import StereoCamera
from vislam_edu.studies import pipeline


@cache
def street(seed=11, frames=150):
    return simulate.street_loop(seed, frames=frames, loop_length=500)


def camera(drive, **fields):
    return drive.replace(camera=replace(drive.camera, **fields))


def with_K(drive, factor=1.0, shift=0.0):
    return camera(drive, K=drive.camera.K * factor + shift)


def rows(*order):
    return lambda drive: drive.replace(pixels=drive.pixels[:, order])


def twists(v, omega):
    return lambda drive: drive.replace(twists=drive.twists * np.repeat([v, omega], 3))


def times(factor):
    return lambda drive: drive.replace(times=factor * drive.times)


def normalised(drive):
    K = drive.camera.K
    return drive.replace(pixels=(drive.pixels - np.tile(K[:2, 2], 2)) / np.tile(np.diag(K)[:2], 2))


def extrinsics(change):
    return lambda drive: drive.with_extrinsics(change(drive.camera.cam_T_imu))


MISTAKES = {
    "half size": ("images of another size", lambda drive: drive.replace(pixels=drive.pixels / 2)),
    "swapped": ("left and right swapped", rows(2, 3, 0, 1)),
    "ms": ("times in ms", times(1e3)),
    "millimetres": ("baseline in mm", lambda drive: camera(drive, baseline=1e3 * drive.camera.baseline)),
    "rows u u v v": ("rows of features", rows(0, 2, 1, 3)),
    "normalised": ("normalised coordinates", normalised),
    "x forward": ("extrinsics", extrinsics(lambda T: REGULAR_T_OPTICAL @ T)),
    "degrees": ("degrees", twists(1, 180 / np.pi)),
    "km/h": ("km/h", twists(3.6, 1)),
    "centre": ("centre of K", lambda drive: with_K(drive, shift=[[0, 0, -610], [0, 0, -173], [0, 0, 0]])),
    "focal length": ("focal length", lambda drive: with_K(drive, [[1.3, 1, 1], [1, 1.3, 1], [1, 1, 1]])),
    "double size": ("images of another size", lambda drive: drive.replace(pixels=2 * drive.pixels)),
    "rows v u": ("rows of features", rows(1, 0, 3, 2)),
    "us": ("times in us", times(1e6)),
    "ns": ("times in ns", times(1e9)),
    "inverse": ("extrinsics", extrinsics(se3.inverse)),
    "inverse, x forward": ("extrinsics", extrinsics(lambda T: se3.inverse(REGULAR_T_OPTICAL @ T))),
}


@cache
def audited(*names):
    """The report of the street with these mistakes, one after the other."""
    drive = street()
    for name in names:
        drive = MISTAKES[name][1](drive)
    return audit(drive)


@pytest.mark.parametrize("name", few(10, MISTAKES))
def test_one_wrong_reading_is_named_and_undone(name):
    fault, report = MISTAKES[name][0], audited(name)
    finding = report.findings[0]
    assert finding.fault == fault
    assert finding.whole
    assert finding.advice in report.refusal
    assert len(report.findings) == 1, str(report)
    cured, right = report.cured(), street()
    np.testing.assert_allclose(cured.times, right.times, atol=1e-9)
    np.testing.assert_allclose(cured.twists, right.twists, atol=1e-9)
    np.testing.assert_allclose(cured.camera.cam_T_imu, right.camera.cam_T_imu, atol=1e-9)
    assert cured.camera.baseline == pytest.approx(right.camera.baseline)
    if fault in ("centre of K", "focal length"):
        np.testing.assert_allclose(cured.camera.K, right.camera.K, rtol=0.05, atol=40)
    elif fault == "images of another size":
        np.testing.assert_array_equal(cured.camera.K[:2], right.camera.K[:2] * (0.5 if "half" in name else 2))
    else:
        np.testing.assert_allclose(cured.pixels, right.pixels, atol=1e-9)


@pytest.mark.parametrize("pair", few(1, [
    ("half size", "millimetres"), ("half size", "ms"), ("ms", "degrees"), ("normalised", "millimetres"),
    ("half size", "swapped"), ("half size", "km/h"), ("half size", "x forward"), ("swapped", "millimetres"),
]), ids="+".join)
def test_two_wrong_readings_at_once_are_refused(pair):
    """Refused, so nothing ends farther off than dead reckoning; both are named where one can be seen by itself."""
    report = audited(*pair)
    assert report.refusal
    assert {"ms", "millimetres"}.isdisjoint(pair) or {MISTAKES[name][0] for name in pair} <= {
        finding.fault for finding in report.findings}


@pytest.mark.parametrize("sentinel", few(1, [0.0, -999.0, 65535.0]))
def test_a_value_that_most_entries_hold_means_not_seen(sentinel):
    drive = street(frames=60)
    features = np.where(np.isnan(drive.features), sentinel, drive.features)
    report = audit(drive_from_features(drive.times, drive.twists, features, drive.camera))
    assert report["sentinel"].size == sentinel
    assert len(report.findings) == 1
    np.testing.assert_array_equal(report.cured().pixels, drive.pixels)


def test_times_in_float32():
    drive = street()
    report = audit(drive.replace(times=(3e5 + drive.times).astype(np.float32)))
    assert report["float32 times"].size == pytest.approx(2**-5)
    np.testing.assert_allclose(np.diff(report.cured().times), 0.1, atol=1e-3)


def test_no_sensor_is_that_wrong():
    """Two faults of units that no one reading explains: nothing is scaled, and nothing filtered."""
    report = audit(twists(0.454, 2.339)(street()))
    assert report["gyro scale"].whole
    assert not any(finding.cure for finding in report.findings if "scale" in finding.fault)
    assert "no sensor is that wrong" in report.refusal


def test_cures_that_move_dead_reckoning_too_far_are_not_applied():
    assert not audit(faults.add_gyro_bias(street(), (0.0, 0.0, 0.02))).too_far
    far = audit(faults.add_gyro_bias(street(), (0.0, 0.0, 0.3)))
    assert "gyro bias" in far.too_far
    assert "--force" in far.too_far


def test_tracks_from_half_size_images_end_no_farther_off_than_dead_reckoning(tmp_path, capsys):
    drive = MISTAKES["half size"][1](street())
    recordings.save(drive, tmp_path / "half.npz")
    run = ["run", str(tmp_path / "half.npz"), "--audit", "--out", str(tmp_path / "out"), "--quiet"]
    assert main(run) != 0
    said = capsys.readouterr().err
    assert "half.npz" in said
    assert "images 0.5 times as large" in said
    assert not (tmp_path / "out").exists()
    report = audited("half size")
    cured = report.cured()
    noise = pipeline.noise_of_real_drive(report.noise)
    slam = pipeline.joint(cured, noise, RightInvariant(), motion_model=robust.RealDrive,
                          process_frame=robust.process_frame)
    ends = [metrics.position_errors(drive.true_world_T_imu, path.world_T_imu)[-1]
            for path in (slam.trajectory, odometry.dead_reckon(drive, noise))]
    assert ends[0] <= ends[1]


# --- slow drives ------------------------------------------------------------------------------------------


def robot(seed, frames=400):
    """A small robot: a street loop of a car, everything five times smaller, at 30 Hz; pixels and turns are the same."""
    rng = np.random.default_rng((77, seed))
    f = rng.uniform(377, 430)
    R = REGULAR_T_OPTICAL[:3, :3].T
    large = StereoCamera(np.array([[f, 0, 320], [0, f, 240], [0, 0, 1]]), 0.475,
                         se3.pose(R, -R @ np.array([1.0, 0, 0.5])))
    drive = simulate.perfect_street_loop(seed, frames=frames, tau=1 / 30, speed=7, visible=int(rng.integers(30, 80)),
                                         life=(5, 200), mean_life=60, camera=large, image_size=(640, 480),
                                         loop_length=rng.uniform(400, 600), hills=0.3)
    T = large.cam_T_imu.copy()
    T[:3, 3] /= 5
    small = drive.replace(twists=drive.twists / np.repeat([5, 1], 3), truth_world_T_cam=None, truth_landmarks=None,
                          camera=replace(large, baseline=0.095, cam_T_imu=T))
    sigma_v, sigma_omega = ((0.05, 0.005), (0.1, 0.02))[seed % 2]
    return simulate.add_noise(small, seed, sigma_v=sigma_v, sigma_omega=sigma_omega, sigma_px=rng.uniform(0.2, 0.7))


def test_a_healthy_robot_is_not_accused():
    """At least 95 of 100 get no finding; of a few, all but one."""
    reports = [audit(robot(seed)) for seed in few(3, range(100))]
    accused = [str(report) for report in reports if report.findings]
    assert len(accused) <= max(1, len(reports) // 20), accused
    assert all(report.alignment is not None for report in reports)


def test_a_drive_without_turns_is_not_judged():
    motions = visual_odometry.estimate(street())
    straight = motions.motion.copy()
    straight[:, :3, :3] = np.eye(3)
    with pytest.raises(imu_alignment.TooFewSteps, match="turns by less"):
        imu_alignment.enough_steps(replace(motions, motion=straight))


# --- few tracks -------------------------------------------------------------------------------------------


def few_tracks(seed):
    return simulate.street_loop(seed, frames=200, visible=5, sigma_v=0.05, sigma_omega=0.002, sigma_px=0.5)


@pytest.mark.parametrize("seed", few(1, range(10)))
def test_few_tracks_tell_the_discrete_readings_by_innovations(seed):
    drive = few_tracks(seed)
    clean = audit(drive)
    assert not clean.findings
    assert "Nothing found in tracks and calibration; not judged: IMU, extrinsics, scale (" in str(clean)
    report = audit(faults.delay_imu(faults.wrong_lever_arm(drive), 1))
    assert [finding.fault for finding in report.findings] == ["IMU timing", "lever arm"]
    assert report.alignment is None
    assert report.cured().imu_sample == "k+1"
    np.testing.assert_allclose(report.cured().camera.cam_T_imu, drive.camera.cam_T_imu, atol=1e-12)


def test_surprise_is_the_summed_nis():
    """Of an honest filter: four numbers a measurement, or a little less where the tail is cut off."""
    drive = few_tracks(0)
    noise = Noise(sigma_v=0.05, sigma_omega=0.002, sigma_px=0.5)
    mean = whole.surprise(drive, noise).sum() / (len(drive.landmark) - drive.n_landmarks)
    assert 3.4 < mean < 4.4


def test_few_tracks_are_not_rescaled_and_dead_reckoning_is_recommended(tmp_path):
    recordings.save(few_tracks(0), tmp_path / "few.npz")
    assert main(["run", str(tmp_path / "few.npz"), "--audit", "--out", str(tmp_path / "out"), "--quiet"]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["recommended"] == "dead reckoning"
    assert summary["metre"] == 1.0
    assert (tmp_path / "out" / "tum" / "dead_reckoning.txt").is_file()
