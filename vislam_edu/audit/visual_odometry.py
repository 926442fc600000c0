"""How the cameras moved from each frame to the next, from the tracks alone: no IMU, no map, no filter.

All steps are solved at once, each on its own: one Gauss-Newton iteration is a few numpy calls over every pair of
observations that a landmark has in consecutive frames.

A pair is compared in the image. The point of the first frame, in homogeneous coordinates `[x, 1/depth]` of its ray, is
moved and projected into the second frame, which stays finite for disparities at and below zero; its own pixel noise is
carried along to first order. v_left and v_right have one model, so a pair carries three numbers [u_left, v, u_right].

Source: Hartley and Zisserman, Multiple View Geometry, section 4.2.6 (the Sampson approximation, which this is);
Barfoot, State Estimation for Robotics, section 9.1 (Gauss-Newton on SE(3)).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtr, chdtri

from .. import se3
from ..drive import Drive
from ..stereo import ROW_VARIANCE, reduce_rows

MIN_TRACKS = 8  # inlier tracks; below, six numbers from noisy pairs are not worth having
INLIER_PROBABILITY = 0.999  # of a correct pair to be taken for one
INLIER_D2 = chdtri(3, 1 - INLIER_PROBABILITY)  # squared distance that it corresponds to
_ROBUST_ROUNDS, _ITERATIONS = 3, 3  # the noise carried along changes slowly, once per round is enough
_TINY_PX = 1e-9
ENOUGH = 10.0  # times the pixel noise, median motion of the tracks over a step that is to be compared with the IMU
_LEAST_STEPS, _LEAST_LOOKS = 60, 3  # that are left of the drive and of the median track


@dataclass(frozen=True, eq=False)
class FrameMotions:
    """The cameras' motion over each step k -> k+1, and what each pair of observations says about it.

    motion : (T-1, 4, 4), pose of the left camera at frame k+1 in the left camera at frame k (identity where not ok).
    covariance : (T-1, 6, 6) of the right perturbation, `motion exp(epsilon^)`, order [m, rad] (zero where not ok).
    ok : (T-1,) bool, False where fewer than `MIN_TRACKS` tracks agree.
    taus : (T-1,) s. sigma_px : px, noise of a pixel coordinate that the residuals show.
    step : (P,) the step of each pair, ascending. before, after : (P,) rows of the drive's observations.
    mahalanobis2 : (P,) squared Mahalanobis distance of each pair from its step's motion, 3 degrees of freedom.
    """

    motion: np.ndarray
    covariance: np.ndarray
    ok: np.ndarray
    taus: np.ndarray
    sigma_px: float
    step: np.ndarray
    before: np.ndarray
    after: np.ndarray
    mahalanobis2: np.ndarray

    @cached_property
    def inlier(self) -> np.ndarray:
        """(P,) bool, pairs that agree with the motion of their step."""
        return self.ok[self.step] & (self.mahalanobis2 < INLIER_D2)

    @cached_property
    def twists(self) -> np.ndarray:
        """(T-1, 6) mean twist [v, omega] of the left camera over each step, in its own frame; zero where not ok."""
        return se3.log(self.motion) / self.taus[:, None]

    @cached_property
    def twist_covariance(self) -> np.ndarray:
        """(T-1, 6, 6) covariance of `twists`."""
        J = se3.right_jacobian_inverse(se3.log(self.motion)) / self.taus[:, None, None]
        return J @ self.covariance @ J.mT


def pairs(drive):
    """Observations of one landmark in consecutive frames: step (P,), row before (P,), row after (P,); by step."""
    order = np.lexsort((drive.frame, drive.landmark))
    before, after = order[:-1], order[1:]
    follows = (drive.landmark[before] == drive.landmark[after]) & (drive.frame[after] == drive.frame[before] + 1)
    before, after = before[follows], after[follows]
    by_step = np.lexsort((before, drive.frame[before]))
    before, after = before[by_step], after[by_step]
    return drive.frame[before], before, after


def row_noise(pixels) -> float:
    """Noise of one pixel coordinate, px, from v_left - v_right of pixels (N, 4); a constant offset does not count.

    Robust: 1.4826 times the median absolute deviation, over sqrt(2) because two coordinates are subtracted.
    """
    difference = pixels[:, 1] - pixels[:, 3]
    return float(1.4826 * np.median(np.abs(difference - np.median(difference))) / 2**0.5) if len(pixels) else 0.0


def estimate(drive) -> FrameMotions:
    """Robust stereo visual odometry between consecutive frames.

    Starts from no motion. Cauchy weights, whose width follows each step's median residual, let wrong tracks fade out;
    at the end what lies beyond the 99.9 % ellipse is left out and the rest is plain least squares, so that the
    covariance is the inverse Hessian. The pixel noise is one number for the drive: what the residuals show, or what
    v_left - v_right shows where that is more. (A stereo mismatch that stays with its track for life hardly shows in
    the residuals of one step, yet bends the motion.)
    """
    step, before, after = pairs(drive)
    problem = _Problem(drive, step, before, after)
    n_steps = drive.n_frames - 1
    after_T_before = np.broadcast_to(np.eye(4), (n_steps, 4, 4)).copy()
    if not len(step):
        return FrameMotions(motion=after_T_before, covariance=np.zeros((n_steps, 6, 6)), ok=np.zeros(n_steps, bool),
                            taus=drive.taus, sigma_px=float("nan"), step=step, before=before, after=after,
                            mahalanobis2=np.empty(0))

    for _ in range(_ROBUST_ROUNDS):
        whitener, gain = problem.whitener(after_T_before)
        for _ in range(_ITERATIONS):
            residual, jacobian = problem.whitened(after_T_before, whitener, gain)
            d2 = np.sum(residual**2, axis=-1)
            width2 = np.maximum(problem.median_by_step(d2) / chdtri(3, 0.5), _TINY_PX**2)
            weight = 1 / (1 + d2 / (3 * width2[step]))
            after_T_before, _ = problem.gauss_newton(after_T_before, residual, jacobian, weight)

    whitener, gain = problem.whitener(after_T_before)
    d2 = problem.distance2(after_T_before, whitener)
    least = max(row_noise(drive.pixels), _TINY_PX) ** 2
    variance = max(np.median(d2) / chdtri(3, 0.5), least)
    for _ in range(_ITERATIONS):
        residual, jacobian = problem.whitened(after_T_before, whitener, gain)
        inlier = np.sum(residual**2, axis=-1) < INLIER_D2 * variance
        after_T_before, information = problem.gauss_newton(after_T_before, residual, jacobian, inlier)
        d2 = problem.distance2(after_T_before, whitener)
        variance = max(problem.noise_variance(d2, INLIER_D2 * variance), least)

    d2 = d2 / variance
    count = np.bincount(step[d2 < INLIER_D2], minlength=n_steps)
    ok = (count >= MIN_TRACKS) & (np.linalg.cond(information) < 1e12)
    covariance = np.zeros((n_steps, 6, 6))
    covariance[ok] = variance * np.linalg.inv(information[ok])
    after_T_before[~ok] = np.eye(4)
    return FrameMotions(motion=se3.inverse(after_T_before), covariance=covariance, ok=ok, taus=drive.taus,
                        sigma_px=float(variance**0.5), step=step, before=before, after=after, mahalanobis2=d2)


class _Problem:
    """Residuals, Jacobians and normal equations of all steps; pixel noise 1 px until the residuals tell it."""

    def __init__(self, drive, step, before, after):
        camera = drive.camera
        self.step, self.n_steps = step, drive.n_frames - 1
        (fu, _, cu), (_, fv, cv), _ = camera.K
        self.focal, self.fb = np.array([fu, fv]), fu * camera.baseline
        self.centre = np.array([cu, cv, cu])
        first, self.measured = (reduce_rows(drive.pixels[rows]) - self.centre for rows in (before, after))
        ray = np.stack([first[:, 0] / fu, first[:, 1] / fv, np.ones(len(step))], axis=-1)
        self.point = np.column_stack([ray, (first[:, 0] - first[:, 2]) / self.fb])
        # Columns: how [ray, inverse depth] answers to u_left, v and u_right
        self.lifted = np.zeros((4, 3))
        self.lifted[0, 0], self.lifted[1, 1] = 1 / fu, 1 / fv
        self.lifted[3, 0], self.lifted[3, 2] = 1 / self.fb, -1 / self.fb

    def _predict(self, after_T_before, point=None):
        """Residual (P, 3) px, its Jacobian (P, 3, 4) by the moved homogeneous point, and that point (P, 4)."""
        q = np.matvec(after_T_before[self.step], self.point if point is None else point)
        depth = np.maximum(q[:, 2], 0.05)  # relative to the first frame's; a point that came 20 times nearer is wrong
        (fu, fv), fb = self.focal, self.fb
        u, v, disparity = fu * q[:, 0] / depth, fv * q[:, 1] / depth, fb * q[:, 3] / depth
        predicted = np.stack([u, v, u - disparity], axis=-1)
        slope = np.zeros((len(q), 3, 4))
        slope[:, 0, 0] = slope[:, 2, 0] = fu / depth
        slope[:, 1, 1] = fv / depth
        slope[:, 2, 3] = -fb / depth
        slope[:, :, 2] = -predicted / depth[:, None]
        return self.measured - predicted, slope, q

    def whitener(self, after_T_before):
        """Inverse Cholesky factor (P, 3, 3) of each residual's covariance for a pixel noise of 1 px.

        Also (P, 4, 3): how far each whitened residual moves the first frame's point [ray, inverse depth].
        """
        _, slope, _ = self._predict(after_T_before)
        G = slope @ after_T_before[self.step] @ self.lifted
        S = (G * ROW_VARIANCE) @ G.mT
        S[:, range(3), range(3)] += ROW_VARIANCE
        whitener = np.linalg.inv(np.linalg.cholesky(S))
        return whitener, self.lifted * ROW_VARIANCE @ (whitener @ G).mT

    def whitened(self, after_T_before, whitener, gain):
        """Residuals (P, 3) and Jacobians (P, 3, 6) by the left perturbation of the motion, both of unit noise."""
        residual = np.matvec(whitener, self._predict(after_T_before)[0])
        # At the noisy point the Jacobian's own noise would draw the motion towards none (errors in variables)
        _, slope, q = self._predict(after_T_before, self.point + np.matvec(gain, residual))
        moved = np.zeros((len(q), 4, 6))  # odot of a homogeneous point: [w I, -q^]
        moved[:, range(3), range(3)] = q[:, 3:]
        moved[:, :3, 3:] = -se3.so3_hat(q[:, :3])
        return residual, whitener @ (slope @ moved)

    def distance2(self, after_T_before, whitener):
        """Squared Mahalanobis distance (P,) of each pair for a pixel noise of 1 px."""
        return np.sum(np.matvec(whitener, self._predict(after_T_before)[0]) ** 2, axis=-1)

    def gauss_newton(self, after_T_before, residual, jacobian, weight):
        """One iteration; returns the new motions and the information matrices (T-1, 6, 6) for unit noise."""
        weighted = (jacobian * weight[:, None, None]).mT
        information = self._sum(weighted @ jacobian)
        gradient = self._sum(np.matvec(weighted, residual))
        damping = 1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] / 6 + 1e-12
        delta = np.linalg.solve(information + damping * np.eye(6), gradient[..., None])[..., 0]
        length = np.linalg.norm(delta[:, 3:], axis=-1, keepdims=True)
        delta = delta / np.maximum(1, length / 0.5)  # a step with too few tracks must not spin away
        return se3.exp(delta) @ after_T_before, information

    def _sum(self, values):
        """Sum over the pairs of each step."""
        starts = np.flatnonzero(np.diff(self.step, prepend=-1))
        total = np.zeros((self.n_steps, *values.shape[1:]))
        total[self.step[starts]] = np.add.reduceat(values, starts, axis=0)
        return total

    def median_by_step(self, values):
        """(T-1,) median over the pairs of each step, 0 where there is none."""
        order = np.lexsort((values, self.step))
        count = np.bincount(self.step, minlength=self.n_steps)
        start = np.cumsum(count) - count
        middle = np.minimum(start + count // 2, len(values) - 1)
        return np.where(count > 0, values[order][middle], 0.0)

    def noise_variance(self, d2, limit):
        """px^2, from the pairs within the limit: six numbers per step went into the fit, the tail is cut off."""
        inlier = d2 < limit
        used = np.bincount(self.step[inlier], minlength=self.n_steps)
        enough = used >= MIN_TRACKS
        inlier &= enough[self.step]
        freedom = 3 * inlier.sum() - 6 * enough.sum()
        kept = chdtr(5, INLIER_D2) / chdtr(3, INLIER_D2)  # E[d2 | d2 < INLIER_D2] / 3 for three degrees of freedom
        return d2[inlier].sum() / max(freedom, 1) / kept


def stride(drive: Drive, motions: FrameMotions) -> int:
    """Over how many frames the tracks of a slow drive move by much more than their noise."""
    flow = np.linalg.norm((drive.pixels[motions.after] - drive.pixels[motions.before])[:, :2], axis=1)
    if not len(flow):
        return 1
    wanted = np.ceil(ENOUGH * motions.sigma_px / max(np.median(flow), 1e-9))
    length = np.median(drive.last_seen - drive.first_seen + 1)
    return int(np.clip(min(wanted, drive.n_frames // _LEAST_STEPS, length // _LEAST_LOOKS), 1, None))


def thin(drive: Drive, every: int) -> Drive:
    """Every so many frames of a drive, its IMU samples the constant twists that lead from one to the next."""
    if every == 1:
        return drive
    poses = se3.chain(np.eye(4), se3.exp(drive.step_twists * drive.taus[:, None]))
    kept, times, seen = poses[::every], drive.times[::every], drive.frame % every == 0
    twists = se3.log(se3.inverse(kept[:-1]) @ kept[1:]) / np.diff(times)[:, None]
    return Drive(times=times, twists=np.vstack([twists, twists[-1:]]), camera=drive.camera, imu_sample="k",
                 frame_start=np.r_[0, np.cumsum(drive.visible[::every])], landmark=drive.landmark[seen],
                 pixels=drive.pixels[seen], n_landmarks=drive.n_landmarks)
