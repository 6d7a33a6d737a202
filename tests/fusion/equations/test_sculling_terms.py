"""The mean force and the rotation of an interval against a fine integration of the motion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ahrs_service.fusion import strapdown

RATE, RATE_SLOPE = np.array([0.7, -0.4, 0.9]), np.array([-3.0, 5.0, 2.0])
FORCE, FORCE_SLOPE = np.array([2.0, -3.0, -9.0]), np.array([30.0, 20.0, -40.0])
PARTS = 400


def exact(dt_s):
    """Rotation over an interval, and the mean force in the body axes at its end."""
    t = (np.arange(PARTS) + 0.5) * dt_s / PARTS
    steps = Rotation.from_rotvec((RATE + np.outer(t, RATE_SLOPE)) * dt_s / PARTS)
    turned, total = Rotation.identity(), np.zeros(3)
    for step, force in zip(steps, FORCE + np.outer(t, FORCE_SLOPE), strict=True):
        middle = turned * Rotation.from_rotvec(0.5 * step.as_rotvec())
        total += middle.apply(force) / PARTS
        turned = turned * step
    return turned, turned.inv().apply(total)


def mean(start, slope, from_s, to_s):
    return start + 0.5 * (from_s + to_s) * slope


def error_of_the_force(dt_s):
    """The means of both sensors over this interval and the one before."""
    rates = [mean(RATE, RATE_SLOPE, *span) for span in ((-dt_s, 0.0), (0.0, dt_s))]
    forces = [mean(FORCE, FORCE_SLOPE, *span) for span in ((-dt_s, 0.0), (0.0, dt_s))]
    out = np.empty(3)
    strapdown.mean_force(*rates, *forces, dt_s, out)
    return np.abs(out - exact(dt_s)[1])


def test_sculling_is_of_the_third_order_in_each_axis():
    """A term of the second order with a wrong sign would leave an error that only quarters."""
    coarse, fine = error_of_the_force(0.04), error_of_the_force(0.02)
    assert (fine < coarse / 6.0).all()
    assert fine.max() < 5e-4


@pytest.mark.parametrize("is_mean", [False, True])
def test_coning_is_of_the_fourth_order_about_each_axis(is_mean):
    """For a linearly changing rate only the fourth-order error remains: 1 / 16."""
    errors = []
    for dt_s in (0.08, 0.04):
        if is_mean:
            spans = [(-2.0 * dt_s, -dt_s), (-dt_s, 0.0), (0.0, dt_s)]
            rates = [mean(RATE, RATE_SLOPE, *span) for span in spans]
        else:
            rates = [RATE + t * RATE_SLOPE for t in (-dt_s, 0.0, dt_s)]
        q = np.array([1.0, 0.0, 0.0, 0.0])
        strapdown.rotate(q, *rates, dt_s, dt_s, is_mean)
        found = Rotation.from_quat(np.roll(q, -1))
        errors.append((found * exact(dt_s)[0].inv()).as_rotvec())
    coning = np.cross(RATE, RATE_SLOPE) * 0.04**3 / 12.0
    np.testing.assert_allclose(errors[1], 0.0, atol=0.1 * np.abs(coning).min())
    assert np.linalg.norm(errors[1]) < np.linalg.norm(errors[0]) / 10.0
