"""Chapter 05: the joint filter over landmarks and pose, with or without what ties them."""

import numpy as np
from matplotlib.collections import LineCollection

from .. import metrics, window_slam
from ..error_state import RightPerturbation
from ..plots.style import COLOURS
from ..studies.pipeline import world_landmark_covariance
from .canvas import StepPicture, Switch
from .panels import LETTERING, MapPanel, TimePanel, add_axes, legend, nis_band

AXIS = 0  # of the pose error [x, y, z, roll, pitch, yaw]: along the road, which stereo knows least about
YAW = 5
RETIRED = (0, (0.5, 0.5))  # line style of the mark of a landmark that leaves the state


def correlation(covariance):
    """Correlation matrix (n, n) of a covariance (n, n): entries from -1 to 1, ones on the diagonal."""
    sigma = np.sqrt(np.diag(covariance))
    return covariance / np.outer(sigma, sigma)


def frame_nis(step, settings):
    """NIS of a whole frame and its degrees of freedom, see `metrics.frame_nis`."""
    innovation, prior = step.innovation, step.prior
    at_prior = window_slam.linearise(prior, innovation.ids, settings)[0]
    n = len(prior.ids)
    H = np.zeros((len(innovation.ids), 3, len(prior.covariance)))
    for j, row in enumerate(at_prior.rows):
        H[j, :, 3 * row : 3 * row + 3] = at_prior.H_landmark[j]
    H[:, :, 3 * n : 3 * n + 6] = at_prior.H_pose
    return metrics.frame_nis(innovation.residual, H, prior.covariance, settings.noise.sigma_px)


class History:
    """One run of the joint filter, and what its panels show through time, per half-step."""

    def __init__(self, steps, drive, noise, error_state):
        self.steps = tuple(steps)
        settings = window_slam.UpdateSettings(drive.camera, noise, error_state, threshold=np.inf, min_disparity=0.0)
        nis, numbers = np.transpose([frame_nis(step, settings) for step in self.steps])
        self.numbers = np.where(numbers > 0, numbers, np.nan)
        self.nis = np.concatenate([[np.nan], np.repeat(nis / self.numbers, 2)[:-1]])
        beliefs = [belief for step in self.steps for belief in (step.prior, step.posterior)]
        self.three_sigma = 3 * np.sqrt([np.diag(belief.pose_covariance) for belief in beliefs])
        self.error = np.full((len(beliefs), 6), np.nan)
        if drive.true_world_T_imu is not None:
            truth = np.repeat(drive.true_world_T_imu[[step.k for step in self.steps]], 2, axis=0)
            self.error = error_state.pose_difference(truth, np.array([b.world_T_imu for b in beliefs]))


class JointPicture(StepPicture):
    """Map, correlation matrix of the joint belief, error of the pose against 3 sigma, and NIS.

    steps : from `window_slam.run`. drive, noise, error_state : what that run was given.
    without : the steps of the same run with `window_slam.without_cross_covariance`; then a switch shows them instead.
    Raises ValueError when the two runs differ in length.
    """

    name = "joint filter"
    size = (10.0, 5.6)

    def __init__(self, steps, drive, noise, error_state=None, without=None):
        self.drive, self.error_state = drive, error_state or RightPerturbation()
        self.histories = [History(steps, drive, noise, self.error_state)]
        if without is not None:
            self.histories.append(History(without, drive, noise, self.error_state))
            if len(self.histories[1].steps) != len(self.histories[0].steps):
                raise ValueError(
                    f"without: {len(self.histories[1].steps)} steps, expected "
                    f"{len(self.histories[0].steps)} as in the other run"
                )
            self.controls = {"drop": Switch("drop the cross-covariance after every frame")}
        super().__init__(self.histories[0].steps)

    def build(self):
        """Map and matrix on the left, time on the right."""
        ids = np.unique(np.concatenate([s.posterior.ids for h in self.histories for s in h.steps]))
        points = [s.posterior.world_T_imu[None, :2, 3] for h in self.histories for s in h.steps]
        if self.drive.true_landmarks is not None:
            points.append(self.drive.true_landmarks[ids, :2])
        self.map = MapPanel(
            self,
            (0.06, 0.6, 0.42, 0.35),
            "Map from above, 95 % ellipses",
            np.concatenate(points),
            self.drive.true_landmarks,
            self.drive.true_world_T_imu,
        )
        (self.gone,) = self.map.axes.plot([], [], "x", ms=7, mew=1.5, color=COLOURS["rejected"])
        (self.new,) = self.map.axes.plot([], [], "o", ms=9, mew=1.5, mfc="none", color=COLOURS["accepted"])
        self.moves(self.gone, self.new)
        self._build_matrix()
        self._build_time()

    def _build_matrix(self):
        size = max(len(b.covariance) for h in self.histories for s in h.steps for b in (s.prior, s.posterior))
        self.matrix = add_axes(
            self,
            (0.06, 0.055, 0.2436, 0.42),
            "Correlation of the joint state",
            xticks=[],
            yticks=[],
            xlim=(-2.5, size),
            ylim=(size, -2.5),
            aspect="equal",
            anchor="W",
        )
        self.matrix.grid(False)
        for spine in self.matrix.spines.values():
            spine.set_visible(False)
        self.image = self.matrix.imshow(
            np.eye(2), cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest", aspect="equal"
        )
        self.matrix.set(xlim=(-2.5, size), ylim=(size, -2.5))
        self.blocks = self.matrix.add_collection(LineCollection([], lw=0.4, color="0.75"), autolim=False)
        self.pose_lines = self.matrix.add_collection(
            LineCollection([], lw=1.4, color="black", label="pose block"), autolim=False
        )
        self.marks = self.matrix.add_collection(LineCollection([], lw=4), autolim=False)
        self.moves(self.image, self.blocks, self.pose_lines, self.marks)
        bar = self.figure.colorbar(self.image, cax=self.figure.add_axes((0.325, 0.075, 0.012, 0.2)))
        bar.ax.tick_params(labelsize=LETTERING)
        bar.outline.set_visible(False)
        (born,) = self.matrix.plot([], [], lw=4, color=COLOURS["accepted"], label="born in this frame")
        (leaves,) = self.matrix.plot([], [], lw=4, ls=RETIRED, color=COLOURS["rejected"], label="retired next")
        legend(
            self.matrix,
            [self.pose_lines, born, leaves],
            columns=1,
            loc="upper left",
            bbox_to_anchor=(1.03, 1),
            frameon=False,
        )

    def _build_time(self):
        times = np.repeat([step.time for step in self.steps], 2)
        grey = {"color": COLOURS["expected"], "ls": "--", "lw": 1.0}
        blue = {"color": COLOURS["slam"], "lw": 1.4}
        top = [
            1.15
            * max(max(h.three_sigma[:, a].max(), np.nanmax(np.abs(h.error[:, a]), initial=0)) for h in self.histories)
            for a in (AXIS, YAW)
        ]
        first = self.histories[0]
        styles = (blue, grey, grey)
        self.forward = TimePanel(
            self,
            (0.56, 0.72, 0.43, 0.2),
            "Position error forward (m) and its ± 3σ (dashed)",
            "",
            times,
            list(zip(error_and_band(first, AXIS), styles)),
            xlabel="",
            ylim=(-top[0], top[0]),
        )
        self.heading = TimePanel(
            self,
            (0.56, 0.41, 0.43, 0.2),
            "Heading error (degrees) and its ± 3σ (dashed)",
            "",
            times,
            list(zip(np.rad2deg(error_and_band(first, YAW)), styles)),
            xlabel="",
            ylim=np.rad2deg([-top[1], top[1]]),
        )
        band = np.repeat(nis_band(first.numbers), 2, axis=1)
        highest = 1.1 * np.nanmax([np.nanmax(h.nis) for h in self.histories] + [np.nanmax(band)])
        self.nis = TimePanel(
            self,
            (0.56, 0.09, 0.43, 0.2),
            "NIS of the frame / degrees of freedom, with its 95 % band",
            "",
            times,
            [(first.nis, blue)],
            still=[(edge, grey) for edge in band],
            ylim=(0, highest),
        )

    def draw(self, i, drop=False):
        """Show half-step i, of the run without cross-covariances if `drop`."""
        history = self.histories[drop]
        belief, leaving = self._state(i, history)
        step = history.steps[i // 2]
        path = np.array([s.posterior.world_T_imu for s in history.steps[: i // 2]] + [belief.world_T_imu])
        self.map.draw(path, belief.landmarks, world_landmark_covariance(belief, self.error_state), bool(i % 2))
        born = np.isin(belief.ids, step.born)
        self.new.set_data(*belief.landmarks[born, :2].T)
        self.gone.set_data(*belief.landmarks[leaving, :2].T)
        self._draw_matrix(belief, born, leaving)
        self.forward.draw(i, error_and_band(history, AXIS))
        self.heading.draw(i, np.rad2deg(error_and_band(history, YAW)))
        self.nis.draw(i, [history.nis])

    def _state(self, i, history):
        """The belief of half-step i, and which of its landmarks (n,) bool the next frame retires."""
        step, updated = history.steps[i // 2], i % 2
        belief = step.posterior if updated else step.prior
        last = not updated or i // 2 + 1 == len(history.steps)
        leaving = [] if last else history.steps[i // 2 + 1].retired
        return belief, np.isin(belief.ids, leaving)

    def _draw_matrix(self, belief, born, leaving):
        size, n = len(belief.covariance), 3 * len(belief.ids)
        self.image.set_data(correlation(belief.covariance))
        self.image.set_extent((0, size, size, 0))
        self.blocks.set_segments(_cross_lines(np.arange(0, n, 3), size))
        self.pose_lines.set_segments(_cross_lines(np.array([n]), size))
        rows = np.flatnonzero(born | leaving)
        self.marks.set_segments([[(-1.5, 3 * row + 0.3), (-1.5, 3 * row + 2.7)] for row in rows])
        self.marks.set_color([COLOURS["rejected" if leaving[row] else "accepted"] for row in rows])
        self.marks.set_linestyle([RETIRED if leaving[row] else "-" for row in rows] or "-")

    def caption(self, i, drop=False):
        """What the frame did to the joint belief."""
        step = self.histories[drop].steps[i // 2]
        belief, _ = self._state(i, self.histories[drop])
        size = len(belief.covariance)
        tail = f" State: {len(belief.ids)} landmarks and the pose, {size} × {size}."
        if drop:
            tail += " Cross-covariances are dropped after every frame."
        if i == 0:
            return f"{self.when(i)}: the start.{tail}"
        if i % 2 == 0:
            return f"{self.when(i)}: the pose is less certain. Retired: {_listed(step.retired)}.{tail}"
        used = int(step.innovation.accepted.sum())
        return f"{self.when(i)}: {used} landmarks correct map and pose. Born: {_listed(step.born)}.{tail}"

    def alt(self, i, drop=False):
        """The picture in words."""
        size = len(self._state(i, self.histories[drop])[0].covariance)
        which = "without cross-covariances" if drop else "with all cross-covariances"
        return (
            f"The joint filter {which}, {self.when(i)}: map from above with 95 % ellipses, the {size} by "
            f"{size} "
            "correlation matrix, errors of position and heading against three standard deviations, NIS "
            "through time."
        )


def error_and_band(history, axis):
    """(3, n): error of one component of the pose, and the edges of its band of 3 sigma."""
    return np.array([history.error[:, axis], history.three_sigma[:, axis], -history.three_sigma[:, axis]])


def _cross_lines(at, size):
    """Horizontal and vertical lines across a matrix of this size."""
    return [[(0, p), (size, p)] for p in at] + [[(p, 0), (p, size)] for p in at]


def _listed(ids):
    return ", ".join(map(str, ids)) if len(ids) else "none"
