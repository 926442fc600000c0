"""What each step of chapter 8 is worth on real recordings with ground truth, and how little the tuning matters then.

    python benchmarks/real_drives.py [RECORDING GROUND_TRUTH ...] [--out FILE]

One setting for all recordings: gate 99 %, 1 px, the IMU's noise as the audit measured it. Without arguments the
recordings of `KNOWN` that are in data/ or the working directory are taken. The table goes to the terminal and, as
numbers, to a JSON file that chapter 8 reads; nothing of the recordings themselves is in it.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: CPU seconds are compared, of one core

import argparse
import json
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from vislam_edu import metrics, odometry, recordings, robust, window_slam
from vislam_edu.audit import audit, cures
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.motion import TwistAndBias
from vislam_edu.noise import Noise
from vislam_edu.recordings import files
from vislam_edu.studies import calibration, pipeline, scale

KNOWN = {"0027.npz": "0027_ground_truth.txt"}
RESULTS = Path(__file__).parent / "results" / "real_drives.json"
TRACK_FAULTS = {"copy frames", "frozen tracks", "behind infinity", "row offset", "outlier tracks"}
BiasOnly = partial(TwistAndBias, walk_v=1e3, walk_omega=1e3)  # the twist is forgotten at once: the IMU drives the pose


def accuracy(drive, world_T_imu) -> dict:
    """KITTI drift (%) and ATE (m) of the left camera. world_T_imu : (T, 4, 4)."""
    world_T_cam = world_T_imu @ drive.camera.imu_T_cam
    return {"drift_percent": metrics.kitti_drift(drive.truth_world_T_cam, world_T_cam)[0],
            "ate_m": metrics.ate(drive.truth_world_T_cam, world_T_cam)}


def filtered(drive, noise, error_state=None, **options) -> dict:
    """Accuracy of one run of the joint filter, the share of measurements its gate kept out, and CPU seconds."""
    error_state = error_state or RightInvariant()
    poses, measurements, rejected = np.empty((drive.n_frames, 4, 4)), 0, 0
    begin = time.process_time()
    for step in window_slam.run(drive, noise, error_state, **options):
        poses[step.k] = step.posterior.world_T_imu
        measurements += len(step.innovation.ids)
        rejected += np.count_nonzero(~step.innovation.accepted)
    seconds = time.process_time() - begin
    return {**accuracy(drive, poses), "rejected_share": float(rejected / measurements), "cpu_s": seconds}


def read_right(report):
    """The drive as its file is to be read, tracks untouched: cures that need no future and concern the IMU alone."""
    drive = report.drive
    for finding in report.findings:
        if finding.cure and not finding.cure.needs_future and finding.fault not in TRACK_FAULTS:
            drive = drive.apply(finding.cure)
    return drive


def treatments(report):
    """Yield (name, numbers): to the last cure each treatment is the one before it and one thing more."""
    raw, noise = report.drive, pipeline.noise_of_real_drive(report.noise)
    yield "dead reckoning", accuracy(raw, odometry.dead_reckon(raw, noise).world_T_imu)
    yield "the report's filter and values", filtered(
        raw, Noise.from_report(), RightPerturbation(), process_frame=window_slam.as_report, gate=1)
    tracks_as_they_are = read_right(report)
    yield "file read right, tracks as they are", filtered(tracks_as_they_are, noise)
    ended = tracks_as_they_are.apply(cures.end_tracks_at_copies())
    yield "tracks ended at copy frames", filtered(ended, noise)
    yield "and the gyro bias as 3 states", filtered(ended, noise, motion_model=BiasOnly)
    yield "and the twist as 6 states", filtered(ended, noise, motion_model=TwistAndBias)
    yield "every cure the audit names", filtered(report.cured(), noise, motion_model=TwistAndBias)
    yield "the same, right perturbation", filtered(report.cured(), noise, RightPerturbation(),
                                                   motion_model=TwistAndBias)
    yield from honest_treatments(report.cured(), noise)
    for name, numbers in honest_treatments(report.cured(needs_future=False), noise):
        yield f"{name}, causal", numbers


def honest_treatments(drive, noise):
    """Yield (name, numbers) of what makes the filter of real drives honest, one thing more each time."""
    walks = partial(TwistAndBias, walk_v=0.1, walk_omega=0.03)
    options = {"noise": noise, "error_state": RightInvariant(), "process_frame": robust.process_frame}
    yield "robust weights, a steadier twist", judged(drive, pipeline.joint(drive, motion_model=walks, **options))
    options["motion_model"] = robust.RealDrive
    yield "and tracks that slip", judged(drive, pipeline.joint(drive, **options))
    options["metre"] = scale.of_the_imu
    slam = pipeline.joint(drive, **options)
    yield "and the IMU's metre", judged(drive, slam)
    added = calibration.covariance(drive, slam.trajectory.world_T_imu, partial(pipeline.joint_path, **options))
    yield "and calibration considered", judged(drive, slam, added)


def judged(drive, slam, added=0.0) -> dict:
    """Accuracy of a `pipeline.Slam` and how honest it is: mean pose NEES, share inside 3 sigma of the worst axis.

    added : (T, 6, 6) that errors of the calibration add to its covariance, or 0.
    """
    path, truth = slam.trajectory.world_T_imu, drive.true_world_T_imu
    known = np.isfinite(truth[:, 0, 0])
    covariance = (slam.trajectory.covariance + added)[known]
    error_state = RightPerturbation()
    nees = metrics.pose_nees(error_state, truth[known], path[known], covariance)
    error = error_state.pose_difference(truth[known], path[known])
    inside = np.abs(error) <= 3 * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return {**accuracy(drive, path), "rejected_share": float(slam.rejected_share), "cpu_s": slam.seconds,
            "mean_nees": float(nees.pose.mean()), "inside_3_sigma": float(inside.mean(axis=0).min())}


SETTINGS = {
    "gate": (0.9, 0.95, 0.99, 0.999),
    "sigma_px": (0.5, 0.7, 1.0, 1.4, 2.0),
    "sigma_v": (0.25, 0.5, 1.0),
    "sigma_omega": (0.025, 0.05, 0.1),
    "min_disparity": (0.5, 1.0, 2.0, 4.0),
    "walk_v": (0.05, 0.1, 0.2),
    "walk_omega": (0.015, 0.03, 0.06),
}


def tuned(drive, noise, setting, value, **options) -> dict:
    """One run with one setting changed. setting : key of `SETTINGS`."""
    if setting in ("gate", "min_disparity"):
        options[setting] = value
    elif setting.startswith("walk"):
        options["motion_model"] = partial(options["motion_model"], **{setting: value})
    else:
        noise = replace(noise, **{setting: value})
    return filtered(drive, noise, **options)


def sensitivity(drive, noise, **options) -> dict:
    """Drift and ATE for each value of each setting, the others at their defaults: setting -> list of numbers."""
    return {
        setting: [{"value": value, **tuned(drive, noise, setting, value, **options)} for value in values]
        for setting, values in SETTINGS.items()
        if "motion_model" in options or not setting.startswith("walk")
    }


def rejected_by_age(drive, noise, ages=(1, 2, 4, 8, 16, 32)) -> list:
    """Share of the measurements that the gate keeps out, by the age of their track in frames.

    1 % at any age where pixel noise is white. What grows with age is slip: the tracker follows a point that creeps
    away from the one it began with, and the filter, which knows that landmark better with every view, notices.
    """
    kept_out, age = [], []
    for step in window_slam.run(drive, noise, RightInvariant(), motion_model=TwistAndBias):
        kept_out.append(~step.innovation.accepted)
        age.append(step.k - drive.first_seen[step.innovation.ids])
    kept_out, group = np.concatenate(kept_out), np.searchsorted(ages, np.concatenate(age), side="right") - 1
    return [{"age_from": age, "measurements": int(np.count_nonzero(group == i)),
             "rejected_share": float(kept_out[group == i].mean())}
            for i, age in enumerate(ages) if (group == i).any()]


def study(drive) -> dict:
    """All numbers of one recording; prints them as they come."""
    report = audit(drive)
    cured, noise = report.cured(), pipeline.noise_of_real_drive(report.noise)
    as_they_are, frame_to_frame = read_right(report), report.noise.sigma_px_flow
    ended = as_they_are.apply(cures.end_tracks_at_copies())
    print(f"{drive.name}: {', '.join(finding.fault for finding in report.findings)}")
    rows = []
    for name, numbers in treatments(report):
        rows.append({"name": name, **numbers})
        print(line(rows[-1]))
    return {
        "frames": drive.n_frames, "duration_s": drive.duration, "findings": [f.to_dict() for f in report.findings],
        "facts": report.facts,
        "noise": {"sigma_v": noise.sigma_v, "sigma_omega": noise.sigma_omega, "sigma_px": noise.sigma_px,
                  "sigma_px_frame_to_frame": frame_to_frame},
        "treatments": rows,
        "rejected_by_age": {"frame to frame": rejected_by_age(cured, replace(noise, sigma_px=frame_to_frame)),
                            "track life": rejected_by_age(cured, noise)},
        "sensitivity": {
            "IMU drives, tracks as they are": sensitivity(as_they_are, noise),
            "IMU drives, tracks ended at copies": sensitivity(ended, noise),
            "every cure, weights, twist and slip": sensitivity(
                cured, noise, motion_model=robust.RealDrive, process_frame=robust.process_frame),
        },
    }


def line(row) -> str:
    """A row of the table as text."""
    text = f"  {row['name']:38}{row['drift_percent']:6.2f} %{row['ate_m']:7.2f} m"
    if "rejected_share" in row:
        text += f"{100 * row['rejected_share']:7.1f} % rejected{row['cpu_s']:7.1f} s"
    if "mean_nees" in row:
        text += f"  NEES {row['mean_nees']:5.1f}, inside 3 sigma {100 * row['inside_3_sigma']:.0f} %"
    return text


def found() -> list:
    """(recording, ground truth) of those in `KNOWN` that are here."""
    pairs = [(recordings.find(name), recordings.find(truth)) for name, truth in KNOWN.items()]
    return [pair for pair in pairs if None not in pair]


def drives(arguments) -> list:
    """The drives, with truth, that the command line names; those found here when it names none."""
    paths = arguments.recordings
    if len(paths) % 2:
        raise SystemExit("give pairs: RECORDING GROUND_TRUTH")
    pairs = list(zip(paths[::2], paths[1::2])) or found()
    if not pairs:
        raise SystemExit(f"no recording with ground truth here (looked for {', '.join(KNOWN)}): give "
                         "RECORDING GROUND_TRUTH")
    return [recordings.load_ground_truth(truth, recordings.load(recording)) for recording, truth in pairs]


def add_arguments(parser):
    """What this benchmark and `batch_real.py` take."""
    parser.add_argument("recordings", nargs="*", metavar="RECORDING GROUND_TRUTH")
    parser.add_argument("--out", type=Path, default=RESULTS, metavar="FILE")


def store(path, changes):
    """Merge numbers, recording name -> dict, into the JSON file, which appears complete or not at all."""
    numbers = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name, values in changes.items():
        numbers[name] = numbers.get(name, {}) | values
    path.parent.mkdir(parents=True, exist_ok=True)
    with files.replacing(path) as file:
        file.write((json.dumps(numbers, indent=1, allow_nan=False) + "\n").encode())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_arguments(parser)
    arguments = parser.parse_args()
    for drive in drives(arguments):
        store(arguments.out, {drive.name: study(drive)})


if __name__ == "__main__":
    main()
