"""Chapter 16: how far an IMU alone may be off, with and without its biases in the state; which error is to blame."""

import numpy as np

from ... import imu
from ...plots import two_digits
from ...plots.style import COLOURS
from ...widgets.canvas import Decades, Number, Picture
from ..panels import LETTERING, add_axes, legend_above

TIMES = np.linspace(0, 20, 101)  # s
SOURCES = ("gyro noise", "accel. noise", "gyro bias", "accel. bias")
CONTROLS = {
    "gyro_density": Decades("gyro noise (rad/s/√Hz)", 1.7e-4, 1e-5, 1e-2, 0.1),
    "accelerometer_density": Decades("accelerometer noise (m/s²/√Hz)", 2e-3, 1e-4, 1e-1, 0.1),
    "gyro_bias": Decades("gyro bias, 1 σ (rad/s)", 1e-3, 1e-6, 1e-1, 0.1),
    "accelerometer_bias": Decades("accelerometer bias, 1 σ (m/s²)", 5e-2, 1e-4, 1.0, 0.1),
    "seconds": Number("time without a camera (s)", 1, 1, 20, 1),
}


def growth(gyro_density, accelerometer_density, gyro_bias, accelerometer_bias, times=TIMES):
    """(4, T) m: what each of `SOURCES` alone makes of the standard deviation of x; their squares add up.

    The IMU lies still and level, its start is known but for the biases. Densities as in `imu.ImuNoise`; biases as
    standard deviations, rad/s and m/s^2.
    """
    tau, still = times[1] - times[0], (np.zeros((10, 3)), np.tile(-imu.GRAVITY, (10, 1)))
    zero, P, Q = np.zeros(3), np.zeros((4, 15, 15)), np.zeros((4, 15, 15))
    for i, noise in enumerate([(gyro_density, 0.0), (0.0, accelerometer_density)]):
        motion = imu.preintegrate(*still, np.full(10, tau / 10), zero, zero, imu.ImuNoise(*noise, 0.0, 0.0))
        F, Q[i] = imu.transition(np.eye(3), motion)
    P[2, imu.GYRO_BIAS, imu.GYRO_BIAS] = gyro_bias**2 * np.eye(3)
    P[3, imu.ACCELEROMETER_BIAS, imu.ACCELEROMETER_BIAS] = accelerometer_bias**2 * np.eye(3)
    variance = [np.zeros(4)]
    for _ in times[1:]:
        P = F @ P @ F.T + Q
        variance.append(P[:, 3, 3])
    return np.sqrt(variance).T


class GrowthPicture(Picture):
    """Left the standard deviation of the position of an IMU alone through time; right what each error adds to it."""

    name = "growth"
    size = (8.2, 3.6)
    controls = CONTROLS

    def build(self):
        scale = {"yscale": "log", "ylim": (1e-5, 1e4)}
        self.axes = add_axes(self, (0.11, 0.14, 0.47, 0.68), "", "time without a camera (s)", "σ of x (m)",
                             xlim=(0, TIMES[-1]), **scale)
        (self.white,) = self.axes.plot(TIMES[1:], TIMES[1:], "--", color=COLOURS["report"], label="white noise alone")
        (self.biased,) = self.axes.plot(TIMES[1:], TIMES[1:], color=COLOURS["invariant"], label="biases as states")
        self.now = self.axes.axvline(1, color=COLOURS["truth"], linewidth=0.8)
        legend_above(self.axes, [self.white, self.biased])
        beside = add_axes(self, (0.66, 0.14, 0.32, 0.68), "What each error adds there", "", "", **scale)
        self.bars = beside.bar(range(4), 1.0, bottom=1e-5, color=[COLOURS["report"]] * 2 + [COLOURS["invariant"]] * 2)
        beside.set_xticks(range(4), [source.replace(" ", "\n") for source in SOURCES], fontsize=LETTERING)
        self.moves(self.now, self.white, self.biased, *self.bars)

    @staticmethod
    def outcome(seconds, **sigmas):
        """`growth` (4, T), and its column at the time chosen (4,)."""
        parts = growth(**sigmas)
        return parts, parts[:, np.searchsorted(TIMES, seconds - 1e-9)]

    def draw(self, **state):
        """Show the growth for these numbers, and the shares at the time chosen."""
        parts, there = self.outcome(**state)
        self.white.set_ydata(np.linalg.norm(parts[:2], axis=0)[1:])
        self.biased.set_ydata(np.linalg.norm(parts, axis=0)[1:])
        self.now.set_xdata([state["seconds"]] * 2)
        for bar, sigma in zip(self.bars, there):
            bar.set_height(max(sigma - 1e-5, 0.0))

    def caption(self, **state):
        parts = self.outcome(**state)[1]
        white, whole = np.linalg.norm(parts[:2]), np.linalg.norm(parts)
        largest = SOURCES[int(parts.argmax())].replace("accel.", "accelerometer")
        return (f"σ of x after {state['seconds']} s: {two_digits(white)} m by white noise alone, {two_digits(whole)} m "
                f"with the biases. The largest part: {largest}.")

    def alt(self, **state):
        return ("Standard deviation of the position of an IMU alone through time, two curves, and bars for what "
                "each of four errors adds. " + self.caption(**state))
