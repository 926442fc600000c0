"""How far a path may be off because the calibration is: what the covariance of a filter cannot know.

The noise of a measurement is drawn anew in every frame and averages out; an error of a lens is the same in every frame
and does not. A filter that takes all errors for noise becomes too sure of itself: its sigma grows with the root of the
distance, its error with the distance. What cannot be learned from the drive itself is not estimated here but
considered: each knob of the calibration is turned by one standard deviation of what is known about it, the path is
found once more, and the outer product of what has moved is added,

    P_k += sum_j d_kj d_kj^T.

>>> from vislam_edu.studies import calibration
>>> len(calibration.GAUGES), len(calibration.LENS_PX)
(10, 7)

Source: Bierman, Factorization methods for discrete sequential estimation, 1977, chapter 8 (consider covariance).
"""

import numpy as np

from .. import se3
from ..error_state import RightPerturbation
from ..simulate import faults

SCALE = 0.008
BORESIGHT, LEVER_ARM, START = np.radians(0.3), 0.2, np.radians(0.1)  # rad, m, rad: about and along each axis
GAUGES = [("scale", 0), *[(name, axis) for name in ("boresight", "lever arm", "start") for axis in range(3)]]

LENS_CORRECTED = "pixels corrected by the lens"  # in the history of such a drive

# px at one focal length from the centre of the image: the scatter that careful calibrations of one rig have
LENS_PX = {"disparity": 0.1, "disparity_with_u_2": 3.0, "disparity_with_v_2": 1.5, "focal_length": 2.0, "radial": 2.0,
           "tangential_along_u": 1.5, "tangential_along_v": 0.7}


def turned(world_T_imu, gauge):
    """(T, 4, 4): the path with one of `GAUGES` turned by one standard deviation; no filter has to run again.

    The cameras measure their own path; a mounting that is wrong by B turns the IMU's path T into B T B^-1.
    """
    name, axis = gauge
    if name == "scale":
        path = world_T_imu.copy()
        path[:, :3, 3] = path[0, :3, 3] + (1 + SCALE) * (path[:, :3, 3] - path[0, :3, 3])
        return path
    small = np.zeros(6)
    small[axis + (0 if name == "lever arm" else 3)] = {"boresight": BORESIGHT, "lever arm": LEVER_ARM,
                                                       "start": START}[name]
    B, first = se3.exp(small), world_T_imu[0]
    from_start = se3.inverse(first) @ world_T_imu
    return first @ B @ from_start @ (np.eye(4) if name == "start" else se3.inverse(B))


def moved(world_T_imu, other):
    """(T, 6) by what right perturbation, [m, rad], a path (T, 4, 4) differs from the other."""
    return RightPerturbation().pose_difference(other, world_T_imu)


def covariance(drive, world_T_imu, find_path, progress=lambda runs, **_: runs, lens_px=None):
    """(T, 6, 6) of right perturbations, what errors of the calibration add to the covariance of a path.

    drive : Drive. world_T_imu : (T, 4, 4), what `find_path(drive)` gives; it is called once more for each of `LENS_PX`,
    in as many processes as `joblib.parallel_config` says. progress : called as `progress(runs, total=, desc=, unit=)`.
    lens_px : in place of `LENS_PX`, where a lens was estimated and less is left of it.
    """
    import joblib  # here: `run` needs it for nothing else

    lens_px = LENS_PX if lens_px is None else lens_px
    ways = [moved(world_T_imu, turned(world_T_imu, gauge)) for gauge in GAUGES]
    jobs = (joblib.delayed(find_path)(faults.lens_error(drive, **{knob: px})) for knob, px in lens_px.items())
    paths = joblib.Parallel(return_as="generator")(jobs)
    ways += [moved(world_T_imu, path) for path in progress(paths, total=len(lens_px), desc="calibration", unit="run")]
    return sum(way[:, :, None] * way[:, None, :] for way in ways)
