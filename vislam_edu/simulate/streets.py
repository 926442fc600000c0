"""The road a simulated car follows: a closed chain of streets and corners, with hills, bends and a rough surface.

`drive_along` gives the exact poses of a car on it; what its sensors measure is `simulate`'s business.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from .. import se3

CORNER_LENGTH = 30.0  # m of road in which a corner turns by 90 degrees
FIRST_CORNER = 25.0  # m from the start


def _waves(rng, lap, wavelengths, rms, n=6):
    """Two functions of arc length: n sines of zero mean, random, that repeat after a lap, and their slope."""
    frequency = 2 * np.pi * np.maximum(1, np.round(lap / rng.uniform(*wavelengths, n))) / lap  # rad/m
    amplitude, phase = np.full(n, rms * np.sqrt(2 / n)), rng.uniform(0, 2 * np.pi, n)
    return (lambda s: np.sin(np.multiply.outer(s, frequency) + phase) @ amplitude,
            lambda s: np.cos(np.multiply.outer(s, frequency) + phase) @ (amplitude * frequency))


def _smooth_step(u):
    return u - np.sin(2 * np.pi * u) / (2 * np.pi)


def _corners(loop_length):
    """Arc length where each corner begins, m, and its sign (+1 left, -1 right).

    About every 150 m there is a corner, so a longer loop has more stairs; one stair is a rectangle.
    """
    stairs = max(1, round(loop_length / 400))
    signs = np.array([1] + [1, -1] * (stairs - 1) + [1, 1, 1])
    u = np.linspace(0, 1, 1001)
    # m that a corner cuts off the legs on either side
    tangent = CORNER_LENGTH * np.trapezoid(np.cos(np.pi / 2 * _smooth_step(u)), u)
    legs = np.array([5 * stairs] + [4, 5] * stairs + [4 * stairs], float)
    legs *= (loop_length + len(legs) * (2 * tangent - CORNER_LENGTH)) / legs.sum()
    straights = legs - 2 * tangent
    if straights.min() < 0 or straights[0] < FIRST_CORNER:
        raise ValueError(f"a street loop of {loop_length:.0f} m has no room for its {len(legs)} corners; "
                         "give a larger loop_length")
    begin = np.cumsum(straights + CORNER_LENGTH) - CORNER_LENGTH
    return begin - begin[0] + FIRST_CORNER, signs


def centre_line(loop_length):
    """Once around straight streets and 90 degree corners, a staircase and back, at steps of 5 cm.

    A corner's curvature rises and falls as 1 - cos: the steering wheel never jumps. Returns arc length (n,) m, heading
    rad, curvature rad/m, and place x, y m. Raises ValueError when the loop is too short for its corners.
    """
    from scipy.integrate import cumulative_trapezoid

    s, (begin, signs) = np.append(np.arange(0, loop_length, 0.05), loop_length), _corners(loop_length)
    u = np.clip(np.subtract.outer(s, begin) / CORNER_LENGTH, 0, 1)
    heading = np.pi / 2 * _smooth_step(u) @ signs
    curvature = np.pi / (2 * CORNER_LENGTH) * (1 - np.cos(2 * np.pi * u)) @ signs
    return s, heading, curvature, *(cumulative_trapezoid(f(heading), s, initial=0) for f in (np.cos, np.sin))


def drive_along(rng, times, speed, loop_length, hills, lane_change=0.0):
    """The poses world_T_imu (T, 4, 4) of a car that follows the streets; x east, y north, z up.

    rng : numpy Generator. times : (T,) s. speed : mean speed, m/s. loop_length : m once around. hills : RMS height, m.
    lane_change : m to the left from the second lap on; it takes one corner's length of road.

    It slows down by half in corners, weaves within its lane, leans in corners and shakes a little on a rough
    road, so that all six degrees of freedom move. It starts along x. Raises ValueError when the loop is too short for
    its corners.
    """
    from scipy.integrate import cumulative_trapezoid  # here: who plants faults need not wait for scipy.integrate

    s, heading, curvature, x, y = centre_line(loop_length)
    pace = 1 - 0.5 * np.abs(curvature) * CORNER_LENGTH / np.pi
    pace *= 1 + _waves(rng, loop_length, (60, 200), 0.08)[0](s)
    lap_time = cumulative_trapezoid(1 / pace, s, initial=0)
    lap_time *= loop_length / speed / lap_time[-1]

    laps, since = np.divmod(times - times[0], lap_time[-1])
    at = np.interp(since, lap_time, s)
    heading, curvature, x, y = (np.interp(at, s, values) for values in (heading, curvature, x, y))

    lane, lane_slope = _waves(rng, loop_length, (40, 120), 0.3)
    hill, hill_slope = _waves(rng, loop_length, (100, 300), hills)
    heave, pitch, roll = (_waves(rng, loop_length, (8, 25), rms)[0] for rms in (0.01, 0.004, 0.004))

    change = np.clip((loop_length * (laps - 1) + at) / CORNER_LENGTH, 0, 1)  # from 0 to 1 as the second lap begins
    side = lane(at) + lane_change * _smooth_step(change)
    side_slope = lane_slope(at) + lane_change * (1 - np.cos(2 * np.pi * change)) / CORNER_LENGTH
    x, y = x - side * np.sin(heading), y + side * np.cos(heading)
    position = np.stack([x, y, hill(at) + heave(at)], -1)
    yaw = heading + np.arctan2(side_slope, 1 - curvature * side)
    pitches = pitch(at) - np.arctan(hill_slope(at))  # nose up is a negative turn about y, which points left
    rolls = roll(at) + 0.3 * curvature
    return se3.pose(Rotation.from_euler("ZYX", np.stack([yaw, pitches, rolls], -1)).as_matrix(), position)
