"""The batch estimate's objective, written a second time with GTSAM's factors: are the costs the same?

    pip install "vislam_edu[gtsam]"
    python benchmarks/gtsam_batch.py [RECORDING GROUND_TRUTH ...]

First the simulated street, then each recording, cured, with everything a real drive needs: the walk of the twist, the
bias, the robust loss. Both start at dead reckoning and take turns in one process, on one core. Pixels are GTSAM's
stereo factors, the prior is its pose factor. GTSAM has no factor for the IMU's residual,
S log(T_k^-1 T_{k+1}) / tau + [0, b] - u_k (its BetweenFactor takes the logarithm of the error), so that is a custom
factor made of GTSAM's own logarithm and its derivative; the walk likewise. Both costs are sums of squares, without a
half. The figures go to results/gtsam.json, which chapter 11 reads.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: CPU seconds are compared, of one core

import argparse
import time
from pathlib import Path

import batch_real
import numpy as np
import real_drives

from vislam_edu import batch, metrics, simulate
from vislam_edu.audit import audit
from vislam_edu.error_state import RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.studies import pipeline

try:
    import gtsam
except ImportError:
    gtsam = None

ROTATION_FIRST = [3, 4, 5, 0, 1, 2]  # GTSAM orders a twist [omega, v]


def pose_key(k):
    return gtsam.symbol("x", int(k))


def landmark_key(i):
    return gtsam.symbol("l", int(i))


BIAS = 0  # key of the gyro bias


def twist_between(values, k, tau):
    """The twist along a step, [omega, v], and its derivatives by the two poses, GTSAM's logarithm."""
    step = values.atPose3(pose_key(k)).between(values.atPose3(pose_key(k + 1)))
    by_step = gtsam.Pose3.LogmapDerivative(step) / tau
    return gtsam.Pose3.Logmap(step) / tau, -by_step @ step.inverse().AdjointMap(), by_step


def imu_factor(k, sample, tau, sigmas):
    """log(T_k^-1 T_{k+1}) / tau + [b, 0] - u_k."""

    def error(_, values, jacobians):
        twist, by_this, by_next = twist_between(values, k, tau)
        if jacobians is not None:
            jacobians[0], jacobians[1], jacobians[2] = by_this, by_next, np.eye(6, 3)
        return twist - sample[ROTATION_FIRST] + np.pad(values.atVector(BIAS), (0, 3))

    keys = [pose_key(k), pose_key(k + 1), BIAS]
    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(sigmas), keys, error)


def walk_factor(k, taus, sigmas):
    """xi_{k+1} - xi_k, where xi is the twist along a step."""

    def error(_, values, jacobians):
        before, *by_before = twist_between(values, k, taus[k])
        after, *by_after = twist_between(values, k + 1, taus[k + 1])
        if jacobians is not None:
            jacobians[0], jacobians[1], jacobians[2] = -by_before[0], by_after[0] - by_before[1], by_after[1]
        return after - before

    keys = [pose_key(k), pose_key(k + 1), pose_key(k + 2)]
    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(sigmas), keys, error)


def same_problem(problem, estimate):
    """A `batch.Problem` whose speed has no scale to find as a factor graph, and an `Estimate` as its values."""
    drive, noise = problem.drive, problem.noise
    K = drive.camera.K
    calibration = gtsam.Cal3_S2Stereo(K[0, 0], K[1, 1], 0.0, K[0, 2], K[1, 2], drive.camera.baseline)
    imu_T_cam = gtsam.Pose3(drive.camera.imu_T_cam)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    prior = noise.initial_pose_covariance[np.ix_(ROTATION_FIRST, ROTATION_FIRST)]
    graph.add(gtsam.PriorFactorPose3(pose_key(0), gtsam.Pose3(problem.prior_world_T_imu),
                                     gtsam.noiseModel.Gaussian.Covariance(prior)))
    sigmas = np.repeat([noise.sigma_omega, noise.sigma_v], 3)
    for k, (sample, tau) in enumerate(zip(drive.step_twists, drive.taus)):
        graph.add(imu_factor(k, sample, tau, sigmas))
    if problem.walk_sigma is not None:
        for k in range(drive.n_frames - 2):
            graph.add(walk_factor(k, drive.taus, np.repeat(problem.walk_sigma[::-1], 3)))
    known = 1e-9  # rad/s: what is not to be found is held
    graph.add(gtsam.PriorFactorVector(BIAS, np.zeros(3), gtsam.noiseModel.Diagonal.Sigmas(
        np.where(problem.imu_sigma[:3] > 0, problem.imu_sigma[:3], known))))
    pixel = gtsam.noiseModel.Diagonal.Sigmas(noise.sigma_px * np.array([1.0, 1.0, 0.5**0.5]))  # u_left, u_right, v
    if problem.loss is batch.cauchy:
        pixel = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(2.0), pixel)
    for k, i, z in zip(drive.frame, problem.landmark, drive.pixels):
        graph.add(gtsam.GenericStereoFactor3D(gtsam.StereoPoint2(z[0], z[2], (z[1] + z[3]) / 2), pixel,
                                              pose_key(k), landmark_key(i), calibration, imu_T_cam))
    values.insert(BIAS, estimate.imu[:3])
    for k, T in enumerate(estimate.world_T_imu):
        values.insert(pose_key(k), gtsam.Pose3(T))
    for i in np.unique(problem.landmark):
        values.insert(landmark_key(i), estimate.landmarks[i])
    return graph, values


def compare(problem, tolerance) -> dict:
    """Both solvers on one problem, each from dead reckoning to its own end.

    Returns {"cost_there": GTSAM's cost at our estimate, "ours": numbers, "gtsam": numbers}.
    """
    begin, since = batch.start(problem), time.process_time()
    solution = batch.solve(problem, begin, tolerance)
    numbers = {"ours": {"cost": solution.cost, "iterations": solution.iterations,
                        "cpu_s": time.process_time() - since}}
    graph, values = same_problem(problem, solution.estimate)
    numbers["cost_there"] = 2 * graph.error(values)

    start, settings = same_problem(problem, begin)[1], gtsam.LevenbergMarquardtParams()
    settings.setAbsoluteErrorTol(tolerance / 2)
    settings.setRelativeErrorTol(0.0)
    settings.setLinearSolverType("MULTIFRONTAL_QR")  # its Cholesky finds the street indeterminate, and stops too early
    since = time.process_time()
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, settings)
    theirs = optimizer.optimize()
    numbers["gtsam"] = {"cost": 2 * graph.error(theirs), "iterations": optimizer.iterations(),
                        "cpu_s": time.process_time() - since}
    if problem.drive.truth_world_T_cam is not None:
        frames = np.arange(batch_real.EVERY, problem.drive.n_frames, batch_real.EVERY)
        marginals, back = gtsam.Marginals(graph, theirs), np.argsort(ROTATION_FIRST)
        poses = np.array([theirs.atPose3(pose_key(k)).matrix() for k in range(problem.drive.n_frames)])
        covariance = np.array([marginals.marginalCovariance(pose_key(k)) for k in frames])[:, back][:, :, back]
        numbers["ours"] |= judged(problem.drive, solution.estimate.world_T_imu, frames,
                                  solution.pose_covariance(frames))
        numbers["gtsam"] |= judged(problem.drive, poses, frames, covariance)
    return numbers


def judged(drive, poses, frames, covariance) -> dict:
    """Accuracy of a path and its mean pose NEES at some frames, covariance (n, 6, 6) of the right perturbation."""
    truth = drive.true_world_T_imu[frames]
    known = np.isfinite(truth[:, 0, 0])
    nees = metrics.pose_nees(RightPerturbation(), truth[known], poses[frames[known]], covariance[known])
    return {**real_drives.accuracy(drive, poses), "mean_nees": float(nees.pose.mean())}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    real_drives.add_arguments(parser)
    parser.set_defaults(out=Path(__file__).parent / "results" / "gtsam.json")
    arguments = parser.parse_args()
    if gtsam is None:
        raise SystemExit('this benchmark needs GTSAM, which the package does not: pip install "vislam_edu[gtsam]"')
    street = batch.Problem(simulate.street_loop(), Noise())
    cases = [("street loop", street, 1e-2)]
    for drive in real_drives.drives(arguments):
        report = audit(drive)
        cured = report.cured()
        cases.append((drive.name, pipeline.batch_of_real_drive(cured, pipeline.noise_of_real_drive(report.noise)),
                      100.0))  # robust weights settle slowly: both stop early, at the same fall of the cost
    for name, problem, tolerance in cases:
        numbers = compare(problem, tolerance)
        print(f"{name}: cost at our estimate {numbers['ours']['cost']:.3f} here, {numbers['cost_there']:.3f} in GTSAM")
        for who in ("ours", "gtsam"):
            print(f"  {who:6s} " + "  ".join(f"{key} {value:.4g}" for key, value in numbers[who].items()))
        real_drives.store(arguments.out, {name: numbers})


if __name__ == "__main__":
    main()
