"""Figures of chapter 16: what a real IMU's errors grow to, with and without bias states; each returns a Figure."""

import numpy as np

from ...plots import drawing, style


@style.styled
def correction_errors(changes, corrected, ignored):
    """Error of a preintegrated position after a change of bias, m. changes, corrected, ignored : (n,)."""
    figure, axes = drawing.new_figure(2.8)
    axes.loglog(changes, ignored, "--", color=style.COLOURS["report"], label="change ignored")
    axes.loglog(changes, corrected, color=style.COLOURS["invariant"], label="corrected to first order")
    axes.set(xlabel="change of the gyro's bias (rad/s)", ylabel="error of the position (m)",
             yticks=[1e-6, 1e-4, 1e-2, 1])
    order = np.polyfit(np.log(changes[:5]), np.log(corrected[:5]), 1)[0]
    return drawing.finish(figure, f"The error of the correction grows with the power {order:.1f} of the change")


@style.styled
def sigmas(times, position, yaw, tilt):
    """Standard deviations through time: position (T,) m, yaw and tilt (T,) rad."""
    figure, axes = drawing.new_figure(2.8)
    t = times - times[0]
    axes.plot(t, position, color=style.COLOURS["slam"], label="position (m)")
    axes.plot(t, np.degrees(yaw), "--", color=style.COLOURS["report"], label="yaw (°)")
    axes.plot(t, np.degrees(tilt), ":", color=style.COLOURS["invariant"], label="roll and pitch (°)")
    axes.set(xlabel="time since start (s)", ylabel="standard deviation", xlim=(0, t[-1]), yscale="log")
    third = len(t) // 3
    grown = [sigma[-1] / sigma[third] for sigma in (position, yaw, tilt)]
    return drawing.finish(figure, f"From {t[third]:.0f} s on position and yaw grow {grown[0]:.1f} and {grown[1]:.1f} "
                                  f"times, roll and pitch {grown[2]:.1f} times")
