"""Exercises of notebook 11: one residual, the Schur complement, one step, one weight."""

import numpy as np

from ... import batch, se3
from ..checks.exercise import exercise
from ..checks.inputs import random_pose


def two_poses(rng):
    yield "no turn", (np.eye(4), se3.exp(np.array([1.0, 0.2, 0, 0, 0, 0])), 0.1)
    for tau in (0.1, 0.12, 0.5):
        T = random_pose(rng)
        yield "random", (T, T @ se3.exp(tau * np.array([10.0, 1, 0.5, 0.5, 1.0, 2.0]) * rng.normal(size=6)), tau)


@exercise(chapter=11, cases=two_poses, shows=[batch.path_twists], outputs=["by_this", "by_next"], hints=[
    "Perturb T_{k+1}: the logarithm sees exp(tau xi) exp(epsilon), so the right Jacobian. T_k: exp(-epsilon) "
    "exp(tau xi).",
    "by_next = J_r^-1(tau xi) / tau, by_this = -J_l^-1(tau xi) / tau, with tau xi = se3.log(T_k^-1 T_{k+1})."])
def twist_jacobians(T_this, T_next, tau):
    """Derivatives of the residual of the IMU, xi - u with xi = log(T_this^-1 T_next) / tau.

    T_this, T_next : (4, 4), world_T_imu of two frames. tau : s between them. Returns the derivatives (6, 6) by the
    right perturbation of T_this and by that of T_next. You may use `se3`.
    """
    step = se3.log(se3.inverse(T_this) @ T_next)
    by_this = -np.linalg.inv(se3.left_jacobian(step)) / tau
    by_next = np.linalg.inv(se3.right_jacobian(step)) / tau
    return by_this, by_next


twist_jacobians.slip("tau forgotten", "The twist is the logarithm divided by tau, and so are its derivatives.",
    ("left_jacobian(step)) / tau", "left_jacobian(step))"), ("right_jacobian(step)) / tau", "right_jacobian(step))"))
twist_jacobians.slip("left and right swapped", """The perturbation of T_next stands on the right of exp(tau xi), that of
    T_this on its left: J_r^-1 belongs to T_next, J_l^-1 to T_this.""",
    ("-np.linalg.inv(se3.left", "-np.linalg.inv(se3.right"),
    ("by_next = np.linalg.inv(se3.right", "by_next = np.linalg.inv(se3.left"))
twist_jacobians.slip("sign of T_this", """T_this enters inverted, (T exp(e^))^-1 = exp(-e^) T^-1: its derivative is
    negative.""", ("= -np", "= np"))
twist_jacobians.slip("plus and minus the identity", """The Jacobians are -I/tau and I/tau only where the step does not
    move; a step of a metre and a turn needs J_l^-1 and J_r^-1.""",
    ("np.linalg.inv(se3.left_jacobian(step))", "np.eye(6)"), ("np.linalg.inv(se3.right_jacobian(step))", "np.eye(6)"))
twist_jacobians.slip("Jacobians of the twist", """The Jacobians belong to tau xi, the logarithm itself; the division by
    tau stands outside.""", ("T_next)", "T_next) / tau"))


def systems(rng):
    for poses, landmarks in ((6, 1), (12, 3), (12, 5)):
        p, m = poses, 3 * landmarks
        J = rng.normal(size=(4 * (p + m), p + m))
        yield "random", (J.T @ J, rng.normal(size=p + m), p)


@exercise(chapter=11, cases=systems, shows=[batch.Factorised.solve], outputs=["S", "poses", "landmarks"], hints=[
    "Solve the lower rows for the landmarks, V m = b - E^T x, and put that into the upper rows.",
    "S = U - E V^-1 E^T, x = S^-1 (a - E V^-1 b), m = V^-1 (b - E^T x), with H = [[U, E], [E^T, V]] and g = [a, b]."])
def schur(H, g, n_poses):
    """Solve H [x, m] = g by eliminating the landmarks m.

    H : (n, n), positive definite. g : (n,). The first `n_poses` rows belong to the poses x, the others to the
    landmarks m. Returns the Schur complement S (n_poses, n_poses), x (n_poses,) and m (n - n_poses,).
    """
    U, E, V = H[:n_poses, :n_poses], H[:n_poses, n_poses:], H[n_poses:, n_poses:]
    a, b = g[:n_poses], g[n_poses:]
    S = U - E @ np.linalg.inv(V) @ E.T
    x = np.linalg.inv(S) @ (a - E @ np.linalg.inv(V) @ b)
    m = np.linalg.inv(V) @ (b - E.T @ x)
    return S, x, m


schur.slip("right side not reduced", """Eliminating the landmarks changes the right side as well: a - E V^-1 b. With a
    alone, what the cameras say about the landmarks is thrown away.""", ("(a - E @ np.linalg.inv(V) @ b)", "a"))
schur.slip("landmarks without the poses", "When the poses move, the landmarks move with them: V m = b - E^T x, not b.",
    ("(b - E.T @ x)", "b"))
schur.slip("plus E V^-1 E^T", "What the landmarks do not know is taken away from U: S = U - E V^-1 E^T.",
    ("U - E", "U + E"))
schur.slip("block cut out", """Cutting out U assumes the landmarks known. In the information matrix that is
    conditioning; to marginalise needs the Schur complement.""", ("U - E @ np.linalg.inv(V) @ E.T", "U"),
    ("(a - E @ np.linalg.inv(V) @ b)", "a"))


def linearised(rng):
    for n, m, damping in ((4, 2, 0.0), (10, 3, 0.1), (20, 5, 10.0)):
        yield "random", (rng.normal(size=n), rng.normal(size=(n, m)) * np.logspace(0, 1, m), damping)


@exercise(chapter=11, cases=linearised, shows=[batch.iterate], hints=[
    "Gauss-Newton solves J^T J delta = -J^T r. Levenberg-Marquardt makes the diagonal of J^T J larger.",
    "H = J.T @ J; solve (H + damping * diag(H)) delta = -J.T @ r."])
def marquardt_step(r, J, damping):
    """One step of Levenberg-Marquardt, the diagonal of the normal equations raised by the factor (1 + damping).

    r : (n,), residuals divided by their standard deviations. J : (n, m), their derivatives. damping : lambda >= 0.
    Returns the step delta (m,).
    """
    H = J.T @ J
    D = np.diag(np.diag(H))
    return np.linalg.solve(H + damping * D, -J.T @ r)


marquardt_step.slip("sign", "The step goes downhill: -J^T r on the right side.", ("-J.T @ r", "J.T @ r"))
marquardt_step.slip("identity in place of the diagonal", """That is Levenberg's older form. Metres and radians have
    different sizes, so Marquardt damps each unknown in its own unit: lambda times diag(H).""",
    ("np.diag(np.diag(H))", "np.eye(len(H))"))
marquardt_step.slip("whole matrix raised", "(1 + lambda) H only shortens the step. Only the diagonal is raised.",
    ("damping * D", "damping * H"))
marquardt_step.slip("no damping", "The damping is not used: this is Gauss-Newton.", ("H + damping * D", "H"))
marquardt_step.slip("diagonal replaced", """The diagonal is raised, not replaced: (1 + lambda) diag(H), so H + lambda
    diag(H).""", ("H + damping", "H - D + damping"))


def residuals(rng):
    yield "none", (np.zeros((1, 3)), 2.0)
    for n, c in ((3, 2.0), (6, 1.0), (6, 4.0)):
        yield "random", (rng.normal(size=(n, 3)) * rng.choice([0.5, 3.0, 30.0], size=(n, 1)), c)


@exercise(chapter=11, cases=residuals, shows=[batch.cauchy], outputs=["cost", "weight"], hints=[
    "One weight for one measurement: from the sum of its three squared residuals.",
    "With q = sum of r^2: cost c^2 log(1 + q / c^2); its derivative by q is the weight."])
def robust_weight(r, c):
    """Cauchy's loss of n measurements, and the weights with which least squares has the same gradient.

    r : (n, 3), the residuals of each measurement divided by their standard deviations. c : where a weight has fallen
    to one half. Returns cost (n,) = c^2 log(1 + |r|^2 / c^2) and weight (n,), its derivative by |r|^2.
    """
    q = np.sum(r**2, axis=1)
    cost = c**2 * np.log(1 + q / c**2)
    weight = 1 / (1 + q / c**2)
    return cost, weight


robust_weight.slip("root of the weight", """The weight multiplies the squared residual. Its root multiplies residual and
    Jacobian; return the weight itself.""", ("1 / (1 + q / c**2)", "1 / np.sqrt(1 + q / c**2)"))
robust_weight.slip("cost over squared residual", """The weight is the *derivative* of the cost by |r|^2, not their
    ratio: the gradient of the robust cost must be that of the weighted squares.""",
    ("1 / (1 + q / c**2)", "np.where(q > 0, cost / np.maximum(q, 1e-9), 1)"))
robust_weight.slip("|r| in place of |r|^2", "c is compared with |r|, so the ratio is |r|^2 / c^2.",
    ("np.sum(r**2, axis=1)", "np.sqrt(np.sum(r**2, axis=1))"))
robust_weight.slip("each number by itself", """Wrong tracks are wrong as a whole. The loss is of the measurement: sum
    its three squares first.""", ("np.sum(r**2, axis=1)", "r**2"),
    ("return cost, weight", "return cost.sum(axis=1), weight.mean(axis=1)"))
