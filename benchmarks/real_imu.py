"""The filter with a real IMU over seeds, and first-estimates Jacobians beside the other two: what chapter 16 quotes.

    python benchmarks/real_imu.py

Writes benchmarks/results/real_imu.json.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from vislam_edu import inertial, simulate, window_slam
from vislam_edu.course.ch16.msckf import FirstEstimates
from vislam_edu.error_state import InverseDepth, RightInvariant, RightPerturbation
from vislam_edu.noise import Noise

RESULTS = Path(__file__).parent / "results" / "real_imu.json"
FILTER_SEEDS, STREET_SEEDS = range(30), range(12)
MAKERS = {"right perturbation": RightPerturbation, "first-estimates": FirstEstimates, "right-invariant": RightInvariant}


def nees(error, covariance):
    """Normalised estimation error squared."""
    return float(error @ np.linalg.solve(covariance, error))


def real_imu(seed, make):
    """NEES of 15 states and of the pose: means over a drive of 300 frames, and at its last frame."""
    drive, velocity, bias = simulate.inertial_loop(seed, frames=300)
    poses, error_state, found = drive.truth_world_T_cam @ drive.camera.cam_T_imu, make(), []
    for step in window_slam.run(drive, Noise(), error_state, motion_model=inertial.AccelerometerDriven):
        belief = step.posterior
        if step.k == 0:
            true = inertial.true_states(belief.world_T_imu, poses, velocity, bias)
        e, P = inertial.error(belief, true[step.k], error_state), belief.covariance[-15:, -15:]
        found.append([nees(e, P), nees(e[:6], P[:6, :6])])
    return [*np.mean(found, axis=0), *found[-1]]


def street(seed, min_disparity):
    """Mean NEES of the pose of the three filters over the second half of a street loop of 200 frames."""
    drive, means = simulate.street_loop(seed, frames=200), {}
    for name, make in MAKERS.items():
        error_state, values = make(), []
        for step in window_slam.run(drive, Noise(), error_state, min_disparity=min_disparity):
            if step.k >= 100:
                e = error_state.pose_difference(drive.true_world_T_imu[step.k], step.posterior.world_T_imu)
                values.append(nees(e, step.posterior.pose_covariance))
        means[name] = float(np.mean(values))
    return means


def main():
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    run = Parallel(2)
    found = {"filter": {name: run(delayed(real_imu)(seed, make) for seed in FILTER_SEEDS) for name, make in
                        (("inverse depth", InverseDepth), ("right perturbation", RightPerturbation))},
             "street": {least: run(delayed(street)(seed, float(least)) for seed in STREET_SEEDS)
                        for least in ("25", "1")}}
    RESULTS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print({name: np.mean(rows, axis=0).round(2).tolist() for name, rows in found["filter"].items()})
    for least, rows in found["street"].items():
        print(least, {name: np.median([row[name] for row in rows]).round(1) for name in MAKERS})


if __name__ == "__main__":
    main()
