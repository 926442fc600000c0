"""The batch estimate's objective, written a second time with GTSAM's factors: are the costs the same?

    pip install "vislam_edu[gtsam]"
    python benchmarks/gtsam_batch.py [--frames N]

Pixels are GTSAM's stereo factors, the prior is its pose factor. GTSAM has no factor for the IMU's residual,
log(T_k^-1 T_{k+1}) / tau - u_k (its BetweenFactor takes the logarithm of the error), so that is a custom factor made of
GTSAM's own logarithm and its derivative. Both costs are sums of squares, without a half.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: CPU seconds are compared, of one core

import argparse
import time

import numpy as np

from vislam_edu import batch, simulate
from vislam_edu.noise import Noise

try:
    import gtsam
except ImportError:
    gtsam = None

ROTATION_FIRST = [3, 4, 5, 0, 1, 2]  # GTSAM orders a twist [omega, v]


def pose_key(k):
    return gtsam.symbol("x", int(k))


def landmark_key(i):
    return gtsam.symbol("l", int(i))


def imu_factor(k, sample, tau, sigmas):
    """log(T_k^-1 T_{k+1}) / tau - u_k, GTSAM's logarithm."""

    def error(_, values, jacobians):
        this, following = (values.atPose3(key) for key in (pose_key(k), pose_key(k + 1)))
        step = this.between(following)
        if jacobians is not None:
            by_step = gtsam.Pose3.LogmapDerivative(step) / tau
            jacobians[0] = -by_step @ step.inverse().AdjointMap()
            jacobians[1] = by_step
        return gtsam.Pose3.Logmap(step) / tau - sample[ROTATION_FIRST]

    return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(sigmas), [pose_key(k), pose_key(k + 1)], error)


def same_problem(problem, estimate):
    """A `batch.Problem` without walk, bias and robust loss as a factor graph, and an `Estimate` as its values."""
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
    pixel = gtsam.noiseModel.Diagonal.Sigmas(noise.sigma_px * np.array([1.0, 1.0, 0.5**0.5]))  # u_left, u_right, v
    for k, i, z in zip(drive.frame, problem.landmark, drive.pixels):
        graph.add(gtsam.GenericStereoFactor3D(gtsam.StereoPoint2(z[0], z[2], (z[1] + z[3]) / 2), pixel,
                                              pose_key(k), landmark_key(i), calibration, imu_T_cam))
    for k, T in enumerate(estimate.world_T_imu):
        values.insert(pose_key(k), gtsam.Pose3(T))
    for i in np.unique(problem.landmark):
        values.insert(landmark_key(i), estimate.landmarks[i])
    return graph, values


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=500)
    frames = parser.parse_args().frames
    if gtsam is None:
        raise SystemExit('this benchmark needs GTSAM, which the package does not: pip install "vislam_edu[gtsam]"')
    problem = batch.Problem(simulate.street_loop_data().slice(0, frames), Noise())
    begin = batch.start(problem)

    since = time.process_time()
    solution = batch.solve(problem, begin, tolerance=1e-8)
    ours = time.process_time() - since

    graph, values = same_problem(problem, solution.estimate)
    there = 2 * graph.error(values)
    since = time.process_time()
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, same_problem(problem, begin)[1])
    theirs_cost = 2 * graph.error(optimizer.optimize())
    theirs = time.process_time() - since
    print(f"cost at our estimate: {solution.cost:.3f} here, {there:.3f} in GTSAM")
    print(f"each from dead reckoning to its own end: {solution.cost:.3f} here, {theirs_cost:.3f} in GTSAM")
    print(f"CPU: {ours:.1f} s and {solution.iterations} steps here, {theirs:.1f} s and {optimizer.iterations()} in"
          " GTSAM (its IMU factors are Python)")


if __name__ == "__main__":
    main()
