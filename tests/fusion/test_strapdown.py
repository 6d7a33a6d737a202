"""Strapdown integration against analytic motion."""

import itertools
import math

import numpy as np
import pytest

from ahrs_service.fusion.strapdown import grow_covariance, rotate
from ahrs_service.rotation import inverse_columns, multiply_columns

CONE_RAD, CONE_RAD_S = 0.1, 2 * math.pi * 5.0


def cone(t):
    """Attitude of classical coning: an axis tilted by CONE_RAD goes round at CONE_RAD_S."""
    return np.stack(
        [
            np.full_like(t, math.cos(CONE_RAD / 2)),
            math.sin(CONE_RAD / 2) * np.cos(CONE_RAD_S * t),
            math.sin(CONE_RAD / 2) * np.sin(CONE_RAD_S * t),
            np.zeros_like(t),
        ],
        axis=-1,
    )


def cone_rate(t):
    """Body rates of that motion (Bortz 1971): 2 conj(q) dq/dt, worked out."""
    s = math.sin(CONE_RAD)
    return np.stack(
        [
            -s * CONE_RAD_S * np.sin(CONE_RAD_S * t),
            s * CONE_RAD_S * np.cos(CONE_RAD_S * t),
            np.full_like(t, -2 * CONE_RAD_S * math.sin(CONE_RAD / 2) ** 2),
        ],
        axis=-1,
    )


def test_the_oracle_agrees_with_its_own_derivative():
    t, h = np.array([0.0371]), 1e-6
    derivative = (cone(t + h) - cone(t - h)) / (2 * h)
    numeric = 2 * multiply_columns(inverse_columns(cone(t)), derivative)[:, 1:]
    np.testing.assert_allclose(numeric, cone_rate(t), rtol=1e-6, atol=1e-8)


def error_after_one_second(rate_hz):
    t = np.arange(int(rate_hz) + 1) / rate_hz
    rates, q = cone_rate(t), cone(t[:1])[0].copy()
    for before, after in itertools.pairwise(rates):
        rotate(q, before, after, 1.0 / rate_hz, 0.5)
    error = multiply_columns(inverse_columns(cone(t[-1:])), q[None])[0]
    return 2.0 * math.asin(min(1.0, float(np.linalg.norm(error[1:]))))


def test_coning_converges_with_second_order():
    errors = [error_after_one_second(rate) for rate in (100.0, 200.0, 400.0, 800.0)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > 1.9


def test_coning_at_200_hz_drifts_little():
    # 5 Hz coning of 5.7 deg is violent; trapezoid without the cross term gives 0.9 deg.
    assert math.degrees(error_after_one_second(200.0)) < 0.35


def test_constant_rate_is_exact():
    q = np.array([1.0, 0.0, 0.0, 0.0])
    rate = np.array([0.3, -0.2, 0.9])
    for _ in range(50):
        rotate(q, rate, rate, 0.2, 0.5)
    angle = 10.0 * np.linalg.norm(rate)
    expected = np.concatenate(
        [[math.cos(angle / 2)], math.sin(angle / 2) * rate / np.linalg.norm(rate)]
    )
    np.testing.assert_allclose(q, expected * np.sign(expected[0]), atol=1e-12)


def test_covariance_equals_the_matrix_form():
    rng = np.random.default_rng(1)
    square = rng.normal(size=(9, 9))
    p = square @ square.T
    rotation_s, impulse = 0.02 * rng.normal(size=(3, 3)), rng.normal(size=3)
    angle, bias, velocity = 2e-5, 3e-7, 4e-3
    by_bias, by_angle = np.eye(9), np.eye(9)
    by_bias[:3, 3:6] = -rotation_s
    # v' = v + psi x impulse.
    by_angle[6:, :3] = [
        [0.0, impulse[2], -impulse[1]],
        [-impulse[2], 0.0, impulse[0]],
        [impulse[1], -impulse[0], 0.0],
    ]
    transition = by_bias @ by_angle
    noise = np.diag([angle] * 3 + [bias] * 3 + [velocity] * 3)
    expected = transition @ p @ transition.T + noise
    grow_covariance(p, rotation_s, impulse, angle, bias, velocity)
    np.testing.assert_allclose(p, expected, rtol=1e-12)


@pytest.mark.parametrize("angle", [1e-9, 1e-5, 1.1e-4, 1e-2, 3.0])
def test_small_and_large_rotation_vectors_agree_with_the_formula(angle):
    q, zero = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    rotate(q, zero, np.array([2 * angle, 0.0, 0.0]), 1.0, 0.5)
    assert q[0] == pytest.approx(math.cos(angle / 2), abs=1e-15)
    assert q[1] == pytest.approx(math.sin(angle / 2), rel=1e-13)
