"""Chapter 03: a car on a road and a milestone: a prediction and a measurement, and the Gaussian that they make."""

import numpy as np
from scipy.stats import norm

from ...plots.style import COLOURS
from ...widgets.canvas import Number, Picture
from ..panels import add_axes, legend_above

PREDICTED = 30.0  # m, where the car is predicted to be
CONTROLS = {
    "measured": Number("milestone says (m)", 33.0, 24.0, 36.0, 0.5),
    "sigma_predicted": Number("σ predicted (m)", 2.0, 0.5, 4.0, 0.1),
    "sigma_measured": Number("σ measured (m)", 1.0, 0.5, 4.0, 0.1),
}
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
        """The densities above, the informations below."""
        self.densities = add_axes(self, (0.1, 0.44, 0.86, 0.4), "Where is the car?", "position along the road (m)",
                                  "density (1/m)", xlim=(20, 40), ylim=(0, 1.2))
        self.x = np.linspace(20, 40, 600)
        lines = [self.densities.plot([], [], "-", lw=1.8, color=colour, label=name)[0] for name, colour in ROWS.items()]
        self.lines = dict(zip(ROWS, self.moves(*lines)))
        legend_above(self.densities, lines)
        self.information = add_axes(self, (0.1, 0.12, 0.86, 0.14), "Information 1/σ² (1/m²): the lower bar is the sum",
                                    xlim=(0, 8.5), ylim=(-0.6, 1.6), yticks=[])
        bars = [self.information.plot([], [], "-", lw=9, solid_capstyle="butt", color=ROWS[name])[0] for name in ROWS]
        self.bars = dict(zip(ROWS, self.moves(*bars)))

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
        """Gain, mean and standard deviation."""
        gain, mean, sigma = combine(measured, sigma_predicted, sigma_measured)
        return (f"Predicted {PREDICTED:.0f} ± {sigma_predicted:.1f} m, measured {measured:.1f} ± "
                f"{sigma_measured:.1f} m: gain {gain:.2f}, together {mean:.2f} ± {sigma:.2f} m.")

    def alt(self, **state):
        """The picture in words."""
        return ("Three Gaussian densities along a road: predicted, measured, and both together, narrower than either; "
                "below, their informations as bars, the first two adding up to the third. " + self.caption(**state))
