"""What an audit found, to read, to draw, to hand on as JSON, and to cure."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import numpy as np

from .. import plots
from ..drive import Drive
from ..plots import style
from . import imu_alignment, imu_timing, track_health
from .cures import Cure
from .imu_alignment import Alignment
from .imu_timing import Timing
from .measured_noise import MeasuredNoise
from .visual_odometry import FrameMotions

FARTHEST = 3.0  # standard deviations
AXES = ("v_x", "v_y", "v_z", "gyro x", "gyro y", "gyro z")


@dataclass(frozen=True, eq=False)
class Finding:
    """One thing that is wrong with a recording.

    fault : its short name. size, unit : how large, a number or a list. p_value : how often a recording without
    the fault would look as bad (0 where no chance is involved, never below 1e-300 where it is). text : one
    sentence. cure : `Cure`, or None where the recording cannot tell which of its numbers is wrong. advice : what to
    do, one line. whole : the file as a whole is read wrongly (`whole`) or contradicts itself, so that a filter should
    not run on it as it is.
    """

    fault: str
    size: float | list
    unit: str
    p_value: float
    text: str
    cure: Cure | None
    advice: str
    whole: bool = False


    def __str__(self):
        certainty = f"p = {self.p_value:.0e}" if self.p_value > 1e-99 else "p < 1e-99" if self.p_value else "certain"
        return f"{self.fault}: {self.text} [{certainty}]\n    cure: {self.advice}"

    def to_dict(self) -> dict:
        return {"fault": self.fault, "size": self.size, "unit": self.unit, "p_value": self.p_value,
                "confidence": 1 - self.p_value, "text": self.text, "advice": self.advice,
                "cure": self.cure and self.cure.name, "needs_future": self.cure and self.cure.needs_future,
                "whole": self.whole}


@dataclass(frozen=True, eq=False)
class Report:
    """What `audit` found in one drive, and what it measured on the way.

    findings : worst things first to cure, in the order in which the cures must be applied.
    facts : measured numbers by name, whether there is anything wrong with them or not.
    signs : (6,) correlation of each IMU axis with the cameras by the extrinsics the file has; None like the next one
        where the cameras see too little to judge the IMU.
    alignment : what fits the IMU to the cameras best, cures of timing applied. noise : measured noise, from second
        differences of the IMU's samples where there is no alignment.
    timing : which sample fits which step, or None. motions : the cameras' motions.
    copy_steps : (T-1,) bool, steps that end in a copy frame. unjudged : what could not be judged and why, or "".
    """

    drive: Drive
    findings: tuple[Finding, ...]
    facts: dict
    signs: np.ndarray | None
    alignment: Alignment | None
    noise: MeasuredNoise
    timing: Timing | None
    motions: FrameMotions
    copy_steps: np.ndarray
    unjudged: str = ""

    def __contains__(self, fault: str) -> bool:
        return any(finding.fault == fault for finding in self.findings)

    def __getitem__(self, fault: str) -> Finding:
        """The finding of that name; KeyError when there is none."""
        for finding in self.findings:
            if finding.fault == fault:
                return finding
        raise KeyError(f"{fault!r} was not found; found: {', '.join(f.fault for f in self.findings) or 'nothing'}")

    def cured(self, *, needs_future=True) -> Drive:
        """The drive with the cure of every finding applied; without those that need the future, if so asked."""
        drive = self.drive
        for finding in self.findings:
            if finding.cure and (needs_future or not finding.cure.needs_future):
                drive = drive.apply(finding.cure)
        return drive

    @property
    def refusal(self) -> str:
        """Why no filter should run on this drive as it is, in one line; empty where nothing speaks against it."""
        return "; ".join(f"{finding.text} ({finding.advice})" for finding in self.findings if finding.whole)

    @property
    def too_far(self) -> str:
        """Why the fitted cures should not be applied: they move dead reckoning by more than it may be wrong; or "".

        Held against each other are way and turning, summed over the drive, in the IMU's frame. They may be wrong by the
        noise, by 0.02 rad/s of gyro bias and by 5 % of scale (one standard deviation each).
        """
        before, after = self.cured(needs_future=False), self.cured()
        tau, noise = before.taus[:, None], np.concatenate([self.noise.sigma_v, self.noise.sigma_omega])
        moved = (tau * (after.step_twists - before.step_twists)).sum(axis=0)
        variance = (tau**2 * noise**2).sum(axis=0) + np.repeat([0, (0.02 * before.duration) ** 2], 3)
        variance += (0.05 * (tau * np.abs(before.step_twists)).sum(axis=0)) ** 2
        if not (np.abs(moved) > FARTHEST * np.sqrt(variance)).any():
            return ""
        names = ", ".join(f.fault for f in self.findings if f.cure and f.cure.needs_future)
        return (f"the fitted cures ({names}) move dead reckoning by {np.linalg.norm(moved[:3]):.3g} m of way and "
                f"{np.degrees(np.linalg.norm(moved[3:])):.3g} deg of turning over the drive, more than its sensors can "
                "be wrong by: not applied (--force applies them)")

    def _verdict(self) -> str:
        judged = " in tracks and calibration" if len(self.drive.landmark) else " (no tracks)"
        found = f"{len(self.findings)} findings" if self.findings else "Nothing found" + (self.unjudged and judged)
        return found + (f"; not judged: {self.unjudged}" if self.unjudged else "") + "."

    def __str__(self):
        drive = self.drive
        lines = [f"Audit of {drive.name or 'a drive'}: {drive.n_frames} frames, {drive.duration:.1f} s, "
                 f"{drive.n_landmarks} tracks, {len(drive.landmark)} observations", ""]
        lines += [f"{name}: {_brief(value)}" for name, value in self.facts.items()]
        if self.alignment is not None and self.signs is not None:
            lines += ["", f"{'axis':8}{'correlation with the cameras':>30}{'noise':>12}",
                      f"{'':8}{'by the file':>15}{'at best':>15}{'per sample':>12}"]
            noise = np.concatenate([self.noise.sigma_v, self.noise.sigma_omega])
            for row in zip(AXES, self.signs, self.alignment.correlation, noise):
                lines.append("{:8}{:>+15.2f}{:>+15.2f}{:>12.3g}".format(*row))
            lines.append("(v in m/s, gyro in rad/s)")
        lines += ["", plots.on_a_page(self._verdict())]
        for i, finding in enumerate(self.findings, start=1):
            future = " (needs the whole drive)" if finding.cure and finding.cure.needs_future else ""
            lines.append(plots.on_a_page(f"{i}. {finding}{future}"))
        return "\n".join(lines)

    def to_dict(self) -> dict:
        """Plain numbers, strings, lists and dictionaries, for JSON."""
        alignment, noise = self.alignment, self.noise
        return {"name": self.drive.name, "frames": self.drive.n_frames, "tracks": self.drive.n_landmarks,
                "history": list(self.drive.history), "facts": self.facts,
                "findings": [finding.to_dict() for finding in self.findings], "unjudged": self.unjudged,
                "copy_frames": (np.flatnonzero(self.copy_steps) + 1).tolist(),
                "alignment": alignment and self.signs is not None and {
                    "imu_R_cam": alignment.imu_R_cam.tolist(),
                    "camera_in_imu_m": alignment.camera_in_imu.tolist(),
                    "camera_in_imu_sigma_m": alignment.sigma(imu_alignment.LEVER_ARM).tolist(),
                    "gyro_bias_rad_s": alignment.gyro_bias.tolist(),
                    "gyro_bias_sigma_rad_s": alignment.sigma(imu_alignment.GYRO_BIAS).tolist(),
                    "speed_scale": alignment.speed_scale, "gyro_scale": alignment.gyro_scale,
                    "correlation_by_the_file": dict(zip(AXES, self.signs.tolist())),
                    "correlation_at_best": dict(zip(AXES, alignment.correlation.tolist()))},
                "noise": {"sigma_v_m_s": noise.sigma_v.tolist(), "sigma_omega_rad_s": noise.sigma_omega.tolist(),
                          "sigma_px_rows": noise.sigma_px_rows, "sigma_px_flow": noise.sigma_px_flow}}

    @style.styled
    def figure(self):
        """A matplotlib Figure: gyro against cameras, timing, tracks in view with copy frames, disparities."""
        figure = style.Figure(figsize=(plots.WIDTH, 8), layout="constrained")
        since_start = self.drive.times - self.drive.times[0]
        axes = figure.subplots(3, 2)
        for i, ax in enumerate(axes[:, 0]):
            _draw_gyro(ax, i, since_start, self.alignment)
        _draw_timing(axes[0, 1], self.timing)
        _draw_tracks(axes[1, 1], since_start, self.drive, self.copy_steps)
        _draw_disparities(axes[2, 1], self.drive)
        found = ", ".join(finding.fault for finding in self.findings) or "nothing found"
        figure.suptitle(textwrap.fill(f"Audit of {self.drive.name or 'a drive'}: {found}", 66), fontsize=11)
        return figure


def _brief(value):
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, list):
        return ", ".join(_brief(item) for item in value)
    return str(value)


def _draw_gyro(ax, i, since_start, alignment):
    ax.set(title=f"{AXES[3 + i]}, in the IMU's own frame", xlabel="time since start (s)", ylabel="rate (rad/s)")
    if alignment is None:
        ax.text(0.5, 0.5, "cameras see too little", ha="center", transform=ax.transAxes)
        return
    at = since_start[alignment.steps]
    ax.plot(at, alignment.measured[:, 3 + i], ".", ms=2, color=style.COLOURS["measured"], label="IMU")
    ax.plot(at, alignment.predicted[:, 3 + i], lw=1, color=style.COLOURS["predicted"], label="cameras, best mounting")
    _legend_above_data(ax)


def _legend_above_data(ax):
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.35 * (high - low))
    ax.legend(loc="upper right", fontsize="small")


def _draw_timing(ax, timing):
    ax.set(title="which step does gyro sample k fit?", xlabel="offset s: sample k fits step k + s",
           ylabel="log likelihood, best is 0")
    if timing is not None:
        relative = timing.log_likelihood - timing.log_likelihood.max()
        ax.plot(imu_timing.OFFSETS, relative, "o-", ms=4, color=style.COLOURS["measured"])
    for offset, name in ((0, "k"), (-0.5, "mean"), (-1, "k+1")):
        ax.axvline(offset, lw=1, ls="--", color=style.COLOURS["expected"])
        ax.text(offset, 0.02, f" {name}", transform=ax.get_xaxis_transform(), rotation=90, fontsize="small")


def _draw_tracks(ax, since_start, drive, copy_steps):
    ax.plot(since_start, drive.visible, lw=1, color=style.COLOURS["prior"], label="tracks in view")
    copies = np.flatnonzero(copy_steps) + 1
    if copies.size:
        ax.plot(since_start[copies], drive.visible[copies], "|", ms=8, color=style.COLOURS["rejected"],
                label=f"{copies.size} copy frames")
    ax.set(title="tracks", xlabel="time since start (s)", ylabel="number in view", ylim=(0, None))
    _legend_above_data(ax)


def _draw_disparities(ax, drive):
    disparity = track_health.disparity(drive)
    low, high = np.percentile(disparity, [0.1, 99]) if disparity.size else (0, 0)
    ax.hist(disparity, bins=np.linspace(min(-3, low), max(3, high), 80), color=style.COLOURS["prior"])
    ax.axvline(0, lw=1.5, color=style.COLOURS["rejected"])
    ax.set(title="disparities (below zero: no such point)", xlabel="u_left - u_right (px)",
           ylabel="observations", yscale="log" if disparity.size else "linear")
