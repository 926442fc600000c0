"""Exercises of notebook 16: a real IMU, and what an MSCKF does with its landmarks."""

import numpy as np

from ... import imu, se3
from ...error_state import RightPerturbation
from ..checks.exercise import exercise
from ..checks.inputs import random_pose
from . import msckf


def _sample(rng):
    for tau in (0.005, 0.01, 0.1):
        yield "random", (random_pose(rng)[:3, :3], rng.normal(0, 5, 3) + [0, 0, 9.81], tau)


@exercise(chapter=16, cases=_sample, shows=[imu.jacobians], hints=[
    "v' = v + (R f + g) tau. What is R f after R -> R exp(theta^)? And f after b_a -> b_a + delta?",
    "R exp(theta^) f is R f - R f^ theta to first order; f = accelerometer - b_a."])
def velocity_rows(rotation, force, tau):
    """The three rows of F that belong to the velocity, in one step v' = v + (R f + g) tau.

    rotation : (3, 3), R. force : (3,), f, the accelerometer minus its bias, m/s^2. tau : s. The error is ordered
    [R, p, v, b_g, b_a], R_true = R exp(theta^), the others true minus estimate. Returns (3, 15).
    You may use `se3`.
    """
    F = np.zeros((3, 15))
    F[:, imu.ROTATION] = -tau * rotation @ se3.so3_hat(force)
    F[:, imu.VELOCITY] = np.eye(3)
    F[:, imu.ACCELEROMETER_BIAS] = -tau * rotation
    return F


velocity_rows.slip("bias added", """The bias is subtracted from the sample, so a larger bias means a smaller force:
    minus tau R.""", ("imu.ACCELEROMETER_BIAS] = -tau", "imu.ACCELEROMETER_BIAS] = tau"))
velocity_rows.slip("rotation error in the world", """-(R f)^ belongs to R_true = exp(theta^) R. Here the error turns the
    body: R exp(theta^) f, so -R f^.""",
    ("-tau * rotation @ se3.so3_hat(force)", "-tau * se3.so3_hat(rotation @ force)"))
velocity_rows.slip("the old velocity forgotten", "v' contains v: its block is the identity.", ("np.eye", "np.zeros"))
velocity_rows.slip("bias not turned", "The bias is expressed in the IMU frame, the velocity in the world: -tau R.",
    ("] = -tau * rotation\n", "] = -tau * np.eye(3)\n"))
velocity_rows.slip("force not turned", "The force is expressed in the IMU frame, the velocity in the world: -tau R f^.",
    ("-tau * rotation @ se3", "-tau * se3"))
velocity_rows.slip("columns of the position", "v' does not contain p. The order is [R, p, v, b_g, b_a].",
    ("imu.VELOCITY", "imu.POSITION"))
velocity_rows.slip("columns of the gyro's bias", "The accelerometer's bias comes last: [R, p, v, b_g, b_a].",
    ("imu.ACCELEROMETER_BIAS", "imu.GYRO_BIAS"))


def _gyro(rng):
    for n in (1, 2, 8):
        yield "random", (rng.normal(0, 1, (n, 3)), rng.uniform(0.01, 0.05, n))


@exercise(chapter=16, cases=_gyro, shows=[imu.preintegrate], hints=[
    "One sample first: exp(tau (omega - delta)^) = exp(tau omega^) exp(-(J_r tau delta)^). Then a second one after it.",
    "J <- exp(tau omega^)^T J - tau J_r(tau omega), from J = 0."])
def rotation_bias_jacobian(omega, taus):
    """The derivative of a preintegrated rotation by the gyro's bias: a bias larger by delta adds exp((J delta)^).

    omega : (n, 3), rad/s, gyro minus the bias it was integrated with. taus : (n,), s. Returns J (3, 3) with
    prod exp(tau (omega - delta)^) = prod exp(tau omega^) exp((J delta)^) to first order. You may use `se3`.
    """
    J = np.zeros((3, 3))
    for w, tau in zip(omega, taus):
        J = se3.so3_exp(tau * w).T @ J - tau * se3.so3_right_jacobian(tau * w)
    return J


rotation_bias_jacobian.slip("no turn", """What an early sample adds is turned by all that come later: the old J is
    multiplied by exp(tau omega^)^T before the new term joins.""", ("se3.so3_exp(tau * w).T @ J", "J"))
rotation_bias_jacobian.slip("sign", "The bias is subtracted from the gyro: a larger one turns less.",
    ("J - tau", "J + tau"))
rotation_bias_jacobian.slip("turned the wrong way", """J delta is a right perturbation of the product. It moves past the
    next factor E from left to right: exp(a^) E = E exp((E^T a)^), so E^T.""",
    ("se3.so3_exp(tau * w).T", "se3.so3_exp(tau * w)"))
rotation_bias_jacobian.slip("new term turned as well", """J_r of a sample is a right perturbation *after* its factor
    already: only the old J moves past it.""",
    ("J - tau * se3.so3_right_jacobian(tau * w)", "(J - tau * se3.so3_right_jacobian(tau * w))"))


def _tracks(rng):
    for n, d in ((2, 6), (3, 12), (6, 18)):
        yield "random", (rng.normal(size=(3 * n, d)), rng.normal(size=(3 * n, 3)), rng.normal(size=3 * n))


@exercise(chapter=16, cases=_tracks, shows=[msckf.null_space, msckf.update], outputs=["A", "b"], tolerance=1e-7, hints=[
    "H_f = Q R with a full Q (m, m): its first three columns span what H_f reaches, the others are N.",
    "numpy.linalg.qr(H_f, mode='complete')[0][:, 3:]; then H_o = N^T H_x, r_o = N^T r."])
def project_track(H_x, H_f, residual):
    """What one track says about the clones once its landmark is projected out.

    H_x : (m, d). H_f : (m, 3), of rank 3. residual : (m,). With N (m, m-3) an orthonormal basis of the null space of
    H_f^T, H_o = N^T H_x and r_o = N^T r.
    Returns A = H_o^T H_o (d, d) and b = H_o^T r_o (d,), which are the same for every such N.
    """
    N = np.linalg.qr(H_f, mode="complete")[0][:, 3:]
    H = N.T @ H_x
    return H.T @ H, H.T @ (N.T @ residual)


project_track.slip("landmark taken as known", """Without the projection the landmark's error counts as zero: the clones
    learn from a landmark that nobody knows.""", ('np.linalg.qr(H_f, mode="complete")[0][:, 3:]', "np.eye(len(H_f))"))
project_track.slip("the columns that H_f reaches", """The first three columns of Q span H_f itself. The null space is
    spanned by the others.""", ("[:, 3:]", "[:, :3]"))
project_track.slip("residual not projected", "Residual and H_x share their rows: both are multiplied by N^T.",
    ("H.T @ (N.T @ residual)", "H_x.T @ residual"))


def _two_estimates(rng):
    for _ in range(3):
        first, landmark = random_pose(rng), 5 * rng.normal(size=3)
        yield "random", (rng.normal(size=(3, 3)), first, landmark, first @ se3.exp(0.3 * rng.normal(size=6)),
                         landmark + rng.normal(size=3))


@exercise(chapter=16, cases=_two_estimates, shows=[RightPerturbation.jacobians], hints=[
    "The formula is that of chapter 05, J R^T and -J [I, -s^]. Which R and which s?",
    "Both from the first estimates: R of first_pose, s = first_pose^-1 first_landmark."])
def first_estimates_jacobian(J, first_pose, first_landmark, pose, landmark):
    """H of one landmark's pixels with first-estimates Jacobians.

    J : (3, 3), derivative of the pixels by the point in the IMU frame (already at the first estimates). first_pose,
    pose : (4, 4), world_T_imu when this pose was first estimated, and now. first_landmark, landmark : (3,), m, world,
    when it was born, and now. The error is a right perturbation, m_true = m + delta. You may use `se3`.
    Returns (3, 9), columns [landmark, position, rotation].
    """
    s = se3.transform(se3.inverse(first_pose), first_landmark)
    return np.hstack([J @ first_pose[:3, :3].T, -J, J @ se3.so3_hat(s)])


first_estimates_jacobian.slip("the best estimates", """That is the standard EKF. The Jacobians of one variable are then
    taken at several points, and what no camera sees seems to be seen.""",
    ("se3.inverse(first_pose), first_landmark", "se3.inverse(pose), landmark"), ("first_pose[:3", "pose[:3"))
first_estimates_jacobian.slip("landmark as now estimated", """The landmark too is linearised where it was born: each
    variable in H has one point for good.""", ("first_landmark)", "landmark)"))
first_estimates_jacobian.slip("pose as now estimated", """The pose too: its point is the prediction, whatever an update
    has made of it since.""", ("inverse(first_pose)", "inverse(pose)"), ("first_pose[:3", "pose[:3"))
first_estimates_jacobian.slip("position in the world", """A right perturbation moves the IMU along its own axes: the
    position's block is -J.""", ("-J,", "-J @ first_pose[:3, :3].T,"))
first_estimates_jacobian.slip("s not turned into the body", """s = R^T (m - p): the landmark as the IMU has it, along
    its own axes.""", ("se3.transform(se3.inverse(first_pose), first_landmark)", "first_landmark - first_pose[:3, 3]"))


def _sheets(rng):
    for rate in (100.0, 200.0, 1000.0):
        yield "random", (rng.uniform(0.1, 1.0), rng.uniform(0.02, 0.2), rate)


@exercise(chapter=16, cases=_sheets, shows=[imu.ImuNoise.from_datasheet, imu.ImuNoise.covariance],
          outputs=["gyro", "accelerometer"], hints=[
    "A walk of 1 degree per root hour is 1 degree after an hour, 1/60 degree after a second.",
    "density = value / 60 (and degrees to radians); a sample is the mean over 1/rate s: density * sqrt(rate)."])
def datasheet(angle_random_walk, velocity_random_walk, rate):
    """Standard deviation of one sample, from a datasheet.

    angle_random_walk : degrees per root hour. velocity_random_walk : m/s per root hour. rate : Hz. Returns rad/s of a
    gyro sample and m/s^2 of an accelerometer sample.
    """
    return np.deg2rad(angle_random_walk) / 60 * rate**0.5, velocity_random_walk / 60 * rate**0.5


datasheet.slip("hour without a root", "Per root hour: an hour is 3600 s, its root is 60.", (") / 60", ") / 3600"),
    ("walk / 60", "walk / 3600"))
datasheet.slip("degrees", "The gyro is to be in rad/s.", ("np.deg2rad(angle_random_walk)", "angle_random_walk"))
datasheet.slip("density for a sample", """The density does not know the rate. A sample is a mean over 1/rate seconds;
    the shorter that is, the noisier: times sqrt(rate).""", (") / 60 * rate**0.5", ") / 60"),
    ("walk / 60 * rate**0.5", "walk / 60"))
datasheet.slip("divided by the root of the rate", """Faster samples average over less time and are noisier each: times
    sqrt(rate). What is divided is the uncertainty of an angle after one sample.""", (") / 60 * rate", ") / 60 / rate"),
    ("walk / 60 * rate", "walk / 60 / rate"))
