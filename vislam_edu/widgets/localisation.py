"""Chapter 04: the pose on a known map, half-step by half-step."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon

from .. import kalman, metrics, se3, stereo
from ..plots import TWO_SIDED_95
from ..plots.style import COLOURS, ellipse_points
from .canvas import StepPicture
from .panels import ImagePanel, MapPanel, TimePanel, add_axes, legend, nis_band, phase_colour

WEDGE = 60  # a heading is known to a fraction of a degree: drawn true, the wedge would be a line
NEAR = 30.0  # cm, half the side of the magnified view


def linearise(prior, innovation, camera, landmarks):
    """H (n, 4, 6) of the landmarks of an innovation, by the pose."""
    return camera.pose_jacobian(prior.world_T_imu, landmarks[innovation.ids])


def frame_nis(prior, innovation, camera, noise, landmarks):
    """NIS of a whole frame and its degrees of freedom, see `metrics.frame_nis`."""
    H = linearise(prior, innovation, camera, landmarks)[:, stereo.ROWS]
    return metrics.frame_nis(innovation.residual, H, prior.covariance, noise.sigma_px)


def pulls(prior, innovation, camera, noise, landmarks):
    """(n, 6): what each measurement adds to the correction of the pose, K_j r_j; prior body frame, m and rad.

    Zero where the gate kept the measurement out. The correction of the frame is their sum.
    """
    contribution = np.zeros((len(innovation.ids), 6))
    good = innovation.accepted
    n = 4 * int(good.sum())
    if n == 0:
        return contribution
    H = linearise(prior, innovation, camera, landmarks)[good].reshape(n, 6)
    S = kalman.innovation_covariance(prior.covariance, H, noise.sigma_px**2 * np.eye(n))
    K = kalman.gain(prior.covariance, H, S).reshape(6, -1, 4)
    contribution[good] = np.einsum("aji,ji->ja", K, innovation.residual[good])
    return contribution


class LocalisationPicture(StepPicture):
    """Where the car is on a known map: from above, magnified, in the left image, and innovations in time.

    steps : from `odometry.localize`. drive : the `Drive` they come from. noise : what the filter was given.
    landmarks : (M, 3) m, the known map.
    """

    name = "pose on a known map"
    size = (10.0, 5.6)

    def __init__(self, steps, drive, noise, landmarks):
        self.drive, self.noise, self.landmarks = drive, noise, np.asarray(landmarks)
        super().__init__(steps)

    def build(self):
        """Maps on the left, image and time on the right."""
        self.path = np.array([step.posterior.world_T_imu for step in self.steps])
        points = np.concatenate([self.landmarks[:, :2], self.path[:, :2, 3]])
        self.map = MapPanel(
            self,
            (0.06, 0.6, 0.42, 0.35),
            "Map from above, landmarks in view",
            points,
            true_path=self.drive.true_world_T_imu,
        )
        self.sight = self.map.axes.add_collection(LineCollection([], lw=0.7, color=COLOURS["measured"]), autolim=False)
        self.moves(self.sight)
        self._build_near()
        self.image = ImagePanel(self, (0.55, 0.645, 0.44, 0.24), enlarged=5)
        self._build_time()

    def _build_near(self):
        self.near = add_axes(
            self,
            (0.06, 0.09, 0.2125, 0.3795),
            "Pose, from the predicted one",
            "forward, cm",
            "left, cm",
            xlim=(-NEAR, NEAR),
            ylim=(-NEAR, NEAR),
            aspect="equal",
        )
        kept = COLOURS["prior"]
        self.before = self.near.add_patch(
            Polygon(np.zeros((1, 2)), fill=False, ec=kept, lw=1.2, ls="--", label="predicted, 95 %")
        )
        self.wedge = self.near.add_patch(Polygon(np.zeros((1, 2)), lw=0, alpha=0.25, label=f"heading, 95 %, ×{WEDGE}"))
        self.ellipse = self.near.add_patch(
            Polygon(np.zeros((1, 2)), fill=False, lw=1.8, ec=COLOURS["posterior"], label="position, 95 %")
        )
        self.pulls = self.near.add_collection(
            LineCollection([], lw=1.0, color=COLOURS["measured"], label="pull of one landmark"), autolim=False
        )
        (self.mean,) = self.near.plot([], [], "o", ms=4, color="black", label="estimate")
        (self.truth,) = self.near.plot([], [], "+", ms=9, mew=1.6, color="black", label="truth")
        self.moves(self.before, self.wedge, self.pulls, self.ellipse, self.mean, self.truth)
        handles = [self.ellipse, self.before, self.wedge, self.pulls, self.mean]
        if self.drive.true_world_T_imu is not None:
            handles.append(self.truth)
        legend(self.near, handles, columns=1, loc="upper left", bbox_to_anchor=(1.04, 1.02), frameon=False)

    def _build_time(self):
        times = np.repeat([step.time for step in self.steps], 2)
        nis, n = np.transpose(
            [frame_nis(s.prior, s.innovation, self.drive.camera, self.noise, self.landmarks) for s in self.steps]
        )
        seen = np.where(n > 0, n, np.nan)
        self.nis = _after_update(nis / seen)
        self.band = np.repeat(nis_band(seen), 2, axis=1)
        u, sigma = np.transpose([_rms(s.innovation) for s in self.steps])
        grey = {"color": COLOURS["expected"], "ls": "--", "lw": 1.0}
        blue = {"color": COLOURS["predicted"], "lw": 1.2}
        self.errors = TimePanel(
            self,
            (0.55, 0.37, 0.44, 0.14),
            "Innovation u (px): RMS blue, what S expects dashed",
            "",
            times,
            [(_after_update(u), blue), (_after_update(sigma), grey)],
            xlabel="",
            ylim=(0, 1.2 * np.nanmax([u, sigma])),
        )
        top = max(1.1 * np.nanmax(self.nis), 1.1 * np.nanmax(self.band))
        self.time = TimePanel(
            self,
            (0.55, 0.09, 0.44, 0.16),
            "NIS of the frame / degrees of freedom, with its 95 % band",
            "",
            times,
            [(self.nis, blue)],
            still=[(edge, grey) for edge in self.band],
            ylim=(0, top),
        )

    def draw(self, i):
        """Show half-step i."""
        step, updated = self.step(i)
        belief = self.belief(i)
        ids, pixels = self.drive.observed(step.k)
        T = belief.world_T_imu
        self.map.draw(
            np.concatenate([self.path[: step.k], T[None]]),
            self.landmarks,
            np.zeros((len(self.landmarks), 3, 3)),
            updated,
        )
        self.sight.set_segments([[T[:2, 3], landmark] for landmark in self.landmarks[ids, :2]])
        projected, _ = self.drive.camera.observe(T, self.landmarks[step.innovation.ids])
        self.image.draw(step.innovation, pixels, projected)
        self._draw_near(step, belief, updated)
        self.errors.draw(i)
        self.time.draw(i)

    def _draw_near(self, step, belief, updated):
        """Everything in centimetres along the predicted body axes, origin at the predicted position."""
        prior_T_world = se3.inverse(step.prior.world_T_imu)
        prior_T_now = prior_T_world @ belief.world_T_imu
        R, at = prior_T_now[:3, :3], 100 * prior_T_now[:2, 3]
        covariance = (R @ belief.covariance[:3, :3] @ R.T)[:2, :2] * 1e4
        self.before.set_xy(ellipse_points([0, 0], step.prior.covariance[:2, :2] * 1e4))
        self.ellipse.set_xy(ellipse_points(at, covariance))
        self.ellipse.set_edgecolor(phase_colour(updated))
        self.wedge.set_facecolor(phase_colour(updated))
        self.wedge.set_xy(_wedge(at, np.arctan2(R[1, 0], R[0, 0]), heading_half_width(belief)))
        self.mean.set_data([at[0]], [at[1]])
        contribution = pulls(step.prior, step.innovation, self.drive.camera, self.noise, self.landmarks)
        shown = contribution[step.innovation.accepted, :2] * 100 if updated else []
        self.pulls.set_segments([[(0, 0), pull] for pull in shown])
        truth = self.drive.true_world_T_imu
        if truth is not None:
            self.truth.set_data(*(100 * (prior_T_world @ truth[step.k])[:2, 3:]))

    def caption(self, i):
        """What the frame did to the pose."""
        step, updated = self.step(i)
        belief = self.belief(i)
        forward, left = 100 * TWO_SIDED_95 * np.sqrt(np.diag(belief.covariance)[:2])
        known = (
            f" 95 % of each alone: forward ± {forward:.1f} cm, left ± {left:.1f} cm, "
            f"heading ± {np.rad2deg(heading_half_width(belief)):.2f}°."
        )
        if not updated:
            grown = "the start" if i == 0 else "the ellipse has swollen by one step of the IMU's noise"
            return f"{self.when(i)}: {grown}.{known}"
        innovation = step.innovation
        return (
            f"{self.when(i)}: {int(innovation.accepted.sum())} of {len(innovation.ids)} landmarks pull "
            f"the pose, "
            f"the ellipse shrinks.{known}"
        )

    def alt(self, i):
        """The picture in words."""
        return (
            f"Map from above with the car and the landmarks in view, {self.when(i)}; magnified, the 95 % "
            f"ellipse of the "
            f"position and the wedge of the heading; the left image, predictions drawn "
            f"{self.image.enlarged} times as far from "
            "the measured pixels; innovations and NIS through time."
        )


def heading_half_width(belief):
    """Half the 95 % interval of the heading, rad: 1.96 sigma of the rotation about the body's z axis."""
    return TWO_SIDED_95 * np.sqrt(belief.covariance[5, 5])


def _wedge(at, heading, half_width, radius=0.8 * NEAR):
    """A sector (n, 2) around the heading, `WEDGE` times as wide as it is, up to a half circle."""
    wide = min(WEDGE * half_width, np.pi / 2)
    angle = heading + np.linspace(-wide, wide, 30)
    return np.concatenate([[at], at + radius * np.column_stack([np.cos(angle), np.sin(angle)])])


def _rms(innovation):
    """RMS of a frame's innovations of u (left), and what S leads one to expect; NaN for an empty frame."""
    if len(innovation.ids) == 0:
        return np.nan, np.nan
    return np.sqrt([np.mean(innovation.residual[:, 0] ** 2), np.mean(innovation.covariance[:, 0, 0])])


def _after_update(values):
    """Values per frame to values per half-step: until the update of frame k that of frame k - 1 stands."""
    doubled = np.repeat(values, 2)
    return np.concatenate([[np.nan], doubled[:-1]])
