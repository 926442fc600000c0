"""Chapter 16: how far an IMU alone may be off, with and without its biases in the state."""

import numpy as np

from ... import imu
from ...plots import two_digits
from ...plots.style import COLOURS
from ...widgets.canvas import Decades, Picture
from ..panels import add_axes, legend_above

TIMES = np.linspace(0, 20, 101)  # s
CONTROLS = {
    "gyro_density": Decades("gyro noise (rad/s/√Hz)", 1.7e-4, 1e-5, 1e-2, 0.1),
    "accelerometer_density": Decades("accelerometer noise (m/s²/√Hz)", 2e-3, 1e-4, 1e-1, 0.1),
    "gyro_bias": Decades("gyro bias, 1 σ (rad/s)", 1e-3, 1e-6, 1e-1, 0.1),
    "accelerometer_bias": Decades("accelerometer bias, 1 σ (m/s²)", 5e-2, 1e-4, 1.0, 0.1),
}


def growth(noise, gyro_bias, accelerometer_bias, times=TIMES):
    """(T,) m: standard deviation of x of an IMU that lies still and level, its start known but for the biases.

    noise : `imu.ImuNoise`. gyro_bias, accelerometer_bias : standard deviations, rad/s and m/s^2; zero for a filter
    that has no bias states and takes both for known.
    """
    tau = times[1] - times[0]
    taus = np.full(10, tau / 10)
    motion = imu.preintegrate(np.zeros((10, 3)), np.tile(-imu.GRAVITY, (10, 1)), taus, np.zeros(3), np.zeros(3), noise)
    F, Q = imu.transition(np.eye(3), motion)
    if not (gyro_bias or accelerometer_bias):
        Q[imu.BIASES], Q[:, imu.BIASES] = 0, 0
    P = np.zeros((15, 15))
    P[imu.BIASES, imu.BIASES] = np.diag(np.repeat([gyro_bias, accelerometer_bias], 3)**2)
    variance = [0.0]
    for _ in times[1:]:
        P = F @ P @ F.T + Q
        variance.append(P[3, 3])
    return np.sqrt(variance)


class GrowthPicture(Picture):
    """The standard deviation of the position of an IMU alone: white noise only, and with uncertain biases."""

    name = "growth"
    size = (6.4, 3.6)
    controls = CONTROLS

    def build(self):
        """Two curves on a logarithmic scale."""
        self.axes = add_axes(self, (0.15, 0.14, 0.81, 0.68), "", "time without a camera (s)", "σ of x (m)",
                             xlim=(0, TIMES[-1]), yscale="log", ylim=(1e-4, 1e4))
        (self.white,) = self.axes.plot(TIMES[1:], TIMES[1:], "--", color=COLOURS["report"], label="white noise alone")
        (self.biased,) = self.axes.plot(TIMES[1:], TIMES[1:], color=COLOURS["invariant"], label="biases as states")
        self.moves(self.white, self.biased)
        legend_above(self.axes, [self.white, self.biased])

    def outcome(self, gyro_density, accelerometer_density, gyro_bias, accelerometer_bias):
        """Both curves, (T,) m."""
        noise = imu.ImuNoise(gyro_density, accelerometer_density, 0.0, 0.0)
        return growth(noise, 0.0, 0.0), growth(noise, gyro_bias, accelerometer_bias)

    def draw(self, **state):
        """Show the growth for these numbers."""
        for line, sigma in zip((self.white, self.biased), self.outcome(**state)):
            line.set_ydata(sigma[1:])

    def caption(self, **state):
        """Both after 1 s and after 20 s."""
        white, biased = self.outcome(**state)
        second = np.searchsorted(TIMES, 1.0)
        return (f"σ of x after 1 s: {two_digits(white[second])} m by white noise alone, {two_digits(biased[second])} m "
                f"with the biases; after 20 s: {two_digits(white[-1])} m and {two_digits(biased[-1])} m.")

    def alt(self, **state):
        """The picture in words."""
        return "Standard deviation of the position of an IMU alone through time, two curves. " + self.caption(**state)
