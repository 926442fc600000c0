"""The batch estimate on real recordings with ground truth: what prior on the twist, bias and loss are worth.

    python benchmarks/batch_real.py [RECORDING GROUND_TRUTH ...] [--out FILE]

Every cure, one setting for all, no ground truth used. Seconds are of the CPU. Chapter 11 reads the figures.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: CPU seconds are compared, of one core

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import real_drives

from vislam_edu import batch, metrics, robust
from vislam_edu.audit import audit
from vislam_edu.error_state import RightPerturbation
from vislam_edu.studies import pipeline

EVERY = 25  # frames between poses whose NEES is taken: covariances are solved for


def solved(problem) -> dict:
    """Accuracy, honesty and cost of one solution."""
    drive, begin = problem.drive, time.process_time()
    solution = batch.solve(problem, still=pipeline.STILL)
    seconds = time.process_time() - begin
    poses, frames = solution.estimate.world_T_imu, np.arange(EVERY, drive.n_frames, EVERY)
    truth = drive.true_world_T_imu[frames]
    known = np.isfinite(truth[:, 0, 0])
    nees = metrics.pose_nees(RightPerturbation(), truth[known], poses[frames[known]],
                             solution.pose_covariance(frames[known]))
    return {**real_drives.accuracy(drive, poses), "iterations": solution.iterations, "cpu_s": seconds,
            "mean_nees": float(nees.pose.mean())}


def treatments(drive) -> dict:
    """Numbers of the filter and of each way to pose the problem."""
    report = audit(drive)
    cured, noise = report.cured(), pipeline.noise_of_real_drive(report.noise)
    usual = pipeline.batch_of_real_drive(cured, noise)
    return {
        "filter": real_drives.filtered(cured, noise, motion_model=robust.RealDrive, process_frame=robust.process_frame),
        "batch": solved(usual),
        "batch, scale estimated": solved(pipeline.batch_of_real_drive(cured, noise, scale_sigma=0.05)),
        "batch, no walk of the twist": solved(replace(usual, walk_sigma=None)),
        "batch, no bias": solved(replace(usual, imu_sigma=np.zeros(4))),
        "batch, squares in place of the robust loss": solved(replace(usual, loss=batch.quadratic)),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    real_drives.add_arguments(parser)
    parser.set_defaults(out=Path(__file__).parent / "results" / "batch_real.json")
    arguments = parser.parse_args()
    for drive in real_drives.drives(arguments):
        rows = treatments(drive)
        for name, row in rows.items():
            print(f"{drive.name:12s} {name:45s} " + "  ".join(f"{key} {value:.3g}" for key, value in row.items()))
        real_drives.store(arguments.out, {drive.name: rows})


if __name__ == "__main__":
    main()
