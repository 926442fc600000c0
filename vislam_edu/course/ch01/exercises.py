"""Exercises of notebook 01: SO(3), SE(3), and a pose that moves along a twist."""

import numpy as np

from ... import noise, odometry, se3
from ..checks.exercise import exercise
from ..checks.inputs import random_covariance, random_pose

_SMALL = "Below a small angle, 1e-6 rad say, use the limits: sin t / t is 1, (1 - cos t) / t^2 is 1/2 and " \
         "(t - sin t) / t^3 is 1/6."


def rotation_vectors(rng):
    yield "no rotation", (np.zeros(3),)
    for angle in (1e-9, 1e-4, 0.01, 0.1):
        yield f"{angle:g} rad", (np.array([0.0, angle, 0.0]),)
    yield "quarter turn", (np.array([0.0, 0.0, np.pi / 2]),)
    yield "3.1 rad", (np.array([0.0, 3.1, 0.0]),)
    for _ in range(8):
        yield "random", (rng.normal(size=3),)


def twists(rng):
    yield "no rotation", (np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]),)
    for angle in (1e-9, 1e-4, 0.01, 0.1):
        yield f"{angle:g} rad", (np.array([1.0, 2.0, 3.0, 0.0, 0.0, angle]),)
    yield "quarter turn", (np.array([1.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2]),)
    for _ in range(8):
        yield "random", (rng.normal(size=6),)


# --- hat --------------------------------------------------------------------------------------------------

def vectors(rng):
    yield "x axis", (np.array([1.0, 0.0, 0.0]),)
    yield "[1, 2, 3]", (np.array([1.0, 2.0, 3.0]),)
    for _ in range(5):
        yield "random", (rng.normal(size=3),)


@exercise(chapter=1, cases=vectors, shows=[se3.so3_hat], hints=[
    "Write down the three components of cross(omega, b) and read off which entry of omega multiplies which of b.",
    "[[0, -z, y], [z, 0, -x], [-y, x, 0]]"])
def so3_hat(omega):
    """Skew-symmetric matrix: `so3_hat(a) @ b` is the cross product of a and b.

    omega : (3,). Returns (3, 3).
    """
    x, y, z = omega
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


so3_hat.slip("signs transposed", """This is the transpose, -omega^: it gives cross(b, a). The entry in the first
row, second column is -z.""", (" omega", " -omega"))


@so3_hat.mistake("no minus signs", "The matrix must be skew-symmetric: each entry below the diagonal is minus its "
                 "mirror image.")
def _(omega):
    x, y, z = omega
    return np.array([[0, z, y], [z, 0, x], [y, x, 0]])


@so3_hat.mistake("y without its sign change", """The y entries carry the opposite sign of the x and z entries on their
side of the diagonal: first row is [0, -z, +y].""")
def _(omega):
    return se3.so3_hat(omega * [1, -1, 1])


@exercise(chapter=1, cases=twists, shows=[se3.hat, se3.so3_hat], hints=[
    "The rotation goes into the upper left block, the translation into the last column.",
    "[[omega^, v], [0, 0]] with v = xi[:3] and omega = xi[3:]; the last row is zero, this is no pose."])
def se3_hat(xi):
    """Twist as a matrix of the Lie algebra se(3).

    xi : (6,), [v, omega], translation first. Returns (4, 4). You may use your `so3_hat`.
    """
    v, omega = xi[:3], xi[3:]
    X = np.zeros((4, 4))
    X[:3, :3] = se3.so3_hat(omega)
    X[:3, 3] = v
    return X


@se3_hat.mistake("rotation and translation swapped", """A twist is [v, omega], translation first: omega is xi[3:].
Section 3.1 of the report has them the other way round, section 3.3 this way.""")
def _(xi):
    return se3.hat(np.roll(xi, 3))


@se3_hat.mistake("a pose's last row", """The last row is zero, not [0, 0, 0, 1]: this is a velocity of a pose, not a
pose.""")
def _(xi):
    return se3.hat(xi) + np.diag([0, 0, 0, 1])


se3_hat.slip("omega^ transposed", "The rotation block is omega^, not its transpose: check your so3_hat.",
             ("xi[3:]", "-xi[3:]"))


# --- exp --------------------------------------------------------------------------------------------------

@exercise(chapter=1, cases=rotation_vectors, shows=[se3.so3_exp, se3._angle_functions], hints=[
    "Rodrigues' formula, with S = so3_hat(phi) and t the length of phi: I + a S + b S S.",
    "a = sin t / t and b = (1 - cos t) / t^2. " + _SMALL])
def so3_exp(phi):
    """Rotation matrix of a rotation vector (Rodrigues' formula).

    phi : (3,), rad: axis times angle; zero must give the identity. Returns (3, 3).
    """
    t = np.linalg.norm(phi)
    S = se3.so3_hat(phi)
    if t < 1e-6:
        return np.eye(3) + S
    return np.eye(3) + np.sin(t) / t * S + (1 - np.cos(t)) / t**2 * (S @ S)


so3_exp.slip("no small-angle branch", "At zero rotation the formula divides 0 by 0. " + _SMALL, ("1e-6", "0"))


@so3_exp.mistake("degrees", "phi is in radians; np.deg2rad or np.radians has no place here.")
def _(phi):
    return se3.so3_exp(np.radians(phi))


@so3_exp.mistake("axis not normalised", """sin t and 1 - cos t multiply the hat of the unit axis. With the hat of phi
itself they are divided by t and t^2.""")
def _(phi):
    t, S = np.linalg.norm(phi), se3.so3_hat(phi)
    return np.eye(3) + np.sin(t) * S + (1 - np.cos(t)) * S @ S


so3_exp.slip("inverse rotation", "This is the transpose, a turn the other way: look at the sign of S.", ("S +", "-S +"))


@so3_exp.mistake("np.exp of a matrix", """np.exp takes the exponential of each entry. The matrix exponential is the
series I + S + S S / 2 + ..., which Rodrigues' formula sums.""")
def _(phi):
    return np.exp(se3.so3_hat(phi))


@so3_exp.mistake("series cut off", "I + S + S S / 2 is the series up to its second term: good for small angles only.")
def _(phi):
    S = se3.so3_hat(phi)
    return np.eye(3) + S + S @ S / 2


@exercise(chapter=1, cases=twists, shows=[se3.exp, se3.hat, se3._angle_functions], hints=[
    "The rotation is so3_exp(omega). The translation is not v: the body turns while it moves.",
    "The translation is V v with V = I + (1 - cos t) / t^2 S + (t - sin t) / t^3 S S, S = so3_hat(omega). " + _SMALL])
def se3_exp(xi):
    """Pose reached by following a constant twist for one unit of time.

    xi : (6,), [v, omega], m and rad; no rotation must give a pure translation. Returns (4, 4).
    """
    v, omega = xi[:3], xi[3:]
    t = np.linalg.norm(omega)
    S = se3.so3_hat(omega)
    R = se3.so3_exp(omega)
    V = np.eye(3) + S / 2
    if t > 1e-6:
        V = np.eye(3) + (1 - np.cos(t)) / t**2 * S + (t - np.sin(t)) / t**3 * (S @ S)
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = V @ v
    return T


@se3_exp.mistake("no small-angle branch", "At zero rotation the formula divides 0 by 0. " + _SMALL)
def _(xi):
    t, S = np.linalg.norm(xi[3:]), se3.so3_hat(xi[3:])
    V = np.eye(3) + (1 - np.cos(t)) / t**2 * S + (t - np.sin(t)) / t**3 * S @ S
    return se3.pose(np.eye(3) + np.sin(t) / t * S + (1 - np.cos(t)) / t**2 * S @ S, V @ xi[:3])


se3_exp.slip("translation copied", """The translation of the pose is V v, not v: while the body turns, its own
forward direction turns with it. V is the left Jacobian of SO(3).""", ("V @ v", "v"))


se3_exp.slip("R in place of V", """The translation is turned by V, the mean rotation along the way, not by R, the
rotation at its end.""", ("V @", "R @"))


se3_exp.slip("V of the inverse rotation", """The signs of the odd terms of V are those of the right Jacobian; the
translation needs the left one, I + (1 - cos t) / t^2 S + ...""", ("S +", "-S +"))


@se3_exp.mistake("rotation and translation swapped", "A twist is [v, omega], translation first: omega is xi[3:].")
def _(xi):
    return se3.exp(np.roll(xi, 3))


@se3_exp.mistake("degrees", "omega is in radians; np.deg2rad or np.radians has no place here.")
def _(xi):
    return se3.exp(np.concatenate([xi[:3], np.radians(xi[3:])]))


@se3_exp.mistake("first order only", """I + xi^ is only the beginning of the series; its upper left block is no
rotation.""")
def _(xi):
    return np.eye(4) + se3.hat(xi)


# --- Adjoint and Jacobian ---------------------------------------------------------------------------------

def poses(rng):
    yield "the identity", (np.eye(4),)
    yield "translation only", (se3.pose(np.eye(3), [1.0, 2.0, 3.0]),)
    for _ in range(6):
        yield "random", (random_pose(rng),)


@exercise(chapter=1, cases=poses, shows=[se3.adjoint], hints=[
    "Multiply out T xi^ T^-1: it is the hat of another twist. Which matrix takes xi to it?",
    "[[R, p^ R], [0, R]] for twists ordered [v, omega]."])
def adjoint(T):
    """Adjoint of a pose: `T exp(xi^) = exp((adjoint(T) xi)^) T` for every twist xi.

    T : (4, 4), a_T_b. Returns (6, 6), which takes twists [v, omega] of frame b to frame a.
    """
    R, p = T[:3, :3], T[:3, 3]
    A = np.zeros((6, 6))
    A[:3, :3] = R
    A[:3, 3:] = se3.so3_hat(p) @ R
    A[3:, 3:] = R
    return A


@adjoint.mistake("twist order [omega, v]", """The block p^ R stands lower left only where a twist is [omega, v]. Here it
is [v, omega]: a rotation moves the translation, so p^ R stands upper right.""")
def _(T):
    A = se3.adjoint(T)
    A[3:, :3], A[:3, 3:] = A[:3, 3:].copy(), 0.0
    return A


adjoint.slip("p^ R forgotten", """A turn about a frame b that is p away also moves the origin of frame a: the upper
right block is p^ R, not zero.""", ("@ R", "@ p"))


adjoint.slip("R p^ in place of p^ R",
                 "p is expressed in frame a, so it acts after R has turned the twist into a: p^ R.",
             ("se3.so3_hat(p) @ R", "R @ se3.so3_hat(p)"))


adjoint.slip("of the inverse pose", "This is the Adjoint of T^-1: it takes twists from frame a to frame b.",
             ("return A", "return np.linalg.inv(A)"))


def jacobian_twists(rng):
    yield "no rotation", (np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]),)
    yield "0.001 rad", (np.array([1.0, 2.0, 3.0, 0.0, 0.001, 0.0]),)
    for _ in range(6):
        yield "random", (rng.normal(size=6),)


@exercise(chapter=1, cases=jacobian_twists, shows=[se3.left_jacobian, se3.curly_hat], tolerance=1e-6, hints=[
    "It is a power series in the curly hat X of xi, X = [[omega^, v^], [0, omega^]].",
    "I + X / 2! + X X / 3! + X X X / 4! + ...: add terms until they no longer matter (20 are plenty here)."])
def left_jacobian(xi):
    """Left Jacobian of SE(3): `exp(xi + d) = exp(left_jacobian(xi) @ d) @ exp(xi)` for small d.

    xi : (6,), [v, omega]. Returns (6, 6).
    """
    X = np.zeros((6, 6))
    X[:3, :3] = se3.so3_hat(xi[3:])
    X[:3, 3:] = se3.so3_hat(xi[:3])
    X[3:, 3:] = se3.so3_hat(xi[3:])
    J = np.eye(6)
    term = np.eye(6)
    for n in range(1, 30):
        term = term @ X / (n + 1)
        J = J + term
    return J


@left_jacobian.mistake("I at zero rotation", """Zero rotation is not a zero twist: there the Jacobian is [[I, v^/2], [0,
I]], because turning at the start of a straight path moves its end.""")
def _(xi):
    return se3.left_jacobian(xi) if np.linalg.norm(xi[3:]) > 1e-6 else np.eye(6)


@left_jacobian.mistake("no small-angle branch", """At zero rotation the closed form divides 0 by 0. Use the series
there: [[I, v^/2], [0, I]].""")
def _(xi):
    with np.errstate(all="ignore"):
        return se3.left_jacobian(xi) + 0.0 / np.linalg.norm(xi[3:])


left_jacobian.slip("block of v forgotten", """The Jacobian of SO(3) on the diagonal is not all: the upper right
block says how a small turn moves the end of the path.""", ("xi[:3]", "0 * xi[:3]"))


left_jacobian.slip("right Jacobian", "This is the right Jacobian, left_jacobian(-xi): the odd terms change sign.",
                   ("X /", "-X /"))


left_jacobian.slip("exponential series", """The terms are divided by (n+1)!, not by n!: this is the Adjoint of
exp(xi).""", ("1)", "0)"))


@left_jacobian.mistake("series cut off", """Two or three terms are not enough for a turn of a radian: add terms until
they no longer matter.""")
def _(xi):
    X = se3.curly_hat(xi)
    return np.eye(6) + X / 2 + X @ X / 6


# --- motion -----------------------------------------------------------------------------------------------

def drives(rng):
    yield "straight on", (np.eye(4), np.tile([10.0, 0, 0, 0, 0, 0], (3, 1)), np.full(3, 0.1))
    for _ in range(5):
        yield "random", (random_pose(rng), rng.normal(size=(4, 6)), rng.uniform(0.1, 0.5, size=4))


@exercise(chapter=1, cases=drives, shows=[odometry.dead_reckon, odometry.predict, se3.exp], hints=[
    "A twist is measured in the body frame. On which side of the pose does its exponential stand?",
    "world_T_imu[k+1] = world_T_imu[k] @ se3.exp(taus[k] * twists[k])"])
def dead_reckon(world_T_imu, twists, taus):
    """Poses from IMU samples alone.

    world_T_imu : (4, 4), the pose at the start. twists : (n, 6), [v, omega] in the body frame, m/s and rad/s.
    taus : (n,), s, how long each twist lasts. Returns (n + 1, 4, 4), the start included. You may use `se3.exp`.
    """
    poses = [world_T_imu]
    for k in range(len(taus)):
        poses.append(poses[k] @ se3.exp(taus[k] * twists[k]))
    return np.array(poses)


dead_reckon.slip("world and body mixed", """The twist is measured in the body frame, so its exponential stands to
the right of world_T_imu. On the left it would be a motion expressed in the world frame.""",
                 ("poses[k] @ se3.exp(taus[k] * twists[k])", "se3.exp(taus[k] * twists[k]) @ poses[k]"))


dead_reckon.slip("tau forgotten", """A twist is a velocity: multiply it by the time it lasts before you
exponentiate.""", ("taus[k] * twists[k]", "twists[k]"))


@dead_reckon.mistake("exponential of the sum", """Twists of different directions do not commute: exp(a) exp(b) is not
exp(a + b). Multiply the poses, do not add the twists.""")
def _(world_T_imu, twists, taus):
    sums = np.cumsum(taus[:, None] * twists, axis=0)
    return np.concatenate([world_T_imu[None], world_T_imu @ se3.exp(sums)])


@dead_reckon.mistake("straight line in each step", """p + R v tau takes the body for one that moves first and turns
afterwards. Use the exponential of the whole twist.""")
def _(world_T_imu, twists, taus):
    poses = [world_T_imu]
    for twist, tau in zip(twists, taus):
        poses.append(poses[-1] @ se3.pose(se3.so3_exp(tau * twist[3:]), tau * twist[:3]))
    return np.array(poses)


@dead_reckon.mistake("one array changed again and again", """The list holds the same array many times, and each step
changes it: append a new one, T = T @ ... rather than T[:] = T @ ...""")
def _(world_T_imu, twists, taus):
    return np.repeat(dead_reckon.reference(world_T_imu, twists, taus)[-1:], len(taus) + 1, axis=0)


def predictions(rng):
    yield "standing still", (random_covariance(rng, 6), np.zeros(6), 0.1, random_covariance(rng, 6))
    for _ in range(5):
        yield "random", (random_covariance(rng, 6), rng.normal(size=6), rng.uniform(0.2, 0.6),
                         random_covariance(rng, 6))


def _predicted(covariance, twist, tau, Q, F=None, B=None):
    F = se3.adjoint(se3.exp(-tau * twist)) if F is None else F
    B = tau * se3.right_jacobian(tau * twist) if B is None else B
    return F @ covariance @ F.T + B @ Q @ B.T


@exercise(chapter=1, cases=predictions, shows=[odometry.predict], hints=[
    "F carries the old error into the frame of the new pose; B turns an error of the twist into one of the pose.",
    "F = se3.adjoint(se3.exp(-tau * twist)), B = tau * se3.right_jacobian(tau * twist), F P F^T + B Q B^T"])
def predict_covariance(covariance, twist, tau, Q):
    """Covariance of the pose after one step, right perturbation T = T_mean exp(epsilon^).

    covariance : (6, 6), order [position m, rotation rad]. twist : (6,), [v, omega], m/s and rad/s. tau : s.
    Q : (6, 6), covariance of one IMU sample. Returns (6, 6): F P F^T + B Q B^T with F = Ad(exp(-tau u^)) and
    B = tau J_r(tau u), J_r the right Jacobian. You may use `se3`.
    """
    F = se3.adjoint(se3.exp(-tau * twist))
    B = tau * se3.right_jacobian(tau * twist)
    return F @ covariance @ F.T + B @ Q @ B.T


predict_covariance.slip("noise not scaled by tau", """Q is the variance of one sample of the twist. Over the step
that error lasts tau seconds, so it enters as tau^2 Q.""",
                        ("tau * se3.right_jacobian(tau * twist)", "se3.right_jacobian(tau * twist)"))


@predict_covariance.mistake("tau instead of tau squared", """An error of tau times the noise has tau^2 times its
variance.""")
def _(covariance, twist, tau, Q):
    return _predicted(covariance, twist, tau, Q, B=tau**0.5 * se3.right_jacobian(tau * twist))


predict_covariance.slip("the report's W", """The report adds tau^2 Q: it takes the right Jacobian for the identity.
That is a few per cent off in a bend; here it is asked for exactly.""", ("(tau", "(0 * tau"))


predict_covariance.slip("F of the wrong sign", """The error of the old pose is expressed in the old body frame; to
reach the new one it goes back along the step: exp(-tau u^). With +tau it would go further away.""", ("-tau", "tau"))


predict_covariance.slip("world and body mixed", """F = I belongs to an error expressed in the world frame (left
perturbation). The right perturbation is expressed in the body frame, which has moved.""", ("twist))", "0 * twist))"))


predict_covariance.slip("F^T P F", "An error F e has the covariance F P F^T: the transpose stands on the right.",
                        ("se3.adjoint(se3.exp(-tau * twist))", "se3.adjoint(se3.exp(-tau * twist)).T"))


predict_covariance.slip("no noise added", "Without B Q B^T the filter never becomes less sure.", ("B @", "0 * B @"))


def datasheets(rng):
    for rate in (10.0, 50.0, 200.0):
        yield f"{rate:g} Hz", (0.66, 0.02, rate)
    for _ in range(4):
        yield "random", (rng.uniform(0.05, 3.0), rng.uniform(0.01, 0.5), rng.uniform(5.0, 400.0))


def _W(velocity_density, gyro_density, tau):
    return tau * np.diag([velocity_density**2] * 3 + [gyro_density**2] * 3)


@exercise(chapter=1, cases=datasheets, shows=[noise.Noise.from_density, noise.Noise.process_covariance], hints=[
    """First the units: a random walk in degrees per root hour becomes radians per root second, and one hour has 3600
    seconds. Then sigma of one sample is density times sqrt(rate).""",
    "With n = np.radians(angle_random_walk) / 60 and tau = 1 / rate: W = tau * diag(density^2 x3, n^2 x3)."])
def datasheet_noise(angle_random_walk, velocity_density, rate):
    """Process noise W of one IMU step, from a datasheet.

    angle_random_walk : degrees per root hour, of the gyro. velocity_density : m/s per root hertz. rate : Hz,
    samples per second; a step lasts 1 / rate. Returns (6, 6), order [position m, rotation rad], with J_r = I.
    """
    tau = 1 / rate
    gyro_density = np.radians(angle_random_walk) / np.sqrt(3600)
    sigma_v = velocity_density * np.sqrt(rate)
    sigma_omega = gyro_density * np.sqrt(rate)
    W = np.zeros((6, 6))
    W[:3, :3] = tau**2 * sigma_v**2 * np.eye(3)
    W[3:, 3:] = tau**2 * sigma_omega**2 * np.eye(3)
    return W


datasheet_noise.slip("degrees", "The datasheet gives degrees, W wants radians: np.radians.",
                     ("np.radians(angle_random_walk)", "angle_random_walk"))


datasheet_noise.slip("per root hour taken for per root second", """The unit is degrees per root *hour*: divide by
sqrt(3600) = 60.""", ("3600", "1"))


datasheet_noise.slip("divided by 3600", """An hour has 3600 seconds, but the unit is per *root* hour: divide by
sqrt(3600) = 60.""", ("np.sqrt(3600)", "3600"))


@datasheet_noise.mistake("density taken for sigma", """tau^2 density^2 takes the density for the sigma of one sample.
That sigma is density times sqrt(rate): the faster the samples, the noisier each of them.""")
def _(angle_random_walk, velocity_density, rate):
    return _W(velocity_density, np.radians(angle_random_walk) / 60, 1 / rate**2)


datasheet_noise.slip("rate squared", """sigma of one sample is density times sqrt(rate), so its variance has the
rate once, not squared.""", ("1 / rate", "np.sqrt(1 / rate)"))


datasheet_noise.slip("covariance of a sample", """This is the covariance of one IMU sample, Q. W is that of one step
of the pose: tau^2 Q.""", ("1 / rate", "1"))


@datasheet_noise.mistake("not squared", "W holds variances: square the densities.")
def _(angle_random_walk, velocity_density, rate):
    return np.diag([velocity_density] * 3 + [np.radians(angle_random_walk) / 60] * 3) / rate


@datasheet_noise.mistake("rotation and translation swapped", "The order is [position, rotation]: velocity first.")
def _(angle_random_walk, velocity_density, rate):
    return np.roll(datasheet_noise.reference(angle_random_walk, velocity_density, rate), 3, axis=(0, 1))
