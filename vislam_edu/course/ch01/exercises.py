"""Exercises of notebook 01: SO(3), SE(3), and a pose that moves along a twist."""

import numpy as np

from ... import noise, odometry, se3
from ..checks.exercise import exercise
from ..checks.inputs import random_covariance, random_pose

_SMALL = "Below a small angle, 1e-6 rad say, use the limits: sin t / t is 1, (1 - cos t) / t^2 is 1/2 and " \
         "(t - sin t) / t^3 is 1/6."


def rotation_vectors(rng):
    yield "no rotation", (np.zeros(3),)
    for angle in (1e-13, 1e-4, 0.01, 0.1):
        yield f"{angle:g} rad", (np.array([0.0, angle, 0.0]),)
    yield "quarter turn", (np.array([0.0, 0.0, np.pi / 2]),)
    yield "3.1 rad", (np.array([0.0, 3.1, 0.0]),)
    for _ in range(8):
        yield "random", (rng.normal(size=3),)


def twists(rng):
    yield "no rotation", (np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]),)
    for angle in (1e-13, 1e-4, 0.01, 0.1):
        yield f"{angle:g} rad", (np.array([1.0, 2.0, 3.0, 0.0, 0.0, angle]),)
    yield "quarter turn", (np.array([1.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2]),)
    for _ in range(8):
        yield "random", (rng.normal(size=6),)


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


so3_hat.slip("signs transposed", """This is the transpose, -omega^: it gives cross(b, a). The entry in the first row,
    second column is -z.""", ("[[0, -z, y], [z, 0, -x], [-y, x, 0]]", "[[0, z, -y], [-z, 0, x], [y, -x, 0]]"))
so3_hat.slip("no minus signs", """The matrix must be skew-symmetric: each entry below the diagonal is minus its mirror
    image.""", ("-z", "z"), ("-x", "x"), ("-y", "y"))
so3_hat.slip("y without its sign change", """The y entries carry the opposite sign of the x and z entries on their side
    of the diagonal: first row is [0, -z, +y].""", ("[-y, x", "[y, x"), ("-z, y]", "-z, -y]"))


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


se3_hat.slip("rotation and translation swapped", """A twist is [v, omega], translation first: omega is xi[3:]. Section
    3.1 of the report has them the other way round, section 3.3 this way.""", ("v, omega", "omega, v"))
se3_hat.slip("a pose's last row", "The last row is zero, not [0, 0, 0, 1]: this is a velocity of a pose, not a pose.",
    ("= v", "= v\n    X[3, 3] = 1"))
se3_hat.slip("omega^ transposed", "The rotation block is omega^, not its transpose: check your so3_hat.",
    ("so3_hat(omega)", "so3_hat(omega).T"))


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


so3_exp.slip("no small-angle branch", "At zero rotation the formula divides 0 by 0. " + _SMALL,
    ("if t < 1e-6:\n        return np.eye(3) + S\n    ", ""))
so3_exp.slip("degrees", "phi is in radians; np.deg2rad or np.radians has no place here.",
    ("t = ", "phi = np.radians(phi)\n    t = "))
so3_exp.slip("small angles taken for none", """The special case is for angles at which 1 - cos t loses its digits, 1e-6
    rad say. A step of an IMU turns by 0.001 to 0.1 rad, which is not nothing.""", ("t < 1e-6", "t < 1e-3"),
    ("np.eye(3) + S", "np.eye(3)"))
so3_exp.slip("first order up to too large an angle", """I + S leaves out S S / 2, which is t^2 / 2: at 0.01 rad 5e-5 are
    missing.""", ("1e-6", "0.05"))
so3_exp.slip("axis not normalised", """sin t and 1 - cos t multiply the hat of the unit axis. With the hat of phi itself
    they are divided by t and t^2.""", (" / t * S", " * S"), (" / t**2", ""))
so3_exp.slip("inverse rotation", "This is the transpose, a turn the other way: look at the sign of S.",
    ("S = se3.so3_hat(phi)", "S = -se3.so3_hat(phi)"))
so3_exp.slip("np.exp of a matrix", """np.exp takes the exponential of each entry. The matrix exponential is the series I
    + S + S S / 2 + ..., which Rodrigues' formula sums.""", ("np.eye(3) + S", "np.exp(S)"),
    ("np.eye(3) + np.sin(t) / t * S + (1 - np.cos(t)) / t**2 * (S @ S)", "np.exp(S)"))
so3_exp.slip("series cut off", "I + S + S S / 2 is the series up to its second term: good for small angles only.",
    ("np.sin(t) / t * S + (1 - np.cos(t)) / t**2 * (S @ S)", "S + S @ S / 2"))
so3_exp.slip("series cut off after the third term", "I + S + S^2 / 2 + S^3 / 6 is good for small angles only.",
    ("np.sin(t) / t * S + (1 - np.cos(t)) / t**2 * (S @ S)", "S + S @ S / 2 + S @ S @ S / 6"))


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


se3_exp.slip("no small-angle branch", "At zero rotation the formula divides 0 by 0. " + _SMALL,
    ("if t > 1e-6:", "if True:"))
se3_exp.slip("translation copied", """The translation of the pose is V v, not v: while the body turns, its own forward
    direction turns with it. V is the left Jacobian of SO(3).""", ("V @ v", "v"))
se3_exp.slip("R in place of V", """The translation is turned by V, the mean rotation along the way, not by R, the
    rotation at its end.""", ("V @", "R @"))
se3_exp.slip("V of the inverse rotation", """The signs of the odd terms of V are those of the right Jacobian; the
    translation needs the left one, I + (1 - cos t) / t^2 S + ...""", ("/ t**2 * S", "/ t**2 * -S"),
    ("S / 2", "-S / 2"))
se3_exp.slip("rotation and translation swapped", "A twist is [v, omega], translation first: omega is xi[3:].",
    ("v, omega", "omega, v"))
se3_exp.slip("degrees", "omega is in radians; np.deg2rad or np.radians has no place here.",
    ("xi[3:]", "np.radians(xi[3:])"))
se3_exp.slip("first order only", "I + xi^ is only the beginning of the series; its upper left block is no rotation.",
    ("R = se3.so3_exp(omega)", "R = np.eye(3) + S"), ("V @ v", "v"))
se3_exp.slip("series cut off", """I + X + X X / 2 with X = xi^ is good for small angles only: its upper left block is no
    rotation.""", ("R = se3.so3_exp(omega)", "R = np.eye(3) + S + S @ S / 2"), ("if t > 1e-6:", "if False:"))
se3_exp.slip("identity of V forgotten", """V = I + (1 - cos t) / t^2 S + ...: without turning, the translation is v
    itself.""", ("V = np.eye(3) + (1 -", "V = (1 -"))


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


adjoint.slip("twist order [omega, v]", """The block p^ R stands lower left only where a twist is [omega, v]. Here it is
    [v, omega]: a rotation moves the translation, so p^ R stands upper right.""", ("A[:3, 3:]", "A[3:, :3]"))
adjoint.slip("p^ R forgotten", """A turn about a frame b that is p away also moves the origin of frame a: the upper
    right block is p^ R, not zero.""", ("    A[:3, 3:] = se3.so3_hat(p) @ R\n", ""))
adjoint.slip("R p^ in place of p^ R", """p is expressed in frame a, so it acts after R has turned the twist into a: p^
    R.""", ("se3.so3_hat(p) @ R", "R @ se3.so3_hat(p)"))
adjoint.slip("of the inverse pose", "This is the Adjoint of T^-1: it takes twists from frame a to frame b.",
    ("return A", "return np.linalg.inv(A)"))
adjoint.slip("rotation's own block forgotten", """A turn expressed in frame b has to be turned into frame a as well: R
    stands lower right too.""", ("A[3:, 3:] = R", "A[3:, 3:] = np.eye(3)"))


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


left_jacobian.slip("I at zero rotation", """Zero rotation is not a zero twist: there the Jacobian is [[I, v^/2], [0,
    I]], because turning at the start of a straight path moves its end.""",
    ("return J", "return J if np.linalg.norm(xi[3:]) > 1e-6 else np.eye(6)"))
left_jacobian.slip("no small-angle branch", """At zero rotation the closed form divides 0 by 0. Use the series there:
    [[I, v^/2], [0, I]].""", ("return J", "return J + 0.0 / np.linalg.norm(xi[3:])"))
left_jacobian.slip("block of v forgotten", """The Jacobian of SO(3) on the diagonal is not all: the upper right block
    says how a small turn moves the end of the path.""", ("    X[:3, 3:] = se3.so3_hat(xi[:3])\n", ""))
left_jacobian.slip("right Jacobian", "This is the right Jacobian, left_jacobian(-xi): the odd terms change sign.",
    ("@ X /", "@ -X /"))
left_jacobian.slip("exponential series", "The terms are divided by (n+1)!, not by n!: this is the Adjoint of exp(xi).",
    ("(n + 1)", "n"))
left_jacobian.slip("series cut off", """Two or three terms are not enough for a turn of a radian: add terms until they
    no longer matter.""", ("30", "3"))
left_jacobian.slip("divided by n + 1, not its factorial", """The term X^n is divided by (n + 1)!: each term by n + 1
    more than the one before it.""", ("J = J + term", "J = J + term / (n + 1)"), ("term @ X / (n + 1)", "term @ X"))


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


dead_reckon.slip("world and body mixed", """The twist is measured in the body frame, so its exponential stands to the
    right of world_T_imu. On the left it would be a motion expressed in the world frame.""",
    ("poses[k] @ se3.exp(taus[k] * twists[k])", "se3.exp(taus[k] * twists[k]) @ poses[k]"))
dead_reckon.slip("tau forgotten", "A twist is a velocity: multiply it by the time it lasts before you exponentiate.",
    ("taus[k] * twists[k]", "twists[k]"))
dead_reckon.slip("exponential of the sum", """Twists of different directions do not commute: exp(a) exp(b) is not exp(a
    + b). Multiply the poses, do not add the twists.""",
    ("poses[k] @ se3.exp(taus[k] * twists[k])", "world_T_imu @ se3.exp(taus[:k + 1] @ twists[:k + 1])"))
dead_reckon.slip("straight line in each step", """p + R v tau takes the body for one that moves first and turns
    afterwards. Use the exponential of the whole twist.""",
    ("se3.exp(taus[k] * twists[k])", "se3.pose(se3.so3_exp(taus[k] * twists[k, 3:]), taus[k] * twists[k, :3])"))
dead_reckon.slip("one array changed again and again", """The list holds the same array many times, and each step changes
    it: append a new one, T = T @ ... rather than T[:] = T @ ...""",
    ("poses = [world_T_imu]", "T = world_T_imu.copy()\n    poses = [T]"),
    ("poses.append(poses[k] @ se3.exp(taus[k] * twists[k]))",
     "T[:] = T @ se3.exp(taus[k] * twists[k])\n        poses.append(T)"))


def predictions(rng):
    yield "standing still", (random_covariance(rng, 6), np.zeros(6), 0.1, random_covariance(rng, 6))
    for _ in range(5):
        yield "random", (random_covariance(rng, 6), rng.normal(size=6), rng.uniform(0.2, 0.6),
                         random_covariance(rng, 6))


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


predict_covariance.slip("noise not scaled by tau", """Q is the variance of one sample of the twist. Over the step that
    error lasts tau seconds, so it enters as tau^2 Q.""", ("tau * se3.right", "se3.right"))
predict_covariance.slip("tau instead of tau squared", "An error of tau times the noise has tau^2 times its variance.",
    ("B = tau *", "B = tau**0.5 *"))
predict_covariance.slip("the report's W", """The report adds tau^2 Q: it takes the right Jacobian for the identity. That
    is a few per cent off in a bend; here it is asked for exactly.""", ("se3.right_jacobian(tau * twist)", "np.eye(6)"))
predict_covariance.slip("F of the wrong sign", """The error of the old pose is expressed in the old body frame; to reach
    the new one it goes back along the step: exp(-tau u^). With +tau it would go further away.""", ("-tau", "tau"))
predict_covariance.slip("world and body mixed", """F = I belongs to an error expressed in the world frame (left
    perturbation). The right perturbation is expressed in the body frame, which has moved.""",
    ("se3.adjoint(se3.exp(-tau * twist))", "np.eye(6)"))
predict_covariance.slip("F^T P F", "An error F e has the covariance F P F^T: the transpose stands on the right.",
    ("F @ covariance @ F.T", "F.T @ covariance @ F"))
predict_covariance.slip("no noise added", "Without B Q B^T the filter never becomes less sure.", (" + B @ Q @ B.T", ""))
predict_covariance.slip("Q added as it is", """Q is the covariance of a sample of the twist, not of the pose. An error
    of the twist moves the pose by B = tau J_r: add B Q B^T.""", ("B @ Q @ B.T", "Q"))
predict_covariance.slip("tau Q added", """An error of the twist moves the pose by tau times itself, so the variance has
    tau^2: add B Q B^T.""", ("B @ Q @ B.T", "tau * Q"))
predict_covariance.slip("tau forgotten in F", "A twist is a velocity: the step is tau times the twist, in F as in B.",
    ("exp(-tau * twist)", "exp(-twist)"))
predict_covariance.slip("J_r of the twist", """B is tau J_r(tau u): the Jacobian belongs to the step, which is tau times
    the twist.""", ("right_jacobian(tau * twist)", "right_jacobian(twist)"))
predict_covariance.slip("noise carried along by F", """B expresses the noise in the body frame at the end of the step
    already: F acts on P alone.""", ("F @ covariance @ F.T + B @ Q @ B.T", "F @ (covariance + B @ Q @ B.T) @ F.T"))


def datasheets(rng):
    for rate in (10.0, 50.0, 200.0):
        yield f"{rate:g} Hz", (0.66, 0.02, rate)
    for _ in range(4):
        yield "random", (rng.uniform(0.05, 3.0), rng.uniform(0.01, 0.5), rng.uniform(5.0, 400.0))


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
    sqrt(3600) = 60.""", (" / np.sqrt(3600)", ""))
datasheet_noise.slip("divided by 3600", """An hour has 3600 seconds, but the unit is per *root* hour: divide by
    sqrt(3600) = 60.""", ("np.sqrt(3600)", "3600"))
datasheet_noise.slip("density taken for sigma", """tau^2 density^2 takes the density for the sigma of one sample. That
    sigma is density times sqrt(rate): the faster the samples, the noisier each of them.""",
    ("velocity_density * np.sqrt(rate)", "velocity_density"), ("gyro_density * np.sqrt(rate)", "gyro_density"))
datasheet_noise.slip("no rate left in W", """The sigma of one sample is density times sqrt(rate), so its variance has
    the rate once, and W has the density squared divided by the rate: the longer a step, the larger W.""",
    ("velocity_density * np.sqrt(rate)", "velocity_density * rate"),
    ("gyro_density * np.sqrt(rate)", "gyro_density * rate"))
datasheet_noise.slip("covariance of a sample", """This is the covariance of one IMU sample, Q. W is that of one step of
    the pose: tau^2 Q.""", ("tau = 1 / rate", "tau = 1"))
datasheet_noise.slip("not squared", "W holds variances: square the densities.",
    ("tau**2 * sigma_v**2", "tau * velocity_density"), ("tau**2 * sigma_omega**2", "tau * gyro_density"))
datasheet_noise.slip("rotation and translation swapped", "The order is [position, rotation]: velocity first.",
    ("W[:3, :3]", "W[-3:, -3:]"), ("W[3:, 3:]", "W[:3, :3]"))
datasheet_noise.slip("degrees of radians", """np.degrees goes from radians to degrees. Here it is the other way:
    np.radians.""", ("np.radians", "np.degrees"))
datasheet_noise.slip("sigmas not squared", "W holds variances: tau^2 sigma^2.", ("sigma_v**2", "sigma_v"),
    ("sigma_omega**2", "sigma_omega"))
