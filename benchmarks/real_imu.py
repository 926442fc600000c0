"""What chapter 16 quotes: the filter with a real IMU over seeds, starts in motion, first estimates, fixed lag, EuRoC.

    python benchmarks/real_imu.py                       # all parts, EuRoC where its file is there
    python benchmarks/real_imu.py fixed_lag start       # some of them

Writes benchmarks/results/real_imu.json. EuRoC is V1_01_easy (see `--euroc`): its IMU and truth are real, its tracks are
simulated along the true path, with several seeds. The noise of the IMU is taken from the first half of the flight, what
the filter is worth is judged on the second, which begins in motion.
"""

import argparse
import json
from functools import partial
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from scipy.spatial.transform import Rotation

from vislam_edu import Noise, imu, inertial, metrics, se3, simulate, window_slam
from vislam_edu.course.ch16 import fixed_lag
from vislam_edu.course.ch16.msckf import FirstEstimates
from vislam_edu.error_state import InverseDepth, RightInvariant, RightPerturbation
from vislam_edu.stereo import StereoCamera

RESULTS = Path(__file__).parent / "results" / "real_imu.json"
EUROC = Path(__file__).resolve().parents[2] / "shared" / "data" / "euroc_v101" / "imu_and_truth.npz"
MAKERS = {"right perturbation": RightPerturbation, "first-estimates": FirstEstimates, "right-invariant": RightInvariant}
HALF = 1448  # frames at 20 Hz, of 2895


def judged(drive, velocity, bias, error_state, begin=None) -> list[list[float]]:
    """Of each frame: NEES of 15 states, of the pose, and the distance from the true position, m."""
    model, found = partial(inertial.AccelerometerDriven, begin=begin), []
    for step in window_slam.run(drive, Noise(), error_state, motion_model=model):
        belief = step.posterior
        if step.k == 0:
            true = inertial.true_states(belief.world_T_imu, drive.true_world_T_imu, velocity, bias)
        e, P = inertial.error(belief, true[step.k], error_state), belief.covariance[-15:, -15:]
        found.append([float(metrics.nees(e, P)), float(metrics.nees(e[:6], P[:6, :6])),
                      float(np.linalg.norm(true[step.k].position - belief.world_T_imu[:3, 3]))])
    return found


def one_filter(seed, make):
    """NEES of 15 states and of the pose: means over a drive of 300 frames, and at its last frame."""
    found = np.array(judged(*simulate.inertial_loop(seed, frames=300), make()))[:, :2]
    return [*found.mean(axis=0).tolist(), *found[-1].tolist()]


def one_start(seed):
    """Started in motion: mean NEES of the pose and the last position error, m, with the start found, and at rest."""
    drive, velocity, bias = simulate.inertial_loop(seed, frames=100, warp=lambda t: t + 3.0)
    samples = drive.imu.between(drive.times[0], drive.times[0] + 0.3)
    state, P = imu.stand_still(*samples, drive.imu.noise)
    at_rest = state, P + np.diag(np.repeat([1e-8, 1e-8, 1e-6, 0, 0], 3))
    found = {}
    for name, begin in (("found", None), ("taken for a stand-still", at_rest)):
        try:
            rows = judged(drive, velocity, bias, InverseDepth(), begin)
            found[name] = [float(np.mean([row[1] for row in rows])), rows[-1][2]]
        except np.linalg.LinAlgError:
            found[name] = [np.inf, np.inf]
    return found


def one_street(seed, min_disparity):
    """Mean NEES of the pose of the three filters over the second half of a street loop of 200 frames."""
    drive, means = simulate.street_loop(seed, frames=200), {}
    for name, make in MAKERS.items():
        error_state, values = make(), []
        for step in window_slam.run(drive, Noise(), error_state, min_disparity=min_disparity):
            if step.k >= 100:
                e = error_state.pose_difference(drive.true_world_T_imu[step.k], step.posterior.world_T_imu)
                values.append(metrics.nees(e, step.posterior.pose_covariance))
        means[name] = float(np.mean(values))
    return means


def one_fixed_lag(seed, freeze):
    """Mean NEES of the newest frame, 15 states and the pose, from frame 8 of 30 on; five frames in the window."""
    drive, velocity, bias = simulate.inertial_loop(seed, frames=30, tau=0.3, visible=20, depth=(5.0, 40.0))
    begin, found = inertial.initial(drive, Noise()), []
    true = inertial.true_states(se3.pose(begin[0].rotation, begin[0].position), drive.true_world_T_imu, velocity, bias)
    for k, (last, P) in enumerate(fixed_lag.run(drive, Noise(), begin, freeze=freeze), 1):
        e = fixed_lag.error(last, true[k])
        found.append([metrics.nees(e, P), metrics.nees(e[:6], P[:6, :6])])
    return np.mean(found[7:], axis=0).tolist()


# --- EuRoC ------------------------------------------------------------------------------------------------------


def euroc(path, frames, seed=0, noise=imu.ADIS16448):
    """A part of V1_01 (frames : slice, of the truth at 20 Hz) with its IMU and simulated tracks: drive, velocity, bias.

    Tracks live for three seconds on average. EuRoC's samples are values at an instant; a sample here lasts until the
    next one, so means of neighbours.
    """
    recording = np.load(path)
    start = recording["truth_time_ns"][0]
    times, step = (recording["truth_time_ns"][frames] - start) / 1e9, frames.step or 1
    R = Rotation.from_quat(recording["world_q_imu_wxyz"][frames], scalar_first=True).as_matrix()
    cam_R_imu = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # EuRoC's camera, to a degree
    camera = StereoCamera(np.array([[458.0, 0, 367], [0, 458, 248], [0, 0, 1]]), 0.11,
                          se3.pose(cam_R_imu, [0.065, -0.021, -0.008]))
    drive = simulate.along(se3.pose(R, recording["world_p_imu"][frames]), times, seed, camera=camera,
                           image_size=(752, 480), depth=(1.0, 8.0), nearest=0.5, life=(5, 200 // step),
                           mean_life=60.0 / step)
    values = np.hstack([recording["gyro"], recording["accelerometer"]])
    values = (values[:-1] + values[1:]) / 2
    samples = inertial.ImuSamples((recording["imu_time_ns"][:-1] - start) / 1e9, values[:, :3], values[:, 3:], noise)
    biases = np.hstack([recording["gyro_bias"], recording["accelerometer_bias"]])[frames]
    return (simulate.add_noise(drive, seed, sigma_v=0, sigma_omega=0).replace(imu=samples),
            recording["world_v_imu"][frames], biases)


def integrated(drive, velocity, bias, n, known=True):
    """(m, 15): errors after n frames from the true state, every second, with the true biases or with none."""
    states = inertial.true_states(drive.true_world_T_imu[0], drive.true_world_T_imu, velocity, bias)
    errors = []
    for k in range(0, len(states) - n, 20):
        samples = drive.imu.between(drive.times[k], drive.times[k + n])
        motion = imu.preintegrate(*samples, *np.split(bias[k] * known, 2))
        errors.append(states[k + n].difference(imu.predict(states[k], motion)))
    return np.array(errors)


def noise_of(drive, velocity, bias, seconds):
    """What the residuals of so many seconds against the truth say about the noise, and how the true biases walked."""
    errors = integrated(drive, velocity, bias, round(20 * seconds))
    walk = np.diff(bias[::200], axis=0) / np.sqrt(10.0)
    densities = [np.sqrt(np.mean(errors[:, rows]**2) / seconds) for rows in (imu.ROTATION, imu.VELOCITY)]
    return imu.ImuNoise(*(float(x) for x in (*densities, *(np.sqrt(np.mean(w**2)) for w in np.split(walk, 2, axis=1)))))


def one_flight(path, seed, noise):
    """The second half of the flight, cameras at 10 Hz: mean NEES of the pose, last position's error in % of the way."""
    drive, velocity, bias = euroc(path, slice(HALF, None, 2), seed, noise)
    rows = judged(drive, velocity, bias, InverseDepth())
    way = np.linalg.norm(np.diff(drive.true_world_T_imu[:, :3, 3], axis=0), axis=1).sum()
    return [float(np.mean([row[1] for row in rows])), 100 * rows[-1][2] / float(way)]


def flight(path, run, seeds=range(4)):
    """All figures of EuRoC."""
    whole = euroc(path, slice(None))
    found = {"integrated": {}, "noise": {}, "runs": {}}
    for seconds in (1, 5):
        for known in (True, False):
            e = integrated(*whole, 20 * seconds, known)
            norms = (np.median(np.linalg.norm(e[:, rows], axis=1)) for rows in (imu.POSITION, imu.ROTATION))
            found["integrated"][f"{seconds} s, {'known' if known else 'zero'}"] = list(map(float, norms))
    first = euroc(path, slice(None, HALF))
    noises = {"datasheet": imu.ADIS16448}
    noises |= {f"residuals of {seconds} s": noise_of(*first, seconds) for seconds in (1, 2)}
    for name, noise in noises.items():
        found["noise"][name] = list(vars(noise).values())
        found["runs"][name] = run(delayed(one_flight)(path, seed, noise) for seed in seeds)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", help="filter, start, street, fixed_lag, euroc (default: all)")
    parser.add_argument("--euroc", type=Path, default=EUROC, metavar="FILE", help="imu_and_truth.npz of V1_01_easy")
    arguments = parser.parse_args()
    run = Parallel(2)
    parts = {
        "filter": lambda: {name: run(delayed(one_filter)(seed, make) for seed in range(30)) for name, make in
                           (("inverse depth", InverseDepth), ("right perturbation", RightPerturbation))},
        "start": lambda: run(delayed(one_start)(seed) for seed in range(12)),
        "street": lambda: {least: run(delayed(one_street)(seed, float(least)) for seed in range(12))
                           for least in ("25", "1")},
        "fixed_lag": lambda: {name: run(delayed(one_fixed_lag)(seed, freeze) for seed in range(20))
                              for name, freeze in (("frozen", True), ("relinearised", False))},
        "euroc": lambda: flight(arguments.euroc, run)}
    if not arguments.euroc.exists():
        del parts["euroc"]
        print(f"{arguments.euroc} is not there: the figures of EuRoC stay as they were")
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    for name in arguments.parts or parts:
        stored[name] = parts[name]()
        RESULTS.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
        print(name, "stored")


if __name__ == "__main__":
    main()
