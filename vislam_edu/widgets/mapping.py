"""Chapter 03: the landmark EKF on known poses, half-step by half-step."""

import numpy as np

from .canvas import StepPicture
from .panels import ImagePanel, MapPanel, TimePanel, legend, principal_sigmas

AXES = (("longest axis", "#004488", "-"), ("middle axis", "#43A2B5", "--"), ("shortest axis", "#BB5566", ":"))


class MappingPicture(StepPicture):
    """Map from above, left image with its innovations, and one landmark's uncertainty through time.

    steps : from `mapping.run`. drive : the `Drive` they come from. world_T_imu : (T, 4, 4), poses given to it.
    landmark : which landmark to follow; by default the one in view for the longest time.
    """

    name = "landmark EKF on known poses"

    def __init__(self, steps, drive, world_T_imu, landmark=None):
        self.drive, self.world_T_imu = drive, np.asarray(world_T_imu)
        self.landmark = int(np.argmax(drive.last_seen - drive.first_seen)) if landmark is None else landmark
        super().__init__(steps)

    def build(self):
        """Map on the left, image and time on the right."""
        beliefs = [self.belief(i) for i in range(self.n)]
        self.sigmas = np.array(
            [principal_sigmas(b.covariance[self.landmark]) if b.seen[self.landmark] else [np.nan] * 3 for b in beliefs]
        )
        last = beliefs[-1]
        points = np.concatenate([last.landmarks[last.seen, :2], self.world_T_imu[:, :2, 3]])
        self.map = MapPanel(
            self, (0.06, 0.1, 0.42, 0.82), "Map from above, 95 % ellipses", points, self.drive.true_landmarks
        )
        self.image = ImagePanel(self, (0.54, 0.55, 0.45, 0.3), enlarged=20)
        lines = [
            (3 * self.sigmas[:, a], {"label": label, "color": colour, "ls": style, "lw": 1.6})
            for a, (label, colour, style) in enumerate(AXES)
        ]
        times = np.repeat([step.time for step in self.steps], 2)
        known = 3 * self.sigmas[np.isfinite(self.sigmas)]
        self.time = TimePanel(
            self,
            (0.54, 0.1, 0.45, 0.29),
            f"Landmark {self.landmark} (ringed): 3σ along its axes",
            "m",
            times,
            lines,
            yscale="log",
            ylim=(known.min() / 2, known.max() * 2),
        )
        legend(self.time.axes, self.time.lines)

    def draw(self, i):
        """Show half-step i."""
        step, updated = self.step(i)
        belief = self.belief(i)
        known = belief.seen[self.landmark]
        ids, pixels = self.drive.observed(step.k)
        self.map.draw(
            self.world_T_imu[: step.k + 1],
            belief.landmarks[belief.seen],
            belief.covariance[belief.seen],
            updated,
            belief.landmarks[self.landmark, :2] if known else (),
        )
        projected, _ = self.drive.camera.observe(self.world_T_imu[step.k], belief.landmarks[step.innovation.ids])
        self.image.draw(step.innovation, pixels, projected, pixels[ids == self.landmark, :2])
        self.time.draw(i)

    def caption(self, i):
        """What the frame did to the map."""
        step, updated = self.step(i)
        if not updated:
            return f"{self.when(i)}: a landmark stands still, so prediction leaves its ellipse as it was."
        used = int(step.innovation.accepted.sum())
        return f"{self.when(i)}: {used} ellipses shrink, {len(step.born)} landmarks are new."

    def alt(self, i):
        """The picture in words."""
        belief = self.belief(i)
        return (
            f"Map from above with {int(belief.seen.sum())} landmarks and their 95 % ellipses, "
            f"{self.when(i)}; the left "
            f"image, predictions drawn {self.image.enlarged} times as far from the measured pixels; three "
            f"standard deviations of landmark "
            f"{self.landmark} through time."
        )
