"""The report's second, longer recording, its dataset 10 (figures 8 to 14 and 18 to 20).

The course's `10.npz` where a student has it; else a simulated drive of its size, made when it is asked for.
"""

from dataclasses import replace

from ... import odometry, recordings, simulate, window_slam
from ...error_state import RightPerturbation
from ...noise import Noise
from ...plots import report_figures
from ...studies import pipeline

FRAMES = 3026  # of 10.npz; the simulated drive then has 13159 landmarks, 10.npz has 13289


def load(frames=FRAMES):
    """The first frames of `10.npz`, or a simulated street of so many frames (25 MB and some seconds for all of it)."""
    path = recordings.find("10.npz")
    return recordings.load(path).slice(0, frames) if path else simulate.street_loop(frames=frames, name="a long street")


def paths(drive, noise, error_state):
    """Dead reckoning, a Trajectory, and the joint filter with every landmark, a `pipeline.Slam`."""
    return odometry.dead_reckon(drive, noise), pipeline.joint(drive, noise, error_state, method=error_state.role)


def suboptimal(drive):
    """The report's filter with a W a hundredth of its own, as in chapter 06: a `pipeline.Slam`, for figures 18 to 20.

    The report does not print the values behind these figures; its advice is a very small W.
    """
    noise, error_state = Noise.from_report(), RightPerturbation()
    noise = replace(noise, sigma_v=noise.sigma_v / 10, sigma_omega=noise.sigma_omega / 10)
    steps = window_slam.run(drive, noise, error_state, process_frame=window_slam.as_report, gate=1)
    return pipeline.collect_slam(drive, steps, error_state)


def figures(drive, noise, error_state):
    """The report's ten figures of this drive: yields each with its number. noise, error_state : of figures 8 to 14."""
    result = pipeline.run_pipeline(drive, noise, error_state)
    for number, draw in enumerate(report_figures.FIGURES.values(), start=8):
        yield number, draw(result)
    worse = replace(result, slam=suboptimal(drive))
    for number, draw in enumerate(list(report_figures.FIGURES.values())[4:], start=18):
        yield number, draw(worse)
