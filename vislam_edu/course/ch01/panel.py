"""Chapter 01: a twist integrated, exactly and by Euler's method, and what its noise does to the pose."""

from dataclasses import dataclass
from functools import lru_cache, reduce

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.path import Path

from ... import odometry, se3
from ...plots.style import COLOURS, ellipse_points
from ...widgets.canvas import Number, Picture
from ..panels import LETTERING, add_axes, legend_above, moving_line, round_up

TAU = 0.5  # s, one IMU sample
SAMPLES = 20
PARTICLES = 400
SIGMA_V = 0.5  # m/s per sample
TRIADS = 8
AXIS_COLOURS = [COLOURS["rejected"], COLOURS["accepted"], COLOURS["predicted"]]  # x, y, z

# Seen from behind, to the right and above: screen right and screen up, as directions of the world.
_AZIMUTH, _ELEVATION = np.deg2rad([-110.0, 28.0])
VIEW = np.array([
    [-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0],
    [-np.sin(_ELEVATION) * np.cos(_AZIMUTH), -np.sin(_ELEVATION) * np.sin(_AZIMUTH), np.cos(_ELEVATION)]])
REACHES = (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10)  # times a power of ten, m: how far the view reaches
CONTROLS = {
    "v_x": Number("v x (m/s)", 5.0, -10.0, 10.0, 0.5),
    "v_y": Number("v y (m/s)", 0.0, -10.0, 10.0, 0.5),
    "v_z": Number("v z (m/s)", 0.0, -10.0, 10.0, 0.5),
    "omega_x": Number("ω x (rad/s)", 0.0, -1.0, 1.0, 0.05),
    "omega_y": Number("ω y (rad/s)", 0.0, -1.0, 1.0, 0.05),
    "omega_z": Number("ω z (rad/s)", 0.1, -1.0, 1.0, 0.05),
    "samples": Number(f"time, × {TAU} s", 12, 1, SAMPLES, 1),
    "steps": Number("Euler steps", 3, 1, 50, 1),
    "sigma_omega": Number("σ ω z (rad/s)", 0.2, 0.0, 0.4, 0.01),
}


@dataclass(frozen=True)
class PlanarNoise:
    """White noise on v x, v y and omega z of one IMU sample: what moves a car about in the plane.

    sigma_v : m/s. sigma_omega : rad/s.
    """

    sigma_v: float
    sigma_omega: float

    @property
    def sigmas(self):
        """(6,) standard deviations of one sample [v, omega]."""
        return np.array([self.sigma_v, self.sigma_v, 0.0, 0.0, 0.0, self.sigma_omega])

    @property
    def twist_covariance(self):
        """(6, 6), as `noise.Noise` has it."""
        return np.diag(self.sigmas**2)


def euler(twist, duration, steps):
    """(steps + 1, 4, 4): dT/dt = T twist^ by Euler's method, T + T tau twist^, which leaves SE(3)."""
    one = np.eye(4) + duration / steps * se3.hat(twist)
    return se3.chain(np.eye(4), [one] * steps)


def screw_axis(twist):
    """Direction (3,) and a point (3,) of the axis that a twist turns about, or None when it does not turn.

    Source: Lynch and Park, Modern Robotics, section 3.3.2.2.
    """
    v, omega = np.split(np.asarray(twist, dtype=float), 2)
    rate2 = omega @ omega
    return None if rate2 == 0 else (omega / np.sqrt(rate2), np.cross(omega, v) / rate2)


def integrate_noisy(twist, noise, normal, tau=TAU):
    """(n, 4, 4): poses after samples of the twist, each with noise of its own.

    normal : (samples, n, 6), standard normal numbers. noise : PlanarNoise.
    """
    return reduce(np.matmul, se3.exp(tau * (twist + noise.sigmas * normal)))


def propagate(twist, noise, samples, tau=TAU):
    """The same as a Gaussian: `odometry.PoseBelief` after so many samples, from a pose known exactly."""
    belief = odometry.PoseBelief(np.eye(4), np.zeros((6, 6)))
    for _ in range(samples):
        belief = odometry.predict(belief, twist, tau, noise)
    return belief


def plane_ellipse(belief):
    """(n, 2): the 95 % ellipse of x and y that a Gaussian in x and y has, to first order."""
    A = belief.world_T_imu[:2, :3]
    return ellipse_points(belief.world_T_imu[:2, 3], A @ belief.covariance[:3, :3] @ A.T)


def banana(belief):
    """(n, 2): the 95 % ellipse of the exponential coordinates, carried through exp into x and y.

    The ellipse lives in the coordinates that move x and y; the others follow as their mean given these. In a
    plane this holds close to 95 % as long as the covariance itself, propagated to first order, is good.
    Source: Long, Wolfe, Mashner, Chirikjian, The banana distribution is Gaussian, 2012.
    """
    A = np.zeros((2, 6))
    A[:, :3] = belief.world_T_imu[:2, :3]
    plane = A @ belief.covariance @ A.T
    offsets = ellipse_points([0, 0], plane, n=120)
    epsilon = offsets @ np.linalg.solve(plane, A @ belief.covariance)
    return (belief.world_T_imu @ se3.exp(epsilon))[:, :2, 3]


class Motion:
    """A twist integrated: by Euler's method, with noise, and as a Gaussian.

    twist, samples, steps, sigma_omega : as the sliders have them. normal : (SAMPLES, n, 6), standard normal numbers.
    """

    def __init__(self, twist, samples, steps, sigma_omega, normal):
        self.twist, self.duration = np.array(twist), TAU * samples
        self.euler = euler(self.twist, self.duration, steps)
        noise = PlanarNoise(SIGMA_V, sigma_omega)
        self.ends = integrate_noisy(self.twist, noise, normal[:samples])[:, :2, 3]
        # However it bends, an arc of length L stays between -0.22 L and L ahead and within 0.73 L to the
        # sides, so the view need not move when omega does.
        speed = np.linalg.norm(self.twist[:3])
        self.reach = round_up(1.05 * max(speed * self.duration, 4 * SIGMA_V * self.duration), REACHES)
        self.centre = 0.4 * self.reach * self.twist[:3] / max(speed, 1e-9)
        belief = propagate(self.twist, noise, samples)
        self.banana, self.plane = banana(belief), plane_ellipse(belief)


class TwistPicture(Picture):
    """A frame moving along its screw, true and by Euler's method; where noise may put it, from above.

    seed : of the noise, drawn once, so that a slider changes the twist and not the luck.
    """

    name = "a twist integrated"
    size = (6.4, 4.3)
    controls = CONTROLS

    def __init__(self, seed=0):
        self.normal = np.random.default_rng(seed).standard_normal((SAMPLES, PARTICLES, 6))
        self.outcome = lru_cache(1)(self._outcome)  # picture and caption ask for the same
        super().__init__()

    def build(self):
        self.space = add_axes(self, (0.01, 0.06, 0.48, 0.72), "In space: the frame along its screw", xticks=[],
                              yticks=[], aspect="equal", adjustable="box")
        self.space.grid(False)
        self.space.spines[:].set_visible(False)
        self.ground, self.shadow, self.axis, self.triads = self.moves(*(
            self.space.add_collection(LineCollection([], **style), autolim=False) for style in (
                {"lw": 0.6, "color": "0.85"}, {"lw": 1.0, "color": "0.7", "label": "its shadow on z = 0"},
                {"lw": 1.2, "ls": "--", "color": COLOURS["smoother"], "label": "screw axis"}, {"lw": 2.0})))
        self.path = moving_line(self, self.space, "-", lw=1.6, color=COLOURS["truth"], label="exp")
        self.euler = moving_line(self, self.space, "o--", lw=1.4, ms=3.5, color=COLOURS["measured"], label="Euler")
        self.grid = self.figure.text(0.02, 0.02, "", fontsize=LETTERING, color="0.35")  # stays with the frame
        legend_above(self.space, [self.path, self.euler, self.axis, self.shadow], lines=2)

        self.above = add_axes(self, (0.58, 0.12, 0.4, 0.64), "From above: noise on v x, v y, ω z", "x (m)", "y (m)",
                              aspect="equal", adjustable="box")
        lines = [moving_line(self, self.above, form, color=colour, label=label, **style) for form, colour, label, style
                 in ((".", "0.55", f"{PARTICLES} noisy runs", {"ms": 2.5}),
                     ("-", COLOURS["truth"], "exp", {"lw": 1.2}),
                     ("--", COLOURS["slam"], "95 % in x, y", {"lw": 1.6}),
                     ("-", COLOURS["posterior"], "95 % in exp", {"lw": 1.8}))]
        self.cloud, self.mean_path, self.plane, self.banana = lines
        legend_above(self.above, lines, lines=2, x=-0.12)

    def _outcome(self, samples, steps, sigma_omega, **twist):
        """What there is to show, a `Motion`."""
        return Motion(list(twist.values()), samples, steps, sigma_omega, self.normal)

    def draw(self, **state):
        """Show the twist [v, omega] of the sliders integrated for so many samples of the IMU."""
        outcome = self.outcome(**state)
        self._draw_space(outcome)
        self._draw_ground(outcome)
        self._draw_above(outcome)

    def _draw_space(self, outcome):
        poses = se3.exp(np.linspace(0, outcome.duration, 80)[:, None] * outcome.twist)
        side = 1.48 * outcome.reach
        self.frame(self.space, VIEW @ outcome.centre, side / 2)
        self.path.set_data(*(poses[:, :3, 3] @ VIEW.T).T)
        self.euler.set_data(*(outcome.euler[:, :3, 3] @ VIEW.T).T)
        self.shadow.set_segments([poses[:, :3, 3] * [1, 1, 0] @ VIEW.T])
        frames = np.concatenate([se3.exp(np.linspace(0, outcome.duration, TRIADS)[:, None] * outcome.twist),
                                 outcome.euler[-1:]])
        tips = frames[:, :3, 3, None] + 0.09 * side * frames[:, :3, :3]  # (n, 3, axis)
        arms = np.stack([np.broadcast_to(frames[:, :3, 3, None], tips.shape), tips], axis=1)  # (n, end, 3, axis)
        self.triads.set_segments(np.moveaxis(arms, 3, 1).reshape(-1, 2, 3) @ VIEW.T)
        self.triads.set_color(AXIS_COLOURS * len(frames))
        axis = screw_axis(outcome.twist)
        self.axis.set_segments([] if axis is None else [
            (axis[1] + reach * axis[0]) @ VIEW.T for reach in 4 * side * np.array([[[-1], [1]]])])

    def _draw_ground(self, outcome):
        cell = outcome.reach / 5
        middle = np.round(outcome.centre[:2] / cell) * cell
        low, high = middle - 5 * cell, middle + 5 * cell
        xs, ys = (np.arange(a, b + cell / 2, cell) for a, b in zip(low, high))
        lines = [[(x, low[1], 0), (x, high[1], 0)] for x in xs] + [[(low[0], y, 0), (high[0], y, 0)] for y in ys]
        self.ground.set_segments(np.array(lines) @ VIEW.T)
        self.grid.set_text(f"squares of {cell:g} m; x red, y green, z blue")

    def _draw_above(self, outcome):
        self.banana.set_data(*outcome.banana.T)
        self.plane.set_data(*outcome.plane.T)
        self.cloud.set_data(*outcome.ends.T)
        path = se3.exp(np.linspace(0, outcome.duration, 60)[:, None] * outcome.twist)[:, :2, 3]
        self.mean_path.set_data(*path.T)
        self.frame(self.above, outcome.centre[:2], 0.78 * outcome.reach)

    def caption(self, **state):
        outcome = self.outcome(**state)
        end = outcome.euler[-1]
        off = np.linalg.norm(end[:3, 3] - se3.exp(outcome.duration * outcome.twist)[:3, 3])
        stretch = np.cbrt(np.linalg.det(end[:3, :3]))
        held = [Path(outline).contains_points(outcome.ends).mean() for outline in (outcome.banana, outcome.plane)]
        steps = "1 step" if state["steps"] == 1 else f"{state['steps']} steps"
        return (f"After {outcome.duration:.1f} s Euler with {steps} is {off:.2f} m off, its axes {stretch:.2f} times "
                f"as long. Of the noisy runs the outline in exp coordinates holds {100 * held[0]:.0f} %, the ellipse "
                f"in x and y {100 * held[1]:.0f} %.")

    def alt(self, **state):
        return ("A frame moving along its screw axis in space, with Euler's polygon beside it; from above, a cloud of "
                "noisy end positions, a curved 95 % outline from exponential coordinates and a straight 95 % ellipse. "
                + self.caption(**state))
