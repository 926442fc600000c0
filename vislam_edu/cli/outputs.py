"""What the command line leaves behind of a `pipeline.Result`: numbers, trajectories, arrays and figures."""

import errno
import json
import math
import os
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .. import metrics, recordings, se3
from ..motion import symmetric
from ..plots import report_figures, style
from ..recordings.files import made_folder, part_of
from ..studies import run_warnings, runs

PNG = style.PNG | {"pil_kwargs": {"compress_level": 3}}  # 2 % more bytes than 6, the default, in a third of the time
SOMETIMES = ("lens.json", "fig8_batch.png")  # files that not every run leaves


def summary(result, smoothed=None, lens=None, warnings=()) -> dict:
    """The numbers that sum a run up; keys name their units, docs/commands.md says what each is.

    result : `pipeline.Result`. smoothed : `pipeline.Smoothed` or None. lens : the `LensErrors` that corrected the
    pixels, or None. warnings : sentences that come before those of the result.
    """
    drive, slam = result.drive, result.slam
    numbers = {"frames": drive.n_frames, "duration_s": drive.duration, "landmarks": drive.n_landmarks,
               "landmarks_used": int(np.count_nonzero(slam.map.seen)), "measurements": slam.measurements,
               "rejected_share": slam.rejected_share, "filter_s": slam.seconds,
               "real_time_factor": drive.duration / slam.seconds, "metre": slam.metre}
    path, plain = slam.trajectory.world_T_imu, slam.trajectory.covariance
    numbers |= _claims(drive, path, plain, "_without_calibration_error", "")
    if result.calibration is not None:
        numbers |= _claims(drive, path, plain + result.calibration, "_with_calibration_error", "_with_calibration")
    if drive.has_truth:
        numbers |= _errors(drive, path, "")
        numbers |= _errors(drive, result.dead_reckoning.world_T_imu, "dead_reckoning_")
        percent, degrees = metrics.kitti_drift(drive.truth_world_T_cam, _world_T_cam(drive, slam.trajectory))
        numbers |= {"drift_percent": percent, "drift_deg_per_m": degrees}
    found = [*warnings, *result.warnings]
    if smoothed is not None:
        solution, (frames, covariance) = smoothed.solution, smoothed.claims
        poses = solution.estimate.world_T_imu
        numbers |= {"batch_s": smoothed.seconds, "batch_iterations": solution.iterations}
        if drive.has_truth:
            numbers |= _errors(drive, poses, "batch_")
            world_T_cam = poses @ drive.camera.imu_T_cam
            numbers["batch_drift_percent"] = metrics.kitti_drift(drive.truth_world_T_cam, world_T_cam)[0]
        numbers["batch"] = {"cost_per_dof": solution.cost_per_dof, "converged": solution.converged,
                            **_claims(solution.problem.drive, poses, covariance, "", "", frames)}
        found += run_warnings.of_batch(smoothed, runs.truth_beside(drive, poses))
    if lens is not None:
        numbers |= {"lens_px": lens.px, "lens_sigma_px": lens.sigma_px}
    numbers["recommended"] = "dead reckoning" if run_warnings.has_few_tracks(drive) else "filter"
    return numbers | {"changed": list(drive.history), "warnings": found}


def _claims(drive, world_T_imu, covariance, label, suffix, frames=slice(None)):
    """What a covariance (n, 6, 6) of right perturbations claims at the end, and how honest it is if there is truth.

    frames : (n,) that it belongs to, by default all.
    """
    numbers = {f"end_sigma_m{label}": float(np.sqrt(np.trace(covariance[-1, :3, :3])))}
    if drive.has_truth:
        truth = runs.truth_beside(drive, world_T_imu)
        nees, inside = runs.against_truth(truth[frames], world_T_imu[frames], covariance)
        numbers |= {f"nees_pose{suffix}": nees, f"inside_3_sigma{suffix}": inside}
    return numbers


def _errors(drive, world_T_imu, prefix):
    truth = runs.truth_beside(drive, world_T_imu)
    error = metrics.position_errors(truth, world_T_imu)
    world_T_cam = world_T_imu @ drive.camera.imu_T_cam
    return {f"{prefix}position_rmse_m": float(np.sqrt(np.mean(error**2))),
            f"{prefix}ate_m": metrics.ate(drive.truth_world_T_cam, world_T_cam)}


def _world_T_cam(drive, trajectory):
    """(T, 4, 4) poses of the left camera, the world being the camera at frame 0: KITTI's convention."""
    world_T_cam = trajectory.world_T_imu @ drive.camera.imu_T_cam
    return se3.inverse(world_T_cam[0]) @ world_T_cam


def table(numbers) -> str:
    """A summary as text, one number a line."""
    flat = {key: value for key, value in numbers.items() if not isinstance(value, dict)}
    flat |= {f"{name}_{key}": value for name, inner in numbers.items() if isinstance(inner, dict)
             for key, value in inner.items()}
    return "\n".join(f"{key:<40}{_short(value)}" for key, value in flat.items() if not isinstance(value, list))


def _short(value):
    return str(value) if isinstance(value, int | str) else f"{value:.4g}"


def _strict(value):
    """JSON knows no NaN: null instead."""
    if isinstance(value, dict):
        return {key: _strict(inner) for key, inner in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def write(result, folder, smoothed=None, lens=None, warnings=()):
    """Write all that `run` leaves (docs/commands.md) into an empty folder; arguments and result as of `summary`."""
    folder, drive, slam = Path(folder), result.drive, result.slam
    numbers = summary(result, smoothed, lens, warnings)
    (folder / "summary.json").write_text(json.dumps(_strict(numbers), indent=2) + "\n", encoding="utf-8")
    if lens is not None:
        lens.save(folder / "lens.json")
    for layout in ("kitti", "tum"):
        (folder / layout).mkdir()
    for name, trajectory in (("trajectory", slam.trajectory), ("dead_reckoning", result.dead_reckoning)):
        poses = _world_T_cam(drive, trajectory)
        if drive.left_T_cam is not None:
            poses = drive.left_T_cam @ poses @ se3.inverse(drive.left_T_cam)
        recordings.save_kitti(folder / "kitti" / f"{name}.txt", poses)
        recordings.save_tum(folder / "tum" / f"{name}.txt", drive.times, poses)
    seen = slam.map.seen
    arrays = {"times": drive.times, "landmark_ids": np.flatnonzero(seen), "landmarks": slam.map.landmarks[seen],
              "landmark_covariance": symmetric(slam.map.covariance[seen])}
    for prefix, trajectory in (("", slam.trajectory), ("dead_reckoning_", result.dead_reckoning)):
        arrays |= {f"{prefix}world_T_imu": trajectory.world_T_imu,
                   f"{prefix}pose_covariance": symmetric(trajectory.covariance)}
    if result.calibration is not None:
        arrays["calibration_covariance"] = result.calibration
    if smoothed is not None:
        estimate = smoothed.solution.estimate
        arrays |= {"batch_world_T_imu": estimate.world_T_imu, "batch_landmarks": estimate.landmarks}
        report_figures.batch(result, estimate.world_T_imu).savefig(folder / "fig8_batch.png", **PNG)
    np.savez_compressed(folder / "result.npz", **arrays)
    for name, draw in report_figures.FIGURES.items():
        draw(result).savefig(folder / f"{name}.png", **PNG)
    return numbers


@contextmanager
def appearing_in(folder):
    """A scratch folder whose files move into `folder` when the block ends well, and vanish when it does not.

    An interrupted run thus leaves nothing half-written and what was there before as it was; so does one that has a file
    that cannot be put in its place. Files of an earlier run that this one does not write go.
    Entering makes `folder`: one that cannot be written to is found before the work.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "is a file, expected a folder", str(folder))
    with made_folder(folder):
        scratch = part_of(folder, "run")
        try:
            scratch.mkdir()
            yield scratch
            moves = [(path, folder / path.relative_to(scratch)) for path in sorted(scratch.rglob("*"))]
            gone = {folder / name for name in SOMETIMES} - {target for _, target in moves}
            for path, target in moves:
                _check_target(path, target)
            for path, target in moves:
                if path.is_dir():
                    target.mkdir(exist_ok=True)
                else:
                    os.replace(path, target)
            for path in gone:
                path.unlink(missing_ok=True)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


def _check_target(path: Path, target: Path) -> None:
    """Raises OSError when a file or folder cannot be put there."""
    if target.exists() and path.is_dir() != target.is_dir():
        raise OSError(errno.EEXIST, f"is in the way of a new {'folder' if path.is_dir() else 'file'}", str(target))
    if target.parent.exists() and not os.access(target.parent, os.W_OK):
        raise PermissionError(errno.EACCES, "Permission denied", str(target))


def description(drive) -> str:
    """What is in a recording, as text."""
    disparity = drive.pixels[:, 0] - drive.pixels[:, 2]
    length = drive.last_seen - drive.first_seen + 1
    truth = "none"
    if drive.truth_world_T_cam is not None:
        truth = f"poses of {np.count_nonzero(np.isfinite(drive.truth_world_T_cam[:, 0, 0]))} frames"
        truth += "" if drive.truth_landmarks is None else ", landmarks"
    lines = {
        "name": drive.name,
        "source": drive.source,
        "frames": f"{drive.n_frames} in {drive.duration:.2f} s",
        "IMU sample for step k": drive.imu_sample,
        "accelerometer": "none" if drive.imu is None else (
            f"{len(drive.imu.times)} samples from {drive.imu.times[0]:.2f} to {drive.imu.times[-1]:.2f} s"),
        "speed": f"{np.linalg.norm(drive.twists[:, :3], axis=1).mean():.2f} m/s on average",
        "landmarks": f"{drive.n_landmarks}, in view at once {_spread(drive.visible)}",
        "frames of a track": _spread(length[drive.first_seen >= 0]),
        "observations": f"{len(drive.pixels)}, {np.count_nonzero(disparity <= 0)} with a disparity <= 0",
        "camera": f"f {drive.camera.K[0, 0]:.2f} px, baseline {drive.camera.baseline:.4f} m",
        "camera in the IMU frame": f"{np.round(drive.camera.imu_T_cam[:3, 3], 3).tolist()} m",
        "ground truth": truth,
        "changed": "; ".join(drive.history) or "nothing",
    }
    return "\n".join(f"{key:<26}{value}" for key, value in lines.items())


def _spread(counts):
    if not len(counts):
        return "none"
    return f"{counts.min()} to {counts.max()}, {counts.mean():.1f} on average"
