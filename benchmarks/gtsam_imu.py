"""Preintegration beside GTSAM's: the same samples, joined by both.

    pip install "vislam_edu[gtsam]"
    python benchmarks/gtsam_imu.py

For motions of 0.1, 0.5 and 2 s of a simulated street and for one second of tumbling: how far rotation, velocity and
position differ, in standard deviations of the motion; by how much the covariances differ; and how far the two end
apart after a bias that has changed, corrected to first order by both. GTSAM lets a sample's force act in the attitude
before its step, the package in the one halfway. So each motion is shown a second time with every sample cut into 16 of
the same value: where that is the only reason, everything falls to a sixteenth.
"""

import argparse

import numpy as np
from scipy.linalg import eigvalsh

from vislam_edu import imu, simulate
from vislam_edu.se3 import so3_log, so3_right_jacobian

try:
    import gtsam
except ImportError:
    gtsam = None

CHANGE = np.array([0.002, -0.001, 0.003]), np.array([0.05, 0.02, -0.03])  # rad/s, m/s^2


def both(samples, gyro_bias, accelerometer_bias, noise):
    """The same samples joined by the package and by GTSAM."""
    settings = gtsam.PreintegrationParams.MakeSharedU(-imu.GRAVITY[2])
    settings.setGyroscopeCovariance(noise.gyro_density**2 * np.eye(3))
    settings.setAccelerometerCovariance(noise.accelerometer_density**2 * np.eye(3))
    settings.setIntegrationCovariance(1e-16 * np.eye(3))  # m^2/s: none, as in the package
    theirs = gtsam.PreintegratedImuMeasurements(settings, gtsam.imuBias.ConstantBias(accelerometer_bias, gyro_bias))
    for gyro, accelerometer, tau in zip(*samples):
        theirs.integrateMeasurement(accelerometer, gyro, tau)
    return imu.preintegrate(*samples, gyro_bias, accelerometer_bias, noise), theirs


def compare(samples, gyro_bias, accelerometer_bias, noise) -> dict:
    """Differences of one motion, see the top of this file."""
    ours, theirs = both(samples, gyro_bias, accelerometer_bias, noise)
    difference = np.concatenate([so3_log(ours.rotation.T @ theirs.deltaRij().matrix()),
                                 theirs.deltaPij() - ours.position, theirs.deltaVij() - ours.velocity])
    P = ours.covariance[:9, :9]
    by_vector = np.eye(9)  # GTSAM's covariance is that of the rotation vector; the package's, of a right perturbation
    by_vector[:3, :3] = so3_right_jacobian(so3_log(ours.rotation))
    ratios = eigvalsh(by_vector @ theirs.preintMeasCov() @ by_vector.T, P)
    moved = imu.predict(imu.State.at_rest(), imu.correct(ours, gyro_bias + CHANGE[0], accelerometer_bias + CHANGE[1]))
    end = theirs.predict(gtsam.NavState(gtsam.Pose3(), np.zeros(3)),
                         gtsam.imuBias.ConstantBias(accelerometer_bias + CHANGE[1], gyro_bias + CHANGE[0]))
    return {"difference_sigma": float(np.abs(difference / np.sqrt(np.diag(P))).max()),
            "covariance": float(np.abs(ratios - 1).max()),  # of the variance in the direction where it is worst
            "corrected_m": float(np.linalg.norm(end.position() - moved.position))}


def cut(samples, parts):
    """Each sample as `parts` samples of the same value."""
    gyro, accelerometer, taus = (np.repeat(values, parts, axis=0) for values in samples)
    return gyro, accelerometer, taus / parts


def tumbling():
    """A second at 200 Hz, turning at up to 2 rad/s: gyro (200, 3), accelerometer (200, 3), taus (200,)."""
    t = np.arange(200) / 200
    gyro = np.stack([1.5 * np.sin(5 * t), 1.2 * np.cos(3 * t), np.full(200, 0.8)], axis=1)
    accelerometer = np.stack([3 * np.sin(4 * t), 2 * np.cos(6 * t), 9.8 + np.sin(t)], axis=1)
    return gyro, accelerometer, np.full(200, 1 / 200)


def main():
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    if gtsam is None:
        raise SystemExit('this benchmark needs GTSAM, which the package does not: pip install "vislam_edu[gtsam]"')
    drive, _, bias = simulate.inertial_loop(0, frames=200)
    noise = imu.ImuNoise(gyro_walk=0.0, accelerometer_walk=0.0)  # GTSAM keeps the walks in a factor of their own
    motions = {f"street, {seconds:g} s": drive.imu.between(drive.times[100], drive.times[100] + seconds)
               for seconds in (0.1, 0.5, 2.0)}
    for name, samples in {**motions, "tumbling, 1 s": tumbling()}.items():
        for parts in (1, 16):
            found = compare(cut(samples, parts), *np.split(bias[100], 2), noise)
            figures = "  ".join(f"{key} {value:.3g}" for key, value in found.items())
            print(f"{name:14s} samples in {parts:2d}: {figures}")


if __name__ == "__main__":
    main()
