"""What the landmark window costs, against the filter that drops nothing: python benchmarks/window.py

Prints tables and writes results/window.json beside this file, which notebook 09 reads. A few minutes.

All times are CPU seconds of one thread (time.process_time): wall time would also count whatever else the machine is
doing. Even CPU time grows on a busy machine, whose programs share caches and memory, so a time is the least of a few
runs (the dense filter's, which is run once, the median over frames).
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy, see vislam_edu/__init__.py

import json
import platform
import re
import resource
import sys
import time
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import scipy
import threadpoolctl
from scipy.linalg import blas, lapack

from vislam_edu import recordings, simulate, smoother, window_slam
from vislam_edu.noise import Noise

RESULTS = Path(__file__).parent / "results" / "window.json"
NOISE = Noise()
CARRIED = (100, 200, 400, 800, 1600)  # landmarks in the dense filter's state
VISIBLE = (15, 30, 60, 120, 240)
LENGTHS = (500, 1000, 2000, 3000)  # frames


# --- timing -------------------------------------------------------------------------------------------------


def frame_times(drive, **options):
    """CPU seconds of each frame (T,), landmarks in the state after it (T,), and the Steps' sizes, of one run.

    Sizes: (T, 2), numbers that the update used (three a landmark, 0 without update) and rows of the covariance.
    """
    seconds, carried, sizes = [], [], []
    before = time.process_time()
    for step in window_slam.run(drive, NOISE, **options):
        now = time.process_time()
        seconds.append(now - before)
        carried.append(len(step.posterior.ids))
        used = 3 * len(step.innovation.ids) if step.innovation.accepted.any() else 0
        sizes.append((used, len(step.prior.covariance)))
        before = time.process_time()
    return np.array(seconds), np.array(carried), np.array(sizes)


def least_frame_times(drive, repeats, **options):
    """`frame_times`, each frame's time the least of some runs."""
    runs = [frame_times(drive, **options) for _ in range(repeats)]
    return np.min([seconds for seconds, *_ in runs], axis=0), *runs[0][1:]


def least(function, repeats):
    """Least CPU seconds of one call."""
    times = []
    for _ in range(repeats):
        before = time.process_time()
        function()
        times.append(time.process_time() - before)
    return min(times)


# --- the floor ----------------------------------------------------------------------------------------------


def update_flops(sizes):
    """Floating-point operations that a joint update cannot do without, as it is done here, summed over frames.

    m numbers measured, state of d: Cholesky of S m^3 / 3, L^-1 H P m^2 d, and one triangle of Y^T Y m d^2.
    """
    m, d = np.asarray(sizes, dtype=float).T
    return float(np.sum(m**3 / 3 + m**2 * d + m * d**2))


def bare_update(sizes):
    """CPU seconds of these three operations alone, at the sizes of a drive's frames, on matrices made beforehand."""
    seconds = 0.0
    for m, d in sizes:
        if m == 0:
            continue
        S, HP = np.eye(m, order="F"), np.zeros((d, m), order="F")
        before = time.process_time()
        L, _ = lapack.dpotrf(S, lower=1, overwrite_a=1)
        Y = blas.dtrsm(1.0, L, HP, side=1, lower=1, trans_a=1, overwrite_b=1)
        blas.dsyrk(1.0, Y)
        seconds += time.process_time() - before
    return seconds


def rates(n=200):
    """GFlop/s of single calls on n x n matrices."""
    rng = np.random.default_rng(0)
    A = np.asfortranarray(rng.normal(size=(n, n)))
    S = np.asfortranarray(A @ A.T + n * np.eye(n))
    L = lapack.dpotrf(S, lower=1)[0]
    calls = {
        "dgemm": (lambda: blas.dgemm(1.0, A, A), 2 * n**3),
        "dsyrk": (lambda: blas.dsyrk(1.0, A), n**3),
        "dtrsm": (lambda: blas.dtrsm(1.0, L, A, lower=1), n**3),
        "dpotrf": (lambda: lapack.dpotrf(S, lower=1), n**3 / 3),
    }
    return {name: flops / least(call, 200) / 1e9 for name, (call, flops) in calls.items()}


# --- the measurements ---------------------------------------------------------------------------------------


def machine():
    """Processor and libraries; no names of hosts or people."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    pools = [pool for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
    libraries = {f"{pool['internal_api']} {pool['version']} ({pool['architecture']})" for pool in pools}
    return {
        "processor": models[0] if models else platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "threads used": 1,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "blas": sorted(libraries),
        "GFlop/s, 200 x 200": rates(),
        "load when measured (1 min)": os.getloadavg()[0],
    }


def dense_against_window():
    """One drive, filtered twice up to the frame where some 1700 landmarks have been seen: with the window and without.

    Of both runs the same frames are compared, those in which the dense filter carries M landmarks, give or take 15 %.
    They see the same landmarks; all that differs is what lies behind the car. Tracks are short, 10 frames on average,
    so that the landmarks come together in few frames.
    """
    drive = simulate.street_loop(frames=300, visible=60, mean_life=10, life=(3, 100), redetect_every=2)
    born = np.cumsum(np.bincount(drive.first_seen, minlength=drive.n_frames))
    drive = drive.slice(0, int(np.searchsorted(born, 1.1 * CARRIED[-1])))
    window, *_ = least_frame_times(drive, 4)
    dense, carried, _ = frame_times(drive, retire=window_slam.retire_none)
    rows = []
    for M in CARRIED:
        frames = np.abs(carried - M) <= 0.15 * M
        rows.append(
            {
                "landmarks carried": float(carried[frames].mean()),
                "visible": float(drive.visible[frames].mean()),
                "frames timed": int(frames.sum()),
                "covariance MB": 8e-6 * (3 * M + 6) ** 2,
                "dense ms": 1e3 * np.median(dense[frames]),
                "window ms": 1e3 * np.median(window[frames]),
                "ratio": np.median(dense[frames]) / np.median(window[frames]),
            }
        )
    return rows


def against_visible():
    """Time per frame, window, on drives of 150 frames that differ in how many landmarks are in view."""
    rows = []
    for visible in VISIBLE:
        drive = simulate.street_loop(frames=150, visible=visible)
        seconds, _, sizes = least_frame_times(drive, 4)
        floor = min(bare_update(sizes) for _ in range(4))
        rows.append(
            {
                "visible": float(drive.visible.mean()),
                "window ms": 1e3 * seconds.mean(),
                "bare BLAS and LAPACK ms": 1e3 * floor / drive.n_frames,
                "MFlop": 1e-6 * update_flops(sizes) / drive.n_frames,
            }
        )
    return rows


def against_length():
    """Time per frame, window, over the first T frames of one drive with 30 landmarks in view."""
    drive = simulate.street_loop(frames=LENGTHS[-1], visible=30)
    seconds, *_ = least_frame_times(drive, 3)
    return [
        {
            "frames": T,
            "visible": float(drive.visible[:T].mean()),
            "landmarks": int((drive.first_seen < T).sum()),
            "seconds": seconds[:T].sum(),
            "ms per frame": 1e3 * seconds[:T].mean(),
        }
        for T in LENGTHS
    ]


def real_time(names=("03.npz", "0027.npz", "street_loop.npz", "first_steps.npz")):
    """Whole recordings, every landmark: how many seconds of driving are filtered in one. Missing ones are left out."""
    rows = []
    for name in names:
        path = recordings.find(name)
        if path is None:
            continue
        drive = recordings.load(path)
        *_, sizes = frame_times(drive)
        seconds = least(lambda drive=drive: deque(window_slam.run(drive, NOISE), maxlen=0), 4)
        floor = min(bare_update(sizes) for _ in range(4))
        rows.append(
            {
                "drive": name,
                "frames": drive.n_frames,
                "landmarks": drive.n_landmarks,
                "driving s": drive.duration,
                "filter s": seconds,
                "times real time": drive.duration / seconds,
                "GFlop": 1e-9 * update_flops(sizes),
                "bare BLAS and LAPACK s": floor,
                "share of BLAS and LAPACK": floor / seconds,
            }
        )
    return rows


def dataset_10_size():
    """A simulated drive of the size of the course's dataset 10, forward and then backward for every landmark.

    To be called in a process of its own: peak memory is that of all it has ever done.
    """
    drive = simulate.street_loop(frames=3026)
    forward = least(lambda: deque(window_slam.run(drive, NOISE), maxlen=0), 1)
    both = least(lambda: smoother.final_map(drive, NOISE), 1)
    return {"frames": drive.n_frames, "landmarks": drive.n_landmarks, "driving s": drive.duration, "forward s": forward,
            "forward and backward s": both, "times real time": drive.duration / both,
            "peak memory GB": peak_memory() / 1e9}


def peak_memory():
    """Bytes that this process has held at most. (On Linux `ru_maxrss` would begin with the peak of its parent.)"""
    if sys.platform == "linux":
        status = Path("/proc/self/status").read_text()
        return 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def alone(function):
    """Call the function in a fresh process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function).result()


# --- output -------------------------------------------------------------------------------------------------


def rounded(value):
    """Four significant digits, the same through lists and dictionaries: more would be noise."""
    if isinstance(value, dict):
        return {key: rounded(v) for key, v in value.items()}
    if isinstance(value, list):
        return [rounded(v) for v in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def show(title, rows):
    """A table of dictionaries that share their keys."""
    print(f"\n{title}")
    cells = [list(rows[0])] + [[f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells)]
    for line in cells:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths)))


MEASUREMENTS = {
    "dense against window": dense_against_window,
    "against visible": against_visible,
    "real time": real_time,
    "against length": against_length,
    "dataset 10 size": lambda: [alone(dataset_10_size)],
}


def main():
    """Measure, print, store."""
    results = {"times": "CPU seconds of one thread, the least of several runs", "machine": rounded(machine())}
    print(json.dumps(results["machine"], indent=1))
    for name, measure in MEASUREMENTS.items():
        results[name] = rounded(measure())
        show(name, results[name])
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
