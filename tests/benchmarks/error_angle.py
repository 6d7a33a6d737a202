"""The error angle that the filter's covariance is about."""

import numpy as np

from ahrs_service.records import Floats
from ahrs_service.rotation import inverse_columns, multiply_columns


def error_angle(truth: Floats, estimate: Floats, axes: int) -> Floats:
    """Rotation vectors psi [K, 3] with truth = dq(psi) estimate; six axes: without the heading.

    dq is parted into a turn about down, which six axes cannot know, and a tilt before it.
    """
    error = multiply_columns(truth, inverse_columns(estimate))
    if axes == 6:
        turn = error * np.array([1.0, 0.0, 0.0, 1.0])
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        error = multiply_columns(inverse_columns(turn), error)
    error *= np.where(error[:, :1] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(error[:, 1:], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, error[:, :1])
    return error[:, 1:] * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
