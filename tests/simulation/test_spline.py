import numpy as np
import pytest

from ahrs_service.simulation.spline import UniformSpline

STEP_S = 0.2


def test_a_straight_line_stays_one():
    spline = UniformSpline(np.arange(40.0)[:, None] * 3.0 + 1.0, STEP_S)
    time_s = np.linspace(5 * STEP_S, 34 * STEP_S, 57)
    value, slope = spline.evaluate(time_s)
    np.testing.assert_allclose(value[:, 0], 3.0 * time_s / STEP_S + 1.0, rtol=1e-13)
    np.testing.assert_allclose(slope[:, 0], 3.0 / STEP_S, rtol=1e-12)


def test_a_constant_stays_exact_to_the_ends_and_beyond():
    value, slope = UniformSpline(np.full((9, 2), 7.0), STEP_S).evaluate(np.linspace(-1.0, 5.0, 61))
    np.testing.assert_allclose(value, 7.0, rtol=1e-15)
    np.testing.assert_allclose(slope, 0.0, atol=1e-12)


def test_a_single_point_spreads_as_the_cardinal_spline():
    """B_5 at its centre and its neighbours: 66, 26 and 1 parts of 120 (Schoenberg)."""
    control = np.zeros((21, 1))
    control[10] = 120.0
    value, _ = UniformSpline(control, STEP_S).evaluate(STEP_S * np.arange(6.0, 15.0))
    np.testing.assert_allclose(value[:, 0], [0, 0, 1, 26, 66, 26, 1, 0, 0], atol=1e-11)


@pytest.mark.parametrize("order", [2, 4])
def test_slopes_are_those_of_the_values(order):
    """Central differences of second and fourth order converge at their order."""
    control = np.random.default_rng(2).normal(size=(30, 1))
    spline = UniformSpline(control, STEP_S)
    time_s = np.linspace(2.013, 3.017, 11)

    def error(step):
        ahead, behind = spline.evaluate(time_s + step)[0], spline.evaluate(time_s - step)[0]
        difference = (ahead - behind) / (2.0 * step)
        if order == 4:
            far = spline.evaluate(time_s + 2 * step)[0] - spline.evaluate(time_s - 2 * step)[0]
            difference = (4.0 * difference - far / (4.0 * step)) / 3.0
        return np.abs(difference - spline.evaluate(time_s)[1]).max()

    assert np.log2(error(4e-3) / error(2e-3)) == pytest.approx(order, abs=0.4)
