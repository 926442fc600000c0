"""The lens as states of the batch: derivatives against dense matrices, planted errors found, files read and refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from vislam_edu import batch, cli, simulate
from vislam_edu.drive import DriveError
from vislam_edu.noise import Noise
from vislam_edu.simulate import faults
from vislam_edu.studies import lens_errors

IMU_SIGMA = np.array([0.02, 0.02, 0.02, 0.05])


def test_the_border_of_the_lens_solves_the_whole_system():
    drive = simulate.street_loop(seed=3, frames=12, visible=6, life=(4, 30), mean_life=20)
    plain = batch.Problem(drive, Noise(), imu_sigma=IMU_SIGMA)
    estimate = batch.start(plain, drive.true_world_T_imu)
    problem = lens_errors.with_lens(plain, estimate)
    px = np.linspace(-1, 1, len(lens_errors.PRIOR_PX))
    estimate = batch.Estimate(estimate.world_T_imu, drive.true_landmarks, estimate.imu, px)
    at = batch.linearise(problem, estimate)
    r, J = at.whole()
    by_lens = np.vstack([np.zeros((len(at.r), len(px))), at.J_lens.reshape(-1, len(px))])
    by_imu = np.pad(at.J_imu, ((0, len(r) - len(at.r)), (0, 0)))
    J = np.hstack([J.toarray(), by_imu, by_lens])
    constants = np.r_[IMU_SIGMA, problem.lens_sigma]
    H = J.T @ J + np.diag(np.r_[np.zeros(J.shape[1] - len(constants)), constants**-2])
    g = -J.T @ r - np.r_[np.zeros(J.shape[1] - len(constants)), at.r_constants / constants**2]
    normal = batch.NormalEquations(at)
    np.testing.assert_allclose(normal.g, g, rtol=1e-9, atol=1e-6)
    step = batch.Factorised(normal).solve(g[:, None])[:, 0]
    np.testing.assert_allclose(step, np.linalg.solve(H, g), rtol=1e-5, atol=1e-9)
    covariance = batch.Solution(problem, estimate, at.cost, 0).lens_covariance()
    np.testing.assert_allclose(covariance, np.linalg.inv(H)[-len(px):, -len(px):], rtol=1e-5, atol=1e-10)


def test_planted_errors_are_found_within_their_sigmas():
    """Normalised squared error of seven numbers over eight seeds: a chi-square with 56 degrees of freedom, 26 to 99.

    With the shifts taken at the measured pixels instead the focal length is off by 3 sigma, and the sum is 110.
    """
    total = 0.0
    for seed in range(8):
        drawn = np.random.default_rng((seed, 99)).standard_normal(len(lens_errors.PRIOR_PX))
        px = {name: sigma * z for (name, sigma), z in zip(lens_errors.PRIOR_PX.items(), drawn)}
        drive = faults.lens_error(simulate.street_loop(seed, frames=100, visible=30), **px)
        found, smoothed = lens_errors.estimate(batch.Problem(drive, Noise()))
        error = np.array([found.px[name] - px[name] for name in px])
        total += error @ np.linalg.solve(smoothed.solution.lens_covariance(), error)
    assert 26 < total < 99


def test_one_drive_calibrates_another(tmp_path):
    px = {"disparity_with_u_2": 3.0, "disparity_with_v_2": -2.0}
    one, other = (simulate.street_loop(seed, frames=60, visible=30) for seed in (1, 2))
    lens_errors.estimate(batch.Problem(faults.lens_error(one, **px), Noise()))[0].save(tmp_path / "lens.json")
    bent = faults.lens_error(other, **px)
    cured = lens_errors.load(tmp_path / "lens.json").corrected(bent)

    def bend(drive):
        """RMS error of the disparity, px."""
        return np.sqrt(np.mean(((drive.pixels - other.pixels) @ [1, 0, -1, 0])**2))

    assert bend(cured) < 0.4 * bend(bent)
    camera = replace(other.camera, K=other.camera.K * [[1.2], [1.2], [1.0]])
    with pytest.raises(DriveError, match="learnt with a focal length"):
        lens_errors.load(tmp_path / "lens.json").corrected(other.replace(camera=camera))


def test_what_is_no_lens_is_refused(tmp_path, capsys):
    path = tmp_path / "lens.json"
    for text in ("", "[]", json.dumps({"px": {}})):
        path.write_text(text)
        with pytest.raises(DriveError, match="not a lens"):
            lens_errors.load(path)
    for options in (["--lens"], ["--lens", "--audit", "--causal"]):
        assert cli.main(["run", "first_steps", "--out", str(tmp_path / "out"), *options]) == 2
        assert "--lens needs --audit" in capsys.readouterr().err
