"""Chapter 03: a prediction and a measurement, and the Gaussian that they make: on a road, and in the plane."""

import numpy as np
from scipy.stats import norm

from ... import kalman
from ...plots.style import COLOURS, ellipse_points
from ...widgets.canvas import Number, Picture
from ..panels import add_axes, fit_equal, legend_above, moving_line

PREDICTED = 30.0  # m, where the car is predicted to be
CONTROLS = {
    "measured": Number("milestone says (m)", 33.0, 24.0, 36.0, 0.5),
    "sigma_predicted": Number("σ predicted (m)", 2.0, 0.5, 4.0, 0.1),
    "sigma_measured": Number("σ measured (m)", 1.0, 0.5, 4.0, 0.1),
}
PRIOR = np.array([[2.5, 1.1], [1.1, 1.0]])  # m^2, of the landmark in the plane
ON_RAY = np.array([1.0, -0.6])  # m, a point of the measured ray
RAY_CONTROLS = {"bearing": Number("bearing of the ray (°)", 20.0, -90.0, 90.0, 5.0),
                "sigma": Number("σ across the ray (m)", 0.3, 0.1, 2.0, 0.1)}
ROWS = {"predicted": COLOURS["prior"], "measured": COLOURS["measured"], "both": COLOURS["posterior"]}


def combine(measured, sigma_predicted, sigma_measured):
    """Gain, mean (m) and standard deviation (m) of the product of two Gaussians on a line: informations add."""
    information = sigma_predicted**-2 + sigma_measured**-2
    gain = sigma_measured**-2 / information
    return gain, PREDICTED + gain * (measured - PREDICTED), information**-0.5


class TwoGaussiansPicture(Picture):
    """The densities of prediction, measurement and their product; below, the informations 1 / variance, which add."""

    name = "two Gaussians on a road"
    size = (6.4, 4.2)
    controls = CONTROLS

    def build(self):
        self.densities = add_axes(self, (0.1, 0.44, 0.86, 0.4), "Where is the car?", "position along the road (m)",
                                  "density (1/m)", xlim=(20, 40), ylim=(0, 1.2))
        self.x = np.linspace(20, 40, 600)
        self.lines = {name: moving_line(self, self.densities, "-", lw=1.8, color=colour, label=name)
                      for name, colour in ROWS.items()}
        legend_above(self.densities, self.lines.values())
        self.information = add_axes(self, (0.1, 0.12, 0.86, 0.14), "Information 1/σ² (1/m²): the lower bar is the sum",
                                    xlim=(0, 8.5), ylim=(-0.6, 1.6), yticks=[])
        self.bars = {name: moving_line(self, self.information, "-", lw=9, solid_capstyle="butt", color=colour)
                     for name, colour in ROWS.items()}

    def draw(self, measured, sigma_predicted, sigma_measured):
        """Show a measurement (m) and both standard deviations (m)."""
        _, mean, sigma = combine(measured, sigma_predicted, sigma_measured)
        gaussians = {"predicted": (PREDICTED, sigma_predicted), "measured": (measured, sigma_measured),
                     "both": (mean, sigma)}
        for name, (centre, width) in gaussians.items():
            self.lines[name].set_data(self.x, norm.pdf(self.x, centre, width))
        first, total = sigma_predicted**-2, sigma**-2
        self.bars["predicted"].set_data([0, first], [1, 1])
        self.bars["measured"].set_data([first, total], [1, 1])
        self.bars["both"].set_data([0, total], [0, 0])

    def caption(self, measured, sigma_predicted, sigma_measured):
        gain, mean, sigma = combine(measured, sigma_predicted, sigma_measured)
        return (f"Predicted {PREDICTED:.0f} ± {sigma_predicted:.1f} m, measured {measured:.1f} ± "
                f"{sigma_measured:.1f} m: gain {gain:.2f}, together {mean:.2f} ± {sigma:.2f} m.")

    def alt(self, **state):
        return ("Three Gaussian densities along a road: predicted, measured, and both together, narrower than either; "
                "below, their informations as bars, the first two adding up to the third. " + self.caption(**state))


def directions(bearing):
    """(2, 2): unit vectors along and across a ray. bearing : degrees."""
    cos, sin = np.cos(np.radians(bearing)), np.sin(np.radians(bearing))
    return np.array([[cos, sin], [-sin, cos]])


def ray_update(bearing, sigma):
    """Gain (2,), posterior mean (2,) m and covariance (2, 2) m^2 of `PRIOR` and a ray through `ON_RAY`.

    bearing : of the ray, degrees. sigma : of the distance across the ray, m.
    """
    H, V = directions(bearing)[1:], np.array([[sigma**2]])
    S = kalman.innovation_covariance(PRIOR, H, V)
    mean, covariance = kalman.update(PRIOR, H, V, H @ ON_RAY)
    return kalman.gain(PRIOR, H, S)[:, 0], mean, covariance


class RayPicture(Picture):
    """A tilted Gaussian in the plane, a measurement that only knows on which ray the point lies, and their product."""

    name = "a ray in the plane"
    size = (6.4, 4.4)
    controls = RAY_CONTROLS

    def build(self):
        self.axes = add_axes(self, (0.1, 0.13, 0.87, 0.7), "Where is the landmark?", "x (m)", "y (m)")
        fit_equal(self.axes, np.array([[-5.0, -4.0], [5.0, 4.0]]), margin=0.0)
        self.band = self.moves(*self.axes.fill([], [], color=COLOURS["measured"], alpha=0.4, lw=0,
                                               label="measured ray, 95 %"))
        self.after = moving_line(self, self.axes, "-", lw=2, color=COLOURS["posterior"], label="both, 95 %")
        (before,) = self.axes.plot(*ellipse_points(np.zeros(2), PRIOR).T, "--", color=COLOURS["prior"],
                                   label="predicted, 95 %")
        self.move = moving_line(self, self.axes, ".-", lw=1, color=COLOURS["truth"], label="K r")
        legend_above(self.axes, [before, self.band, self.after, self.move])

    def draw(self, bearing, sigma):
        """Show a ray of this bearing (degrees), known to sigma (m) across."""
        _, mean, covariance = ray_update(bearing, sigma)
        along, across = directions(bearing)
        side = 1.96 * sigma * across
        self.band.set_xy([ON_RAY + far * along + off * side for far, off in ((-20, -1), (20, -1), (20, 1), (-20, 1))])
        self.after.set_data(*ellipse_points(mean, covariance).T)
        self.move.set_data([0, mean[0]], [0, mean[1]])

    def caption(self, bearing, sigma):
        gain, _, covariance = ray_update(bearing, sigma)
        lengths = [np.sqrt(d @ P @ d) for d in directions(bearing) for P in (PRIOR, covariance)]
        return ("Gain ({:.2f}, {:.2f}). Standard deviation along the ray {:.2f} → {:.2f} m, across {:.2f} → {:.2f} m."
                .format(*gain, *lengths))

    def alt(self, **state):
        return ("A tilted ellipse of the prediction, a straight band of the measurement, and the smaller ellipse of "
                f"both where they overlap. {self.caption(**state)}")
