"""Exercises of notebook 06: is the claimed uncertainty true?"""

import numpy as np

from ... import metrics
from ...noise import Noise
from ..checks.exercise import exercise
from ..checks.inputs import random_covariance


def sensors(rng):
    yield "10 Hz", (0.5, 0.05, 0.1)
    for _ in range(4):
        yield "random", tuple(rng.uniform([0.1, 0.2, 0.05], [1.0, 1.0, 0.5]))


@exercise(chapter=6, cases=sensors, shows=[Noise.process_covariance, vars(Noise)["twist_covariance"].fget], hints=[
    "An error of the velocity that lasts tau seconds moves the pose by tau times itself. What does its variance do?",
    "tau^2 times diag(sigma_v^2 three times, sigma_omega^2 three times)."])
def process_noise(sigma_v, sigma_omega, tau):
    """W of one prediction step, from the noise of one IMU sample that drives the pose for tau seconds.

    sigma_v : m/s and sigma_omega : rad/s, standard deviation on each axis. tau : s.
    Returns (6, 6), order [position m^2, rotation rad^2], diagonal.
    """
    variances = [sigma_v**2] * 3 + [sigma_omega**2] * 3
    return tau**2 * np.diag(variances)


process_noise.slip("not scaled by tau", """This is the covariance of the twist. The pose drifts by tau times the error
    of the twist, so W carries tau^2. The report's W does not scale at all.""", ("tau**2 * ", ""))
process_noise.slip("tau instead of tau squared", """tau times a white sample has tau^2 times its variance. (A factor tau
    belongs to continuous noise given as a density, in m/s per root of Hz.)""", ("tau**2", "tau"))
process_noise.slip("sigmas not squared", "A covariance holds variances: sigma squared.", ("sigma_v**2", "sigma_v"),
    ("sigma_omega**2", "sigma_omega"))
process_noise.slip("order [omega, v]", "The twist is [v, omega]: the velocity's three entries come first.",
    ("[sigma_v**2] * 3 + [sigma_omega**2] * 3", "[sigma_omega**2] * 3 + [sigma_v**2] * 3"))
process_noise.slip("degrees", "sigma_omega is in rad/s already.", ("sigma_omega**2", "np.radians(sigma_omega)**2"))
process_noise.slip("velocity and rotation in turn", """The order is all three of the position, then all three of the
    rotation.""", ("[sigma_v**2] * 3 + [sigma_omega**2] * 3", "[sigma_v**2, sigma_omega**2] * 3"))


def errors(rng):
    yield "one number", (np.array([[2.0]]), np.array([[[4.0]]]))
    for _ in range(4):
        yield "random", (rng.normal(size=(5, 6)), np.array([random_covariance(rng, 6, 0.7) for _ in range(5)]))


@exercise(chapter=6, cases=errors, shows=[metrics.nees], hints=[
    "Squared error in units of the claimed standard deviation, correlations included: e^T P^-1 e, one number a row.",
    "np.sum(e * np.linalg.solve(P, e[..., None])[..., 0], axis=-1)"])
def nees(errors, covariances):
    """Normalised estimation error squared of each row: e^T P^-1 e.

    errors : (T, n), true minus estimated. covariances : (T, n, n), as the filter claims. Returns (T,).
    """
    values = []
    for k in range(len(errors)):
        e, P = errors[k], covariances[k]
        values.append(e @ np.linalg.inv(P) @ e)
    return np.array(values)


nees.slip("correlations ignored", """Dividing each squared error by its own variance forgets the off-diagonal entries:
    use the whole inverse, e^T P^-1 e.""", ("inv(P)", "inv(np.diag(np.diag(P)))"))
nees.slip("covariance not inverted", "e^T P e grows with the claimed uncertainty; the NEES shrinks with it: P^-1.",
    ("np.linalg.inv(P)", "P"))
nees.slip("square root taken", "This is the Mahalanobis distance; the NEES is its square.",
    ("np.array(values)", "np.sqrt(values)"))
nees.slip("divided by the degrees of freedom", """The NEES itself has mean n. Dividing by n is a way to plot it, but it
    then no longer follows the chi-square table.""", ("inv(P) @ e", "inv(P) @ e / len(e)"))
nees.slip("variance taken for standard deviation", """P holds variances: whiten with its Cholesky factor (or solve with
    P once), do not divide by P twice.""", ("e @ np.linalg.inv(P) @ e", "np.sum((np.linalg.inv(P) @ e)**2)"))


def bands(rng):
    import scipy.stats  # noqa: F401 - for the plain answer; here, because other chapters need not wait half a second

    yield "one run", (6, 1, 0.95)
    yield "random", (6, 50, 0.95)
    yield "rotation only", (3, 20, 0.99)
    yield "NIS", (4, 100, 0.9)


@exercise(chapter=6, cases=bands, shows=[metrics.chi2_band], outputs=("low", "high"), hints=[
    "The sum of N chi-square numbers of d degrees of freedom is chi-square with N d. You want the band of their mean.",
    "scipy.stats.chi2.ppf([tail, 1 - tail], dof * runs) / runs, with half of what the band leaves out in each tail."])
def chi2_band(dof, runs, probability):
    """Band in which the mean NEES of an honest filter lies, leaving equal tails.

    dof : degrees of freedom of one NEES. runs : how many independent runs are averaged. probability : of the band,
    0.95 say. Returns low and high. You may use `scipy.stats.chi2`.
    """
    from scipy.stats import chi2

    tail = (1 - probability) / 2
    low = chi2.ppf(tail, dof * runs) / runs
    high = chi2.ppf(1 - tail, dof * runs) / runs
    return low, high


chi2_band.slip("runs ignored", "A mean over runs scatters less than one run: N dof degrees of freedom, divided by N.",
    ("low = chi2.ppf(tail, dof * runs) / runs", "low = chi2.ppf(tail, dof)"),
    ("high = chi2.ppf(1 - tail, dof * runs) / runs", "high = chi2.ppf(1 - tail, dof)"))
chi2_band.slip("not divided by runs", "This is the band of the sum over runs; the mean is the sum divided by runs.",
    ("return low, high", "return low * runs, high * runs"))
chi2_band.slip("tails not halved", "A band of 95 % leaves 2.5 % on each side; this one leaves 5 % on each side.",
    (") / 2", ")"))
chi2_band.slip("one-sided", """A mean NEES that is too low is wrong as well (the filter wastes what it measured): leave
    half of the tail below.""", ("low = chi2.ppf(tail, dof * runs) / runs", "low = 0.0"),
    ("(1 - probability) / 2", "1 - probability"))
chi2_band.slip("normal approximation", """dof +- z sqrt(2 dof / N) is what the band tends to for many runs; for few it
    is lopsided. Use the chi-square quantiles.""",
    ("chi2\n", "chi2, norm\n"), ("return low, high",
     "half = norm.ppf((1 + probability) / 2) * np.sqrt(2 * dof / runs)\n    return dof - half, dof + half"))
chi2_band.slip("degrees of freedom and runs added", """The sum of N numbers with dof degrees of freedom each has N dof
    of them.""", ("chi2.ppf(tail, dof * runs)", "chi2.ppf(tail, dof + runs)"),
    ("chi2.ppf(1 - tail, dof * runs)", "chi2.ppf(1 - tail, dof + runs)"))
chi2_band.slip("always 95 %", "The probability is an argument.", ("1 - probability", "1 - 0.95"))
