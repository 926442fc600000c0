"""Many simulated drives for chapters 7, 11 and 12: filters, batch estimate, and loops closed by three methods.

    python benchmarks/beyond_one_pass.py

Seeds 0 to 49 for the streets, 0 to 19 for the loops, all of them. Writes results/beyond_one_pass.json.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
from pathlib import Path
from unittest import mock

import numpy as np
from joblib import Parallel, delayed

from vislam_edu import association, batch, metrics, simulate, stereo, window_slam
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.studies import consistency

RESULTS = Path(__file__).parent / "results" / "beyond_one_pass.json"
STREETS, LOOPS = range(50), range(20)
METHODS = [association.nearest_neighbour, association.sequential, association.joint_compatibility]


def first_order(prior, ids, pixels, settings):
    """The correct frame, the pixels of the mean taken for the mean of the pixels."""
    with mock.patch.object(stereo, "second_order", lambda predicted, explained: np.zeros_like(predicted)):
        return window_slam.correlated(prior, ids, pixels, settings)


def street(seed) -> dict:
    """RMSE (m) and length error (mm driven too far per metre) of three filters and the batch on one street."""
    drive, noise = simulate.street_loop(seed), Noise()
    truth, solution = drive.true_world_T_imu, batch.solve(batch.Problem(drive, noise))
    filters = {"right perturbation": (RightPerturbation(), window_slam.correlated),
               "right-invariant": (RightInvariant(), window_slam.correlated),
               "right-invariant, first order": (RightInvariant(), first_order)}
    paths = {name: np.array([step.posterior.world_T_imu
                             for step in window_slam.run(drive, noise, error, process_frame=process_frame)])
             for name, (error, process_frame) in filters.items()} | {"batch": solution.estimate.world_T_imu}
    forward = np.diff(truth[:, :3, 3], axis=0)
    rows = {}
    for name, poses in paths.items():
        step = se3_steps(poses)
        too_far = np.sum(step - se3_steps(truth), axis=0)[0] / np.linalg.norm(forward, axis=1).sum()
        rows[name] = {"rmse_m": float(np.sqrt(np.mean(metrics.position_errors(truth, poses)**2))),
                      "too_far_mm_per_m": float(1e3 * too_far)}
    return rows


def se3_steps(poses):
    """(T-1, 3) m: each step in the frame it begins in; the first number is forward."""
    return np.vecmat(np.diff(poses[:, :3, 3], axis=0), poses[:-1, :3, :3])


def loop(seed) -> dict | None:
    """Wrong pairs of each method at the first closing, NEES there before and after, or None where nothing closes."""
    drive, error_state, noise = simulate.returning_loop(seed), RightInvariant(), Noise(1.0, 0.1, 0.7 * 2**0.5)
    place, wrong = simulate.places(drive), {}

    def choose(both, gate):
        pairs = association.joint_compatibility(both, gate)
        if len(pairs) >= 4 and not wrong:
            for method in METHODS:
                wrong[method.__name__] = int(sum(place[both.new[i]] != place[both.old[j]]
                                                 for i, j in method(both, gate)))
        return pairs

    closing, nees = association.LoopClosing(drive, error_state, choose=choose), []

    def associate(belief, k):
        after = closing(belief, k)
        if closing.fused and not nees:
            nees.extend(float(metrics.pose_nees(error_state, drive.true_world_T_imu[k], b.world_T_imu,
                                                b.pose_covariance).pose) for b in (belief, after))
        return after

    for _ in window_slam.run(drive, noise, error_state, retire=window_slam.retire_none, associate=associate):
        if nees:
            return {"wrong": wrong, "nees": nees}
    return None


def main():
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    found = {name: Parallel(2)(delayed(work)(seed) for seed in seeds)
             for name, work, seeds in (("street", street, STREETS), ("loop", loop, LOOPS))}
    invariant = consistency.FilterConfig(Noise(), RightInvariant(), {"process_frame": first_order})
    study = consistency.monte_carlo(simulate.street_loop, {"right_invariant": invariant}, STREETS)
    found["first order"] = consistency.summary(study)
    RESULTS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    for name in found["street"][0]:
        rmse, too_far = (np.mean([row[name][key] for row in found["street"]]) for key in ("rmse_m", "too_far_mm_per_m"))
        print(f"{name:30s} RMSE {rmse:.3f} m, {too_far:+.2f} mm too far per metre")
    print("first order", consistency.format_summary(found["first order"]))
    closed = [row for row in found["loop"] if row]
    for method in METHODS:
        print(f"{method.__name__:20s} wrong in {sum(r['wrong'][method.__name__] > 0 for r in closed)} of {len(closed)}")
    print("NEES before and after", np.mean([r["nees"] for r in closed], axis=0))


if __name__ == "__main__":
    main()
