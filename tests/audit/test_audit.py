"""The audit finds what was planted, says how large it is, cures it, and leaves clean drives alone."""

import json
from functools import cache

import numpy as np
import picture_checks
import pytest
from scipy import stats
from whole import WHOLE, few

from vislam_edu import recordings, se3, simulate
from vislam_edu.audit import audit, calibration_checks, cures, imu_alignment, track_health, visual_odometry
from vislam_edu.cli import main
from vislam_edu.simulate import faults
from vislam_edu.stereo import StereoCamera

SEEDS = few(1, (11, 12))


@cache
def street(seed, frames=150, **noise):
    return simulate.street_loop(seed, frames=frames, loop_length=500, **noise)


def faults_of(report):
    return {finding.fault for finding in report.findings}


def found_and_cured(drive, *expected):
    """The report of a drive with exactly the expected faults, of which nothing is left after its cures."""
    report = audit(drive)
    assert faults_of(report) == set(expected), str(report)
    assert all(finding.p_value < 1e-4 for finding in report.findings)
    again = audit(report.cured())
    assert not again.findings, str(again)
    return report


def by(twist_factors, drive):
    return drive.replace(twists=drive.twists * twist_factors)


# --- clean drives -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", few(6, range(20)))
def test_clean_drives_raise_no_alarm(seed):
    report = audit(street(seed, frames=120))
    assert not report.findings, str(report)
    assert "Nothing found" in str(report)


@pytest.mark.parametrize(
    "noise",
    [
        {"sigma_v": 0.05, "sigma_omega": 0.005, "sigma_px": 0.3},
        {"sigma_v": 0.0, "sigma_omega": 0.0, "sigma_px": 0.5},
        {"sigma_v": 1.5, "sigma_omega": 0.2, "sigma_px": 1.5},
        {"sigma_px": 0.05},
        {"speed": 5, "visible": 14, "mean_life": 100, "life": (10, 100)},
    ],
)
def test_clean_drives_of_other_noise_raise_no_alarm(noise):
    for seed, frames in few(1, ((21, 150), (20, 60), (22, 200))):
        report = audit(street(seed, frames, **noise))
        assert not report.findings, str(report)


def test_clean_drives_with_other_mounting_and_reading():
    camera = simulate.kitti_camera()
    upside_down = StereoCamera(camera.K, 0.3, camera.cam_T_imu @ se3.exp(np.array([0.5, -2, 1, 0.3, 2, -1])))
    drive = street(3, camera=upside_down)
    assert not audit(drive).findings
    assert not audit(faults.delay_imu(drive, 1).replace(imu_sample="k+1")).findings


# --- planted faults: the IMU ------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("signs", few(1, [(-1, 1, -1), (1, -1, -1), (-1, -1, 1)]))
def test_flipped_axes(seed, signs):
    drive = street(seed)
    report = found_and_cured(faults.flip_imu_axes(drive, signs), "IMU axes")
    finding = report["IMU axes"]
    assert finding.size == np.diag(signs).tolist()
    assert f"diag({signs[0]}, {signs[1]}, {signs[2]})" in finding.text
    assert not finding.cure.needs_future
    np.testing.assert_allclose(report.cured().camera.cam_T_imu, drive.camera.cam_T_imu, atol=1e-12)


def test_turned_axes():
    """A quarter turn: forward-left-up extrinsics, samples with x to the right."""
    quarter = np.eye(4)
    quarter[:3, :3] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    drive = street(11)
    camera = StereoCamera(drive.camera.K, drive.camera.baseline, drive.camera.cam_T_imu @ quarter)
    report = found_and_cured(drive.replace(camera=camera), "IMU axes")
    np.testing.assert_allclose(report.cured().camera.cam_T_imu, drive.camera.cam_T_imu, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("axis", few(1, [2, 1]))
def test_mirrored_gyro_axis(seed, axis):
    signs = np.ones(6)
    signs[3 + axis] = -1
    drive = street(seed)
    report = found_and_cured(by(signs, drive), "mirrored axis")
    assert report["mirrored axis"].size == axis
    np.testing.assert_array_equal(report.cured().twists, drive.twists)


@pytest.mark.parametrize("degrees", few(1, [(0, 3.0, 0), (0, 0, 5.0)]))
def test_misalignment(degrees):
    turn = se3.so3_exp(np.radians(degrees))
    report = found_and_cured(cures.rotate_extrinsics(turn)(street(11)), "misalignment")
    finding = report["misalignment"]
    np.testing.assert_allclose(finding.size[1:], degrees[1:], atol=1.0)  # x, the way ahead, is known to a few degrees
    assert finding.cure.needs_future


@pytest.mark.parametrize("seed", SEEDS)
def test_translation_the_wrong_way_round(seed):
    drive = street(seed)
    report = found_and_cured(faults.wrong_lever_arm(drive), "lever arm")
    assert "-R t" in report["lever arm"].advice
    np.testing.assert_allclose(report.cured().camera.cam_T_imu, drive.camera.cam_T_imu, atol=1e-12)


@pytest.mark.parametrize("error", few(1, [(-1.2, 0, 0), (0, 0, -2.5), (-3, 0, 1)]))
def test_lever_arm(error):
    """error : m, of the IMU's position in the camera frame: ahead, sideways, both."""
    drive = street(12)
    report = found_and_cured(faults.wrong_lever_arm(drive, drive.camera.cam_T_imu[:3, 3] + error), "lever arm")
    found = report.cured().camera.imu_T_cam[:3, 3]
    np.testing.assert_allclose(found[:2], drive.camera.imu_T_cam[:2, 3], atol=0.6)
    assert report["lever arm"].cure.needs_future


@pytest.mark.parametrize("bias", few(1, [(0.05, 0, -0.03), (0.02, 0.02, 0.02), (0, 0, 0.3)]))
def test_gyro_bias(bias):
    report = found_and_cured(faults.add_gyro_bias(street(11), bias), "gyro bias")
    error = report.alignment.sigma(imu_alignment.GYRO_BIAS)
    assert (error < 0.006).all()
    assert (np.abs(np.subtract(report["gyro bias"].size, bias)) < 4 * error).all()
    assert report["gyro bias"].cure.needs_future


@pytest.mark.parametrize("samples", few(1, [2, 1, 3]))
def test_late_imu(samples):
    drive = street(11)
    report = found_and_cured(faults.delay_imu(drive, samples), "IMU timing")
    assert report["IMU timing"].size == pytest.approx(0.1 * samples, abs=0.03)
    assert not report["IMU timing"].cure.needs_future
    np.testing.assert_array_equal(report.cured().step_twists[:-samples], drive.step_twists[:-samples])


def test_reading_in_between():
    """Samples at the frames: neither the one before a step nor the one after it, but their mean."""
    drive = simulate.perfect_street_loop(11, frames=350, loop_length=500)
    instant = np.concatenate([drive.twists[:1], (drive.twists[1:] + drive.twists[:-1]) / 2])
    report = found_and_cured(simulate.add_noise(drive.replace(twists=instant), 11), "IMU timing")
    assert report.cured().imu_sample == "mean"


@pytest.mark.parametrize("scale", few(1, [0.93, 1.1]))
def test_speed_that_is_too_large_or_small(scale):
    report = found_and_cured(by([scale] * 3 + [1] * 3, street(11)), "scale conflict")
    assert report["scale conflict"].size == pytest.approx(scale, rel=0.02)


def test_a_scale_that_either_sensor_may_have_wrong_is_reported_and_not_cured():
    drive = simulate.street_loop(11, frames=400, sigma_v=0.05, sigma_px=0.3)
    report = audit(by([0.974] * 3 + [1] * 3, drive))
    assert faults_of(report) == {"scale conflict"}
    finding = report["scale conflict"]
    assert finding.cure is None
    assert "If the IMU is right" in finding.text
    assert "if the cameras are" in finding.text
    assert finding.size == pytest.approx(0.974, abs=0.005)


@pytest.mark.parametrize("scale", few(1, [1.25, 0.8]))
def test_gyro_that_is_too_fast_or_slow(scale):
    report = found_and_cured(by([1] * 3 + [scale] * 3, street(11)), "gyro scale")
    assert report["gyro scale"].size == pytest.approx(scale, rel=0.06)


# --- planted faults: the tracks ---------------------------------------------------------------------------


@pytest.mark.parametrize("frames", few(2, [None, [90], [25, 50, 75, 100, 125]]))
def test_copy_frames(frames):
    drive = street(11)
    expected = np.unique(drive.first_seen[drive.first_seen > 0]) if frames is None else np.array(frames)
    report = found_and_cured(faults.copy_frames(drive, expected), "copy frames")
    np.testing.assert_array_equal(np.flatnonzero(report.copy_steps) + 1, expected)
    assert report["copy frames"].size == len(expected)
    assert not report["copy frames"].cure.needs_future
    # Every pixel that is left is one of the unspoilt drive, and those that are right are left
    cured = report.cured()
    left = set(map(tuple, np.column_stack([cured.frame, cured.pixels])))
    before_copy = np.array([not ((expected > first) & (expected <= k)).any()
                            for first, k in zip(drive.first_seen[drive.landmark], drive.frame)])
    assert left == set(map(tuple, np.column_stack([drive.frame, drive.pixels])[before_copy]))


def test_single_frozen_tracks_are_not_copy_frames():
    drive = street(11)
    pixels = drive.pixels.copy()
    step, before, after = visual_odometry.pairs(drive)
    chosen = np.flatnonzero(step % 2 == 0)[::40]  # of every other step, so that no copy is copied on
    before, after = before[chosen], after[chosen]
    pixels[after] = pixels[before]
    report = audit(drive.replace(pixels=pixels))
    assert not report.copy_steps.any()
    assert report["frozen tracks"].size == len(after)
    assert "frozen tracks" not in audit(report.cured())


@pytest.mark.parametrize("share", few(1, [0.1, 0.02, 0.3]))
def test_outlier_tracks(share):
    report = audit(street(11, frames=250, outlier_share=share))
    assert "outlier tracks" in report
    assert faults_of(report) <= {"outlier tracks", "behind infinity"}
    # far mismatches and slow movers look right from one frame to the next
    assert 0.5 * share < report["outlier tracks"].size < share
    assert not audit(report.cured()).findings


def test_impossible_disparities():
    drive = street(11)
    chosen = np.arange(0, drive.n_landmarks, 40)
    wrong = np.isin(drive.landmark, chosen)
    pixels = drive.pixels.copy()
    pixels[wrong, 2] += 200
    report = audit(drive.replace(pixels=pixels))
    assert report["behind infinity"].size == wrong.sum()
    cured = drive.replace(pixels=pixels).apply(report["behind infinity"].cure)
    assert (track_health.disparity(cured) > -6).all()
    assert cured.n_landmarks == drive.n_landmarks - len(chosen)


def test_pair_that_is_not_rectified():
    drive = street(11)
    report = found_and_cured(drive.replace(pixels=drive.pixels + [0, 0, 0, -1.5]), "row offset")
    assert report["row offset"].size == pytest.approx(1.5, abs=0.05)


@pytest.mark.parametrize(("seed", "sign"), few(2, [(0, 1), (1, -1), (0, -1), (1, 1), (2, 1), (2, -1)]))
def test_lens_that_is_not_what_the_calibration_says(seed, sign):
    """The clean drives above raise neither alarm."""
    drive = street(seed, frames=120)
    report = audit(faults.lens_error(drive, disparity_with_u_2=3.0 * sign, row_saddle=3.0 * sign))
    assert {"row saddle", "split halves"} <= faults_of(report)
    error = calibration_checks.saddle(drive)[1]
    assert report["row saddle"].size == pytest.approx(3.0 * sign, abs=4 * error)
    assert report["row saddle"].cure is None
    by_place = calibration_checks.halves_by_place(report.drive)
    at_random = calibration_checks.halves_at_random(report.drive)
    assert by_place.p_value < 1e-4 < at_random.p_value


def test_halves_of_clean_drives_differ_by_noise_alone():
    """The squared distance is 6 times F(6, 6 pieces): its mean over drives stays within four standard errors."""
    halves = [calibration_checks.halves_by_place(street(seed, frames=120)) for seed in few(6, range(12))]
    dof = 6 * halves[0].pieces
    mean, spread = 6 * stats.f.mean(6, dof), 6 * stats.f.std(6, dof)
    assert abs(np.mean([half.distance2 for half in halves]) - mean) < 4 * spread / len(halves)**0.5


def test_missing_frames():
    drive = street(11)
    later = drive.times + np.where(np.arange(drive.n_frames) >= 100, 0.3, 0)
    report = audit(drive.replace(times=later))
    assert report["missing frames"].size == 3
    assert report["missing frames"].cure is None


# --- several at once, and the report ----------------------------------------------------------------------


def everything_wrong(seed):
    drive = faults.flip_imu_axes(faults.wrong_lever_arm(faults.add_gyro_bias(street(seed), 0.03)))
    return faults.copy_frames(faults.delay_imu(drive, 1))


@pytest.mark.parametrize("seed", SEEDS)
def test_faults_together(seed):
    spoilt = everything_wrong(seed)
    report = found_and_cured(spoilt, "copy frames", "IMU timing", "IMU axes", "lever arm", "gyro bias")
    causal = report.cured(needs_future=False)
    assert {finding.fault for finding in report.findings if finding.cure.needs_future} == {"gyro bias"}
    assert causal.history == spoilt.history + tuple(
        finding.cure.name for finding in report.findings if not finding.cure.needs_future)
    np.testing.assert_allclose(causal.camera.cam_T_imu, street(seed).camera.cam_T_imu, atol=1e-12)


def test_nothing_is_corrected_silently():
    drive = everything_wrong(11)
    fields = [array.copy() for array in (drive.twists, drive.pixels, drive.camera.cam_T_imu)]
    report = audit(drive)
    assert report.drive is drive
    for before, after in zip(fields, (drive.twists, drive.pixels, drive.camera.cam_T_imu)):
        np.testing.assert_array_equal(before, after)
    one = drive.apply(report["gyro bias"].cure)
    assert one.history == (*drive.history, report["gyro bias"].cure.name)
    np.testing.assert_array_equal(one.pixels, drive.pixels)


def test_report_reads_and_draws_and_serialises(tmp_path):
    report = audit(everything_wrong(11))
    text = str(report)
    for finding in report.findings:
        assert finding.fault in text
        assert finding.advice in " ".join(text.split())  # long lines are broken
    assert "(needs the whole drive)" in text
    again = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert [finding["fault"] for finding in again["findings"]] == [finding.fault for finding in report.findings]
    assert again["copy_frames"] == (np.flatnonzero(report.copy_steps) + 1).tolist()
    figure = report.figure()
    assert len(figure.axes) == 6
    assert all(ax.get_xlabel() and ax.get_ylabel() for ax in figure.axes)
    figure.savefig(tmp_path / "audit.png")
    picture_checks.is_large_enough(figure)
    with pytest.raises(KeyError, match="misalignment"):
        report["misalignment"]


def test_drives_too_poor_to_judge_are_still_reported():
    drive = street(11, frames=60)
    for poor in (drive.keep_landmarks(np.arange(drive.n_landmarks) < 4), drive.slice(0, 2), drive.slice(0, 1),
                 drive.keep_landmarks(np.zeros(drive.n_landmarks, bool))):
        report = audit(poor)
        assert report.alignment is None
        assert "not judged" in str(report)
        json.dumps(report.to_dict(), allow_nan=False)
        assert len(report.figure().axes) == 6


def test_command_line(tmp_path, capsys):
    recordings.save(everything_wrong(11), tmp_path / "drive.npz")
    words = ["audit", str(tmp_path / "drive.npz"), "--json", "--figure", str(tmp_path / "audit.png"), "--cured",
             str(tmp_path / "cured.npz"), "--causal"]
    assert main(words) == 0
    printed = json.loads(capsys.readouterr().out)
    assert "gyro bias" in [finding["fault"] for finding in printed["findings"]]
    assert (tmp_path / "audit.png").stat().st_size > 0
    assert faults_of(audit(recordings.load(tmp_path / "cured.npz"))) == {"gyro bias"}


# --- real recordings --------------------------------------------------------------------------------------


def real(name):
    path = recordings.find(name)
    if path is None:
        pytest.skip(f"{name}.npz is not here; put it into ../shared/data to run this")
    return recordings.load(path)


def test_03():
    report = audit(real("03"))
    assert report["copy frames"].size == 153
    assert report["IMU axes"].size == np.diag([1, -1, -1]).tolist()
    assert "the y and z axes are flipped" in report["IMU axes"].text
    assert report.signs[4] < -0.5
    assert report.signs[5] < -0.9
    assert report.cured().imu_sample == "k+1"
    assert report.facts["disparities at or below 0 px"] == 621
    assert report.facts["disparities below 1 px"] == 1408
    if WHOLE:
        assert faults_of(audit(report.cured())) <= {"row saddle", "split halves", "scale conflict"}  # no cure for these
    assert report["row saddle"].size == pytest.approx(-0.75, abs=0.2)
    assert report["scale conflict"].size == pytest.approx(0.973, abs=0.005)


def test_0027():
    report = audit(real("0027"))
    assert report["copy frames"].size == 91
    assert "IMU axes" not in report
    assert "-R t" in report["lever arm"].advice
    np.testing.assert_allclose(report["gyro bias"].size, 0.0045, atol=0.002)
    np.testing.assert_allclose(report.noise.sigma_v, 0.5, rtol=0.2)
    np.testing.assert_allclose(report.noise.sigma_omega, 0.05, rtol=0.2)
    assert report.cured().imu_sample == "k+1"
    assert report["row saddle"].size == pytest.approx(-3.9, abs=0.4)
    if WHOLE:
        assert faults_of(audit(report.cured())) == {"row saddle"}  # which has no cure
