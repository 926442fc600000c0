"""Preintegration beside GTSAM's: the same samples, joined by both.

    pip install "vislam_edu[gtsam]"
    python benchmarks/gtsam_imu.py

For motions of 0.1, 0.5 and 2 s of a simulated street: how far rotation, velocity and position differ, in standard
deviations of the motion; by how much the covariances differ; and how far the two end apart after a bias that has
changed, corrected to first order by both. GTSAM lets a sample's force act in the attitude before its step, the package
in the one halfway, so the two are not equal to the last digit.
"""

import argparse

import numpy as np

from vislam_edu import imu, simulate
from vislam_edu.se3 import so3_log

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
    moved = imu.predict(imu.State.at_rest(), imu.correct(ours, gyro_bias + CHANGE[0], accelerometer_bias + CHANGE[1]))
    end = theirs.predict(gtsam.NavState(gtsam.Pose3(), np.zeros(3)),
                         gtsam.imuBias.ConstantBias(accelerometer_bias + CHANGE[1], gyro_bias + CHANGE[0]))
    return {"difference_sigma": float(np.abs(difference / np.sqrt(np.diag(P))).max()),
            "covariance": float(np.linalg.norm(theirs.preintMeasCov() - P) / np.linalg.norm(P)),
            "corrected_m": float(np.linalg.norm(end.position() - moved.position))}


def main():
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    if gtsam is None:
        raise SystemExit('this benchmark needs GTSAM, which the package does not: pip install "vislam_edu[gtsam]"')
    drive, _, bias = simulate.inertial_loop(0, frames=200)
    noise = imu.ImuNoise(gyro_walk=0.0, accelerometer_walk=0.0)  # GTSAM keeps the walks in a factor of their own
    for seconds in (0.1, 0.5, 2.0):
        samples = drive.imu.between(drive.times[100], drive.times[100] + seconds)
        found = compare(samples, *np.split(bias[100], 2), noise)
        print(f"{seconds:g} s: " + "  ".join(f"{key} {value:.3g}" for key, value in found.items()))


if __name__ == "__main__":
    main()
