"""An outside reference: GTSAM's fixed-lag smoother beside our filter, on the same cured recording, in one run.

    pip install "vislam_edu[gtsam]"
    python benchmarks/gtsam_reference.py [RECORDING GROUND_TRUTH ...] [--out FILE]

The smoother re-linearises the last 30 frames, what a filter cannot; it has the same pixels and the same IMU samples,
the bias already subtracted. Its robust loss stands where our gate stands. Accuracy is that of each frame's newest
estimate for both, so that both know the same; the smoother's pose on leaving the window, which knows 30 frames more,
is told beside it. Seconds are of the CPU (`time.process_time`, all threads), reading and auditing not counted; the two
take turns, and of each the least is told, because even CPU time grows on a busy machine.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: CPU seconds are compared, of one core

import argparse
import time
from importlib.metadata import version

import numpy as np
import real_drives

from vislam_edu import se3
from vislam_edu.audit import audit
from vislam_edu.motion import TwistAndBias
from vislam_edu.studies import pipeline

try:
    import gtsam
except ImportError:
    gtsam = None
else:
    VERSION = version("gtsam")

LAG = 30  # frames
HUBER = 1.345  # sigma
GROSS = 30.0  # px: further from its prediction a measurement is no measurement of that landmark; robust or not, it
#                makes the system indeterminate
NEAR, FAR = 2.0, 100.0  # m, depth at which a landmark may begin
REPEATS = 3
LANDMARK_PRIOR = 100.0  # m: says next to nothing, but keeps a landmark with one far view determined


def pose_key(k):
    return gtsam.symbol("x", k)


def landmark_key(i):
    return gtsam.symbol("l", int(i))


class FixedLagSmoother:
    """Poses and landmarks of the last `LAG` frames as a factor graph.

    drive : Drive, cured. noise : Noise, the filter's.
    """

    def __init__(self, drive, noise):
        self.drive = drive
        K = drive.camera.K
        self.calibration = gtsam.Cal3_S2Stereo(K[0, 0], K[1, 1], K[0, 1], K[0, 2], K[1, 2], drive.camera.baseline)
        self.imu_T_cam = gtsam.Pose3(drive.camera.imu_T_cam)
        pixel = gtsam.noiseModel.Diagonal.Sigmas(noise.sigma_px * np.array([1.0, 1.0, 0.5**0.5]))  # u_left, u_right, v
        self.pixel = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(HUBER), pixel)
        self.landmark_prior = gtsam.noiseModel.Isotropic.Sigma(3, LANDMARK_PRIOR)
        self.imu_sigmas = np.array([noise.sigma_omega] * 3 + [noise.sigma_v] * 3)  # GTSAM's order: rotation first
        self.start_sigmas = np.sqrt(np.diag(noise.initial_pose_covariance))[[3, 4, 5, 0, 1, 2]]
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(0.01)
        parameters.relinearizeSkip = 1
        self.smoother = gtsam.IncrementalFixedLagSmoother(float(LAG), parameters)
        self.known = {}  # landmark -> frame of its last view

    def run(self):
        """Yield for each frame k its newest pose and that of frame k - LAG + 1 (or None), world_T_imu (4, 4)."""
        pose = np.eye(4)
        for k in range(self.drive.n_frames):
            graph, values, stamps = gtsam.NonlinearFactorGraph(), gtsam.Values(), {pose_key(k): float(k)}
            if k == 0:
                graph.add(gtsam.PriorFactorPose3(pose_key(0), gtsam.Pose3(pose),
                                                 gtsam.noiseModel.Diagonal.Sigmas(self.start_sigmas)))
            else:
                tau = self.drive.taus[k - 1]
                increment = se3.exp(tau * self.drive.step_twists[k - 1])
                pose = pose @ increment
                graph.add(gtsam.BetweenFactorPose3(pose_key(k - 1), pose_key(k), gtsam.Pose3(increment),
                                                   gtsam.noiseModel.Diagonal.Sigmas(tau * self.imu_sigmas)))
            values.insert(pose_key(k), gtsam.Pose3(pose))
            self._look(k, pose, graph, values, stamps)
            self.smoother.update(graph, values, stamps)
            pose = self.smoother.calculateEstimatePose3(pose_key(k)).matrix()
            leaving = k - LAG + 1
            yield pose, self.smoother.calculateEstimatePose3(pose_key(leaving)).matrix() if leaving >= 0 else None

    def _look(self, k, pose, graph, values, stamps):
        """Add the factors of frame k's pixels, and the landmarks that begin here."""
        camera = self.drive.camera
        ids, pixels = self.drive.observed(k)
        points, ok = camera.triangulate(pixels, 1.0)
        begins = ok & (points[:, 2] > NEAR) & (points[:, 2] < FAR)
        world = camera.to_world(pose, points)
        for i, z, may_begin, point in zip(ids, pixels, begins, world):
            key = landmark_key(i)
            alive = self.known.get(i, -np.inf) >= k - 1 - LAG  # what the last update left in the window
            if alive:
                estimate = self.smoother.calculateEstimatePoint3(key)
                predicted, in_front = camera.observe(pose, estimate)
                if not in_front or np.abs(predicted - z).max() > GROSS:
                    continue
            elif may_begin:
                values.insert(key, point)
                graph.add(gtsam.PriorFactorPoint3(key, point, self.landmark_prior))
            else:
                continue
            measured = gtsam.StereoPoint2(z[0], z[2], (z[1] + z[3]) / 2)
            graph.add(gtsam.GenericStereoFactor3D(
                measured, self.pixel, pose_key(k), key, self.calibration, False, False, self.imu_T_cam))
            stamps[key] = float(k)
            self.known[i] = k


def smoothed(drive, noise) -> dict:
    """Accuracy and CPU seconds of the fixed-lag smoother."""
    newest, lagged = [], []
    begin = time.process_time()
    for pose, leaving in FixedLagSmoother(drive, noise).run():
        newest.append(pose)
        if leaving is not None:
            lagged.append(leaving)
    seconds = time.process_time() - begin
    late = np.array(lagged + newest[len(lagged):])  # the last frames never leave the window
    after = real_drives.accuracy(drive, late)
    return {**real_drives.accuracy(drive, np.array(newest)), "cpu_s": seconds,
            "leaving_window": {"drift_percent": after["drift_percent"], "ate_m": after["ate_m"]}}


def compare(drive) -> dict:
    """The numbers of both on one drive; prints them."""
    report = audit(drive)
    cured, noise = report.cured(), pipeline.noise_of_real_drive(report.noise)
    runs = [(real_drives.filtered(cured, noise, motion_model=TwistAndBias), smoothed(cured, noise))
            for _ in range(REPEATS)]
    ours, theirs = (min(of_one, key=lambda run: run["cpu_s"]) for of_one in zip(*runs))
    print(drive.name)
    for name, row in (("this package, right-invariant filter", ours), (f"GTSAM {VERSION}, {LAG} frames", theirs)):
        print(f"  {name:38}{row['drift_percent']:6.2f} %{row['ate_m']:7.2f} m{row['cpu_s']:8.1f} s CPU")
    late = theirs["leaving_window"]
    print(f"  {'GTSAM, poses leaving the window':38}{late['drift_percent']:6.2f} %{late['ate_m']:7.2f} m")
    print(f"  ours needs {theirs['cpu_s'] / ours['cpu_s']:.1f} times less")
    return {"version": VERSION, "lag_frames": LAG, "ours": ours, "gtsam": theirs}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    real_drives.add_arguments(parser)
    arguments = parser.parse_args()
    if gtsam is None:
        raise SystemExit('this benchmark needs GTSAM, which the package does not: pip install "vislam_edu[gtsam]"')
    for drive in real_drives.drives(arguments):
        real_drives.store(arguments.out, {drive.name: {"gtsam": compare(drive)}})


if __name__ == "__main__":
    main()
