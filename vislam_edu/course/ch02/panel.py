"""Chapter 02: a point at a depth, the noise of its pixels, and where triangulation then puts it."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.path import Path

from ...plots.style import COLOURS, ellipse_points
from ...simulate import kitti_camera
from ...widgets.canvas import Number, Picture
from ..panels import add_axes, image_axes, legend, legend_above, moving_line

DRAWS = 500
NEAR, FAR = 4.0, 60.0  # m
ZOOM = 4.0  # px, shown on every side of a pixel: the 95 % circle of the largest noise fits
CONTROLS = {
    "depth": Number("depth (m)", 30.0, NEAR, FAR, 0.5),
    "right": Number("to the right (m)", 0.3, -1.0, 1.0, 0.1),
    "sigma_px": Number("noise (px)", 0.7, 0.1, 1.5, 0.1),
}


def depth_sigma(depth, camera, sigma_px):
    """Standard deviation of a triangulated depth, m: z^2 / (f b) sqrt(2) sigma, to first order.

    depth : (...), m. sigma_px : px of each of the four numbers; the disparity is the difference of two.
    """
    return np.asarray(depth) ** 2 / (camera.K[0, 0] * camera.baseline) * np.sqrt(2) * sigma_px


def inner_spread(depths):
    """Half the width, m, of the inner 68 % of depths (n,): one sigma of a Gaussian, whatever a few wild draws do."""
    near, far = np.percentile(depths, [15.87, 84.13])
    return (far - near) / 2


class StereoDepthPicture(Picture):
    """A point dragged in depth: both images with their noise, and the triangulated cloud from above.

    camera : StereoCamera, by default the simulated drive's. seed : of the noise, drawn once.
    """

    name = "a point dragged in depth"
    size = (6.4, 4.6)
    controls = CONTROLS

    def __init__(self, camera=None, seed=0):
        self.camera = kitti_camera() if camera is None else camera
        self.normal = np.random.default_rng(seed).standard_normal((DRAWS, 4))
        super().__init__()

    def build(self):
        self.images = [self._build_image(side, left) for side, left in (("Left", 0.06), ("Right", 0.56))]
        self.above = add_axes(self, (0.09, 0.11, 0.39, 0.34), "From above, sideways stretched", "forward (m)",
                              "to the right (m)", xlim=(0, 110), ylim=(1.9, -1.9))
        self.above.plot([0, 0], [0, self.camera.baseline], ">", ms=7, color="black", clip_on=False, zorder=3)
        self.rays = self.moves(self.above.add_collection(LineCollection([], lw=0.8, color="0.6"), autolim=False))
        self.cloud = moving_line(self, self.above, ".", ms=2.5, color=COLOURS["measured"], label="triangulated")
        self.ellipse = moving_line(self, self.above, "-", lw=1.6, color=COLOURS["posterior"], label="95 % ellipse")
        self.point = moving_line(self, self.above, "+", ms=7, mew=1.2, color=COLOURS["truth"], label="true point")
        legend_above(self.above, [self.cloud, self.ellipse, self.point], lines=2)

        self.law = add_axes(self, (0.57, 0.11, 0.4, 0.43), "Standard deviation of depth (m)", "depth (m)", "",
                            xlim=(0, FAR + 3), ylim=(0, 24))
        self.depths = np.linspace(0, FAR + 3, 120)
        self.curve = moving_line(self, self.law, "-", lw=1.6, color=COLOURS["posterior"], label="z² / (f b) √2 σ")
        self.here = moving_line(self, self.law, "o", ms=8, mfc="white", mew=1.6, color=COLOURS["posterior"],
                                label="this depth")
        self.spread = moving_line(self, self.law, "x", ms=8, mew=1.8, color=COLOURS["measured"],
                                  label="half the inner 68 %")
        legend(self.law, [self.curve, self.here, self.spread], columns=1, loc="upper left")

    def _build_image(self, side, left):
        """One camera's image, with the noise around its pixel magnified beside it."""
        axes = image_axes(self, (left, 0.72, 0.25, 0.22), f"{side} image (px)")
        axes.set_xticks([0, 600, 1200])
        zoom = add_axes(self, (left + 0.3, 0.75, 0.13, 0.17), "noise (px)", xlim=(-ZOOM, ZOOM), ylim=(ZOOM, -ZOOM),
                        xticks=[-3, 0, 3], yticks=[-3, 0, 3], aspect="equal", facecolor="0.97")
        return (moving_line(self, axes, "o", ms=5, color=COLOURS["measured"]),
                moving_line(self, zoom, ".", ms=2, color=COLOURS["measured"]),
                moving_line(self, zoom, "-", lw=1.4, color=COLOURS["predicted"]))

    def state_of(self, depth, right, sigma_px):
        """True point (3,) in the camera frame, its pixels (4,), noisy pixels (n, 4), their points (n, 3)."""
        point = np.array([right, 0.0, depth])
        true, _ = self.camera.project(point)
        measured = true + sigma_px * self.normal
        cloud, ok = self.camera.triangulate(measured)
        return point, true, measured, cloud[ok]

    def draw(self, depth, right, sigma_px):
        """Show a point at this depth and this far to the right, m, and pixel noise of sigma_px."""
        point, true, measured, cloud = self.state_of(depth, right, sigma_px)
        for (pixel, noise, ring), columns in zip(self.images, (slice(0, 2), slice(2, 4))):
            pixel.set_data(*true[columns, None])
            noise.set_data(*(measured - true)[:, columns].T)
            ring.set_data(*ellipse_points([0, 0], sigma_px**2 * np.eye(2)).T)
        (x, _, z), b = point, self.camera.baseline
        self.rays.set_segments([[(0, 0), (2 * z, 2 * x)], [(0, b), (2 * z, 2 * x - b)]])
        self.cloud.set_data(cloud[:, 2], cloud[:, 0])
        self.ellipse.set_data(*self.outline(point, sigma_px).T)
        self.point.set_data([z], [x])
        self.curve.set_data(self.depths, depth_sigma(self.depths, self.camera, sigma_px))
        self.here.set_data([z], [depth_sigma(z, self.camera, sigma_px)])
        self.spread.set_data([z], [inner_spread(cloud[:, 2])])

    def outline(self, point, sigma_px):
        """(n, 2): 95 % ellipse of depth and x of a triangulated point."""
        P = self.camera.triangulation_covariance(point, sigma_px)
        return ellipse_points(point[[2, 0]], P[np.ix_([2, 0], [2, 0])])

    def caption(self, depth, right, sigma_px):
        point, true, _, cloud = self.state_of(depth, right, sigma_px)
        held = Path(self.outline(point, sigma_px)).contains_points(cloud[:, [2, 0]]).mean()
        return (f"Depth {depth:.1f} m, disparity {true[0] - true[2]:.1f} px: the depth is known to "
                f"± {depth_sigma(depth, self.camera, sigma_px):.2f} m (one σ); of the cloud the inner 68 % lie "
                f"within ± {inner_spread(cloud[:, 2]):.2f} m, the 95 % ellipse holds {held:.0%} of it.")

    def alt(self, **state):
        return ("Both images of a point with its magnified pixel noise; from above the cloud of triangulated points, "
                "drawn out along the line of sight, with its 95 % ellipse; below it the standard deviation of depth, "
                "growing with the square of depth. " + self.caption(**state))
