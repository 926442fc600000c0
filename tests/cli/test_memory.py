"""Every landmark, in memory that does not know how many there are: the smaller brother of benchmarks/window.py."""

from collections import deque

import numpy as np
import pytest
from memory import peak

from vislam_edu import simulate, smoother, window_slam
from vislam_edu.noise import Noise
from vislam_edu.studies import runs

NOISE = Noise()


@pytest.fixture(scope="module")
def drive():
    """400 frames with short tracks, so that the map is large and the window small."""
    return simulate.street_loop(seed=6, frames=400, visible=12, mean_life=10, life=(3, 30), redetect_every=2)


def forward(drive):
    deque(window_slam.run(drive, NOISE), maxlen=1)


def covariance_of_all(drive):
    """Bytes of the dense filter's covariance."""
    return 8 * (3 * drive.n_landmarks + 6) ** 2


def test_forward_memory_is_that_of_the_window_however_long_the_drive(drive):
    window = 8 * (3 * drive.visible.max() + 6) ** 2
    quarter, whole = peak(lambda: forward(drive.slice(0, 100))), peak(lambda: forward(drive))
    per_frame = 8 * 300  # bytes: the motion model works out all increments (4, 4) and Jacobians (6, 6) at once
    assert whole < 20 * window + per_frame * drive.n_frames
    assert whole - quarter < per_frame * (drive.n_frames - 100)


def test_a_record_keeps_a_few_numbers_of_a_frame_and_no_covariance_of_its_window(drive):
    per_frame = 8 * (300 + 10 * drive.visible.max())  # bytes: six numbers of a measurement, twice while they are joined
    quarter, whole = (peak(lambda part=part: runs.record(window_slam.run(part, NOISE)))
                      for part in (drive.slice(0, 100), drive))
    assert whole - quarter < per_frame * (drive.n_frames - 100)


def backward_peak(drive):
    return peak(lambda: smoother.final_map(drive, NOISE))


@pytest.fixture(scope="module")
def backward_peak_of_all(drive):
    return backward_peak(drive)


def test_backward_memory_is_far_below_one_covariance_of_all(drive, backward_peak_of_all):
    assert drive.n_landmarks > 500
    assert backward_peak_of_all < covariance_of_all(drive) / 4


def test_backward_memory_grows_like_the_root_of_the_drive(drive, backward_peak_of_all):
    steps = np.sqrt(4)  # checkpoints and one piece between two of them
    assert backward_peak_of_all < 1.5 * steps * backward_peak(drive.slice(0, 100))
