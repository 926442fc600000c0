"""Exercise of notebook 08: read from an audit which axes of the IMU are turned round."""

import numpy as np

from ..checks.exercise import exercise


def _rates(rng):
    for correlations in ([0.9, -0.51, 0.49], [0.51, -0.49, -0.95], [-0.49, 0.3, 0.51], [0.95, 0.05, -0.05]):
        n = int(rng.integers(60, 120))
        gyro, seen = rng.normal(size=(2, n, 3))
        for i, r in enumerate(correlations):
            _, s, other = np.linalg.qr(np.column_stack([np.ones(n), seen[:, i], gyro[:, i]]))[0].T
            size, size_seen = n**0.5 * 10.0 ** rng.uniform(-2, 1, size=2)
            gyro[:, i] = size * (r * s + (1 - r**2)**0.5 * other) + rng.normal()
            seen[:, i] = size_seen * s + rng.normal()
        yield "random" if r != -0.05 else "two axes unrelated", (gyro, seen)


@exercise(chapter=8, cases=_rates, shows=[np.corrcoef], hints=[
    "A constant bias must not matter: correlate the two after subtracting the mean of each. Axis by axis.",
    "r = np.corrcoef(gyro[:, i], seen[:, i])[0, 1]; np.sign(r) where abs(r) > 0.5, else 0."])
def axis_signs(gyro, seen):
    """Which axes of a gyro are turned round, judged by what the cameras see.

    gyro : (n, 3), rad/s, measured. seen : (n, 3), rad/s, the rates that the cameras see, in the IMU frame, at the same
    times. Returns (3,): for each axis 1 where the correlation of the two is above 0.5, -1 where it is below -0.5 (the
    cure is to turn the axis round), and 0 where it is neither (nothing can be said). Both may have a constant offset.
    """
    signs = np.zeros(3)
    for i in range(3):
        r = np.corrcoef(gyro[:, i], seen[:, i])[0, 1]
        if abs(r) > 0.5:
            signs[i] = np.sign(r)
    return signs


axis_signs.slip("mean not subtracted", """A correlation is taken after the mean of each signal is subtracted; without it
    the bias of the gyro decides the sign.""",
    ("np.corrcoef(gyro[:, i], seen[:, i])[0, 1]",
     "gyro[:, i] @ seen[:, i] / (np.linalg.norm(gyro[:, i]) * np.linalg.norm(seen[:, i]))"))
axis_signs.slip("no threshold", "Where the correlation is small, chance decides its sign: return 0 there.",
    ("> 0.5", "> 0"))
axis_signs.slip("turned round", "1 says that an axis agrees with the cameras, -1 that it has to be turned round.",
    ("= np.sign(r)", "= -np.sign(r)"))
axis_signs.slip("threshold too low", "The threshold is 0.5.", ("0.5", "0.4"))
axis_signs.slip("threshold too high", """The threshold is 0.5, of the correlation r itself: r^2 is above 0.5 only from
    0.71 on.""", ("0.5", "0.7"))
axis_signs.slip("covariance in place of the correlation", """A covariance has a unit. Divide by both standard
    deviations: a correlation lies between -1 and 1.""", ("np.corrcoef", "np.cov"))
axis_signs.slip("slope in place of the correlation", """The slope of a line depends on the sizes of both signals. Divide
    by both standard deviations.""",
    ("np.corrcoef(gyro[:, i], seen[:, i])[0, 1]", "np.cov(gyro[:, i], seen[:, i])[0, 1] / np.var(seen[:, i], ddof=1)"))
axis_signs.slip("correlation returned", "Return its sign, 1 or -1, where its size is above 0.5, and 0 elsewhere.",
    ("if abs(r) > 0.5:\n            signs[i] = np.sign(r)", "signs[i] = r"))
axis_signs.slip("1 where nothing can be said", "Where the correlation is between -0.5 and 0.5, return 0.",
    ("np.zeros(3)", "np.ones(3)"))
