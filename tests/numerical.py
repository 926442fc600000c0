"""Derivatives that need no formula, to hold Jacobians against."""

import numpy as np


def central_difference(function, size, step=1e-4):
    """Derivative at zero of a function of a vector (size,), whose values are (..., m): (..., m, size).

    Five points, so that truncation falls with the fourth power of the step.
    """

    def along(e):
        near, far = function(step * e) - function(-step * e), function(2 * step * e) - function(-2 * step * e)
        return (8 * near - far) / (12 * step)

    return np.stack([along(e) for e in np.eye(size)], axis=-1)
