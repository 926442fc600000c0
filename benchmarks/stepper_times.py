"""Time the kernel needs for one picture of each chapter, ms: python benchmarks/stepper_times.py

CPU time is what the picture costs; wall time also counts whatever else the machine is doing. The first
picture, which draws all that stands still, is not counted: it is not waited for when stepping.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: the matrices are too small to share among threads

import time

import numpy as np
from vislam_edu.widgets.joint import JointPicture
from vislam_edu.widgets.localisation import LocalisationPicture
from vislam_edu.widgets.mapping import MappingPicture

from vislam_edu import mapping, odometry, simulate, window_slam
from vislam_edu.noise import Noise
from vislam_edu.widgets import Panel, Stepper
from vislam_edu.widgets.stereo_depth import StereoDepthPicture
from vislam_edu.widgets.twist import TwistPicture

LIMIT = 50.0  # ms


def settings():
    """Name of each picture, its widget, and functions that move one of the widget's controls."""
    drive, noise = simulate.first_steps(), Noise()
    truth = drive.true_world_T_imu
    yield "01 twist", *dragged(Panel(TwistPicture()), "omega_z")
    yield "02 stereo depth", *dragged(Panel(StereoDepthPicture()), "depth")
    yield "03 mapping", *stepped(MappingPicture(mapping.run(drive, noise, truth), drive, truth))
    localised = odometry.localize(drive, noise, drive.true_landmarks)
    yield "04 localisation", *stepped(LocalisationPicture(localised, drive, noise, drive.true_landmarks))
    yield "05 joint", *stepped(JointPicture(window_slam.run(drive, noise), drive, noise))


def dragged(panel, name):
    """The panel and its moves: one slider pulled from end to end."""
    control = panel.controls[name]
    values = np.arange(control.min, control.max, control.step)[1:]
    return panel, [lambda value=value: setattr(control, "value", value) for value in values]


def stepped(picture):
    """The stepper of a picture and its moves: every half-step once."""
    stepper = Stepper(picture)
    return stepper, [lambda i=i: setattr(stepper.slider, "value", i) for i in range(1, picture.n)]


def main():
    """Print a line for each picture; returns the exit status, 1 when a median is over the limit."""
    print(f"{'picture':18}{'moves':>6}{'CPU median':>12}{'CPU 90 %':>10}{'wall median':>13}   ms")
    slow = 0
    for name, _, moves in settings():
        times = []
        for move in moves:
            cpu, wall = time.process_time(), time.perf_counter()
            move()
            times.append((time.process_time() - cpu, time.perf_counter() - wall))
        (cpu, wall), (late, _) = 1e3 * np.median(times, axis=0), 1e3 * np.quantile(times, 0.9, axis=0)
        slow += cpu > LIMIT
        print(f"{name:18}{len(moves):6d}{cpu:12.1f}{late:10.1f}{wall:13.1f}")
    return int(slow > 0)


if __name__ == "__main__":
    raise SystemExit(main())
