"""Window means and integrals up to them, against numpy's sums."""

import numpy as np

from ahrs_service.diagnosis.input.windows import integral_means, means
from ahrs_service.rotation import rotate_columns

COUNT, WINDOW = 103, 5


def by_reshape(values):
    cut = values[: len(values) // WINDOW * WINDOW]
    return cut.reshape(-1, WINDOW, *values.shape[1:]).mean(axis=1)


def test_means_are_those_of_a_reshape_and_leave_out_the_rest():
    rng = np.random.default_rng(1)
    for shape in ((COUNT,), (COUNT, 3), (COUNT, 3, 3)):
        values = rng.normal(size=shape)
        np.testing.assert_allclose(means(values, WINDOW), by_reshape(values), atol=1e-14)


def test_the_integral_is_the_corrected_trapezoid_sum_in_earth_axes():
    rng = np.random.default_rng(2)
    q = rng.normal(size=(COUNT, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    added, steps_s = rng.normal(size=(COUNT, 3)), rng.uniform(0.01, 0.03, COUNT - 1)
    axes = [rotate_columns(q, np.broadcast_to(axis, (COUNT, 3))) for axis in np.eye(3)]
    ned = rotate_columns(q, added)
    pieces = 0.5 * (ned[1:] + ned[:-1]) * steps_s[:, None]
    slopes = (ned[2:] - ned[:-2]) / (steps_s[1:] + steps_s[:-1])[:, None]
    pieces[1:-1] -= np.diff(slopes, axis=0) * steps_s[1:-1, None] ** 2 / 12.0
    gathered = np.vstack([np.zeros((1, 3)), np.cumsum(pieces, axis=0)])
    found = integral_means(np.stack(axes, axis=2).copy(), added, steps_s, WINDOW)
    np.testing.assert_allclose(found, by_reshape(gathered), atol=1e-13)
    found = integral_means(np.stack(axes, axis=2).copy(), added, steps_s, WINDOW, 3)
    np.testing.assert_allclose(found, by_reshape(gathered[::3]), atol=1e-13)


def gathering_error(step_s):
    """Error of the integral of a swing of 2 Hz from 0.1 to 0.46 s."""
    time_s = np.arange(0.0, 1.0 + step_s / 2.0, step_s)
    added = np.zeros((len(time_s), 3))
    added[:, 0] = np.cos(4.0 * np.pi * time_s)
    axes = np.tile(np.eye(3), (len(time_s), 1, 1))
    integral = integral_means(axes, added, np.diff(time_s), 1)[:, 0]
    first, last = (round(at / step_s) for at in (0.1, 0.46))
    exact = np.sin(4.0 * np.pi * time_s) / (4.0 * np.pi)
    return abs((integral[last] - integral[first]) - (exact[last] - exact[first]))


def test_the_integral_converges_with_the_fourth_power_of_the_step():
    coarse, fine = gathering_error(0.02), gathering_error(0.01)
    assert coarse < 1e-4
    assert 14.0 < coarse / fine < 18.0
