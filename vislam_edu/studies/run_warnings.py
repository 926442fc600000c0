"""What speaks against a run, in sentences: its numbers beside what they would be if its covariance were right.

`of_filter`, `of_batch` and `of_recording` return lists of sentences, each with its number and what to do; a healthy run
gets none. How often each speaks, and whether it should have, is measured in `docs/warnings.md`.

What is measured in one frame shares the error of one pose, so a sum over N measurements scatters more than N
independent ones would. Frames are independent if the filter is right: every band here comes from the scatter of the
frames.
"""

import numpy as np
from scipy.special import gammainc

from .. import inertial, kalman, metrics
from ..audit import track_checks, visual_odometry, whole
from ..error_state import RightPerturbation
from .calibration import LENS_CORRECTED
from .runs import against_truth

FEW_TRACKS = 10  # in view on average
MOST_SIGMA = 3.3  # a sum over frames strays further once in 2000 healthy runs, on one side
MOST_REJECTED, MOST_NIS = 1.5, 1.1  # of what is expected: less does no harm
MOST_REPEATED = 0.1  # correlation of one track's disparity residuals in successive frames
LEAST_DISPARITY = {"cartesian": 8.0, "inverse depth": 1.6}  # median, over its noise; below, regimes are not honest
MOST_PARTED = kalman.chi_square_quantile(1 - 1e-5, 6)  # of dead reckoning's NEES, at the worst of hundreds of frames
LEAST_INSIDE = 1 / 3  # share of the frames in which a random walk is inside 3 sigma: less once in 1000, of six axes
# Mean NEES of one healthy drive, exceeded once in 1000. A pose's error is a sum of steps. For a random walk W whose
# variance is t, the mean of W^2 / t has the variance 1, half of chi-square's: a drive is worth two independent frames.
MOST_NEES = metrics.chi2_band(6, runs=2, probability=0.998)[1]
MOST_COST = 1.2  # of the batch, over the upper end of its chi-square band
LONG_GAP = 10.0  # s
LEAST = {"sigma_v": 1e-4, "sigma_omega": 1e-5, "sigma_px": 1e-3}  # m/s, rad/s, px
MOST = {"sigma_v": 100.0, "sigma_omega": 10.0, "sigma_px": 100.0}


def has_few_tracks(drive) -> bool:
    """Whether a drive's tracks are too few for a filter of this kind to improve on dead reckoning."""
    return bool(drive.visible.mean() < FEW_TRACKS)


def needs_no_truth(warning) -> bool:
    """Whether a warning is about numbers that every run has."""
    return not warning.startswith("against the ground truth")


def _untrue(name, true, world_T_imu, covariance):
    nees, inside = against_truth(true, world_T_imu, covariance)
    if nees > MOST_NEES or inside < LEAST_INSIDE:
        yield (f"against the ground truth, the {name}'s mean NEES is {nees:.2g} where 6 is right and {MOST_NEES:.2g} "
               f"the most for one drive, and it is inside 3 sigma in {inside:.0%} of the frames on its worst axis: its "
               "covariance is too small for its errors; audit the recording, then try --calibration or --lens")


def sigmas_from_zero(values, frame) -> float:
    """How far a sum of values (N,) is from 0, in standard deviations, frames being independent. frame : (N,)."""
    of_frames = np.bincount(frame, weights=values, minlength=1)
    return float(of_frames.sum() / max(np.linalg.norm(of_frames), 1e-300))


def repeated_disparity(run) -> tuple[float, float]:
    """Correlation of one track's disparity residuals in successive frames, 0 if right, and how many sigmas from 0.

    A disparity depends on no pose, so only pixels, calibration or an ill-placed landmark make it repeat.
    run : `runs.Run`.
    """
    order = np.lexsort((run.frame, run.ids))
    before, after = order[:-1], order[1:]
    pair = ((run.ids[before] == run.ids[after]) & (run.frame[before] + 1 == run.frame[after])
            & run.accepted[before] & run.accepted[after])
    before, after = before[pair], after[pair]
    left_over = run.residual[:, 0] - run.residual[:, 2]
    size = np.linalg.norm(left_over[before]) * np.linalg.norm(left_over[after])
    product = left_over[before] * left_over[after]
    return float(product.sum() / max(size, 1e-300)), sigmas_from_zero(product, run.frame[after])


def of_innovations(run, gate, considered=False):
    """The gate, the NIS of what it lets pass, and, where no lens was `considered`, whether residuals repeat."""
    if not run.accepted.any():
        return
    rejected, threshold = ~run.accepted, kalman.gate_threshold(gate)
    strays = sigmas_from_zero(rejected - (1 - gate), run.frame)
    if gate < 1 and strays > MOST_SIGMA and rejected.mean() > MOST_REJECTED * (1 - gate):
        yield (f"the gate kept out {rejected.mean():.2%} of the measurements where {1 - gate:.2%} is expected, "
               f"{strays:.1f} sigma more: tracks, calibration or noise are not what the filter assumes, so do not "
               "trust its covariance (python -m vislam_edu audit shows which)")
    expected = 4 * gammainc(3, threshold / 2) / gate  # mean of a chi-square number below the threshold
    nis, frame = run.nis[run.accepted], run.frame[run.accepted]
    strays = sigmas_from_zero(nis - expected, frame)
    if nis.mean() > MOST_NIS * expected and strays > MOST_SIGMA:
        yield (f"the mean NIS of what the gate let pass is {nis.mean():.2f} where {expected:.2f} is right, "
               f"{strays:.1f} sigma more: the noise is larger than assumed; give --sigma-v, --sigma-omega and "
               "--sigma-px as the audit measures them")
    repeated, strays = repeated_disparity(run)
    if repeated > MOST_REPEATED and strays > MOST_SIGMA and not considered:
        yield (f"what a track's disparity is off by repeats in the next frame (correlation {repeated:.2f} where 0 is "
               f"right, {strays:.1f} sigma): errors of lenses, tracks or landmarks that do not average out, so the "
               "covariance is too small; add those of the calibration (--calibration) or estimate them (--lens)")


def of_filter(drive, slam, dead_reckoning, gate, true=None, calibration=None) -> list[str]:
    """What speaks against a joint filter's result.

    drive, gate : of the filter. slam : `pipeline.Slam`. dead_reckoning : Trajectory. true : (T, 4, 4) in the
    filter's world, NaN in frames without truth; None: no truth. calibration : (T, 6, 6), what it adds, or None.
    """
    considered = calibration is not None or LENS_CORRECTED in drive.history
    found, path = list(of_innovations(slam.run, gate, considered)), slam.trajectory
    if drive.imu is not None and not inertial.stands_still(drive):
        found.append(f"the drive does not begin at rest: gravity, velocity and biases at its start were found from the "
                     f"cameras' path over {inertial.ALIGN:g} s")
    if has_few_tracks(drive):
        found.append(f"{drive.visible.mean():.0f} tracks in view on average where a filter of this kind needs "
                     f"{FEW_TRACKS}: dead reckoning may be the better path, compare both")
    kind = "cartesian" if len(slam.run.error_state.point_shape) == 1 else "inverse depth"
    disparity = np.median(drive.pixels[:, 0] - drive.pixels[:, 2]) if len(drive.pixels) else np.inf
    sigma_px = np.sqrt(2) * visual_odometry.row_noise(drive.pixels)
    if disparity < LEAST_DISPARITY[kind] * sigma_px:
        found.append(f"half of the disparities are below {disparity / sigma_px:.1f} times their noise, where landmarks "
                     f"of {kind} coordinates need {LEAST_DISPARITY[kind]:g}: depth is hardly measured; "
                     + ("take --error-state inverse-depth" if kind == "cartesian" else "trust dead reckoning more"))
    R, P = path.world_T_imu[:, :3, :3], path.covariance
    turned = np.sqrt(np.diagonal(R @ P[:, 3:, 3:] @ R.mT, axis1=1, axis2=2))  # (T, 3) rad, about the world's axes
    k, axis = np.unravel_index(np.argmin(turned / np.maximum(turned[0], 1e-12)), turned.shape)
    if drive.imu is None and turned[k, axis] < 0.9 * turned[0, axis]:
        found.append(f"the filter claims at frame {k} to know its rotation about the world's {'xyz'[axis]} axis to "
                     f"{np.degrees(turned[k, axis]):.2g} deg, at the start to {np.degrees(turned[0, axis]):.2g} deg: "
                     "no sensor measures it, so its covariance is wrong; take --error-state inverse-depth")
    parted = metrics.nees(RightPerturbation().pose_difference(path.world_T_imu, dead_reckoning.world_T_imu)[1:],
                          dead_reckoning.covariance[1:])
    if parted.max(initial=0) > MOST_PARTED:
        found.append(f"the filter and dead reckoning part by more than the noise of the IMU explains (at frame "
                     f"{parted.argmax() + 1} the squared distance over the covariance is {parted.max():.0f}, where "
                     f"{MOST_PARTED:.0f} is the most): the IMU has a bias or a scale, or the filter has gone wrong; "
                     "audit the recording")
    ends = [np.sqrt(np.trace(t.covariance[-1, :3, :3])) for t in (path, dead_reckoning)]
    if ends[0] > ends[1]:
        found.append(f"by its own covariance the filter ends uncertain by {ends[0]:.2g} m, dead reckoning by "
                     f"{ends[1]:.2g} m: the cameras' part does not help here")
    if true is not None:
        found += _untrue("filter", true, path.world_T_imu, P if calibration is None else P + calibration)
    return found


def of_batch(smoothed, true=None) -> list[str]:
    """What speaks against a `pipeline.Smoothed`. true : (T, 4, 4) in its world, NaN in frames without it, or None."""
    solution, dof, found = smoothed.solution, max(smoothed.solution.problem.dof, 1), []
    if not solution.converged:
        found.append(f"the batch estimate had not come to rest after {solution.iterations} iterations: its path is "
                     "on the way to a minimum, not there")
    if not solution.cost_per_dof <= MOST_COST * metrics.chi2_band(dof)[1] / dof:
        found.append(f"the cost of the batch estimate is {solution.cost_per_dof:.2f} per degree of freedom where 1 "
                     "is right: it ended in a wrong minimum, or the noise is not what is assumed")
    if true is not None:
        frames, covariance = smoothed.claims
        found += _untrue("batch estimate", true[frames], solution.estimate.world_T_imu[frames], covariance)
    return found


def of_recording(drive) -> list[str]:
    """What the quick part of the audit finds in a drive that was not audited; it costs 0.05 s where the whole takes 3.

    Left out are the checks that need the cameras' motion: outlier tracks, calibration and IMU.
    """
    found = [*whole.certain(drive), *track_checks.without_motion(drive)]
    names = ", ".join(f"{finding.fault} ({finding.size:.4g} {finding.unit})" for finding in found)
    return [f"the recording was not audited; the quick part of the audit finds {names}: run it with --audit"
            ] if found else []


def unusable(result) -> list[str]:
    """Names of the estimates whose numbers are not finite or whose covariances are not positive definite."""
    estimates = {"dead reckoning": (result.dead_reckoning.world_T_imu, result.dead_reckoning.covariance),
                 "the map on the poses of dead reckoning": _seen(result.mapped.map),
                 "the path": (result.slam.trajectory.world_T_imu, result.slam.trajectory.covariance),
                 "the map": _seen(result.slam.map)}
    return [name for name, (mean, covariance) in estimates.items()
            if not (np.isfinite(mean).all() and positive_definite(covariance))]


def _seen(found):
    return found.landmarks[found.seen], found.covariance[found.seen]


def positive_definite(covariance: np.ndarray) -> bool:
    """Whether all of these matrices (..., d, d) are finite and positive definite in floating point numbers."""
    if not np.isfinite(covariance).all():
        return False
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return False
    return True


def likely_reason(drive, noise) -> str:
    """What in a recording or in the assumed noise is likely to have broken a filter, in words."""
    gaps = np.diff(drive.times)
    if len(gaps) and gaps.max() > LONG_GAP:
        k = int(gaps.argmax())
        return (f"likely because of the gap of {gaps[k]:.3g} s after frame {k}: use the part before (--to {k + 1}) "
                f"or after (--from {k + 1})")
    given = {name: getattr(noise, name) for name in LEAST}
    for name, value in given.items():
        if value > MOST[name]:
            return f"likely because the assumed noise is huge: {name} is {value:.3g}"
    for name, value in given.items():
        if value < LEAST[name]:
            return f"likely because the assumed noise is tiny: {name} is {value:.3g}; assume more"
    return "neither a gap nor the assumed noise explains it; `audit` says what else may be wrong with the recording"
