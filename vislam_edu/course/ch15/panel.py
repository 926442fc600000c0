"""Chapter 15: a patch, its residual and its next step, one iteration of Lucas-Kanade after the other."""

import numpy as np

from ... import tracking
from ...plots.style import COLOURS
from ...widgets.canvas import Number, Picture
from ..panels import add_axes, moving_line


class PatchPicture(Picture):
    """Left the template, then the other image at the present guess, and what is left between them.

    image, other : (h, w), one level of a pyramid. point, start : (2,) px, in `image` and in `other`.
    guesses : (n, 2) px, the guess after each iteration, the start first.
    """

    name = "Lucas-Kanade"
    size = (6.4, 2.9)

    def __init__(self, image: np.ndarray, other: np.ndarray, point: np.ndarray, start: np.ndarray, n: int = 8):
        half = tracking.HALF
        wide = tracking.patches(np.asarray(image, np.float32), np.asarray(point, float), half + 1)
        self.template = wide[1:-1, 1:-1]
        g_v, g_u = (gradient[1:-1, 1:-1] for gradient in np.gradient(wide))
        g = np.stack([g_u.ravel(), g_v.ravel()], axis=1)
        self.guesses, self.seen = [np.asarray(start, float)], []
        for _ in range(n):
            self.seen.append(tracking.patches(np.asarray(other, np.float32), self.guesses[-1], half))
            residual = (self.template - self.seen[-1]).ravel()
            self.guesses.append(self.guesses[-1] + np.linalg.solve(g.T @ g, g.T @ residual))
        self.controls = {"step": Number("step", 1, 1, n, 1)}
        super().__init__()

    def build(self):
        self.axes = [add_axes(self, (0.02 + 0.33 * i, 0.05, 0.30, 0.78), title)
                     for i, title in enumerate(("Patch", "Other image at the guess", "Residual and step"))]
        grey = {"cmap": "gray", "vmin": self.template.min(), "vmax": self.template.max()}
        self.axes[0].imshow(self.template, **grey)
        limit = np.ptp(self.template)
        self.there = self.moves(self.axes[1].imshow(self.template, **grey))
        self.left = self.moves(self.axes[2].imshow(self.template, cmap="RdBu", vmin=-limit, vmax=limit))
        self.step = moving_line(self, self.axes[2], "-o", ms=3, color=COLOURS["truth"])
        for axes in self.axes:
            axes.set_axis_off()

    def draw(self, step):
        self.there.set_data(self.seen[step - 1])
        self.left.set_data(self.template - self.seen[step - 1])
        move, half = self.guesses[step] - self.guesses[step - 1], tracking.HALF
        self.step.set_data([half, half + move[0]], [half, half + move[1]])

    def caption(self, step):
        residual = np.sqrt(np.mean((self.template - self.seen[step - 1])**2))
        move = self.guesses[step] - self.guesses[step - 1]
        return f"Step {step}: residual {residual:.1f} grey values, step ({move[0]:+.2f}, {move[1]:+.2f}) px."

    def alt(self, step):
        return f"A patch, the other image at the guess, and their difference with the step. {self.caption(step)}"
