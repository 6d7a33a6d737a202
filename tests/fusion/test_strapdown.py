"""Strapdown integration against analytic motion."""

import math

import numpy as np
import pytest

from ahrs_service.fusion.strapdown import mean_force, rotate
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


def error_after_one_second(rate_hz, is_mean):
    """Angle [rad] by which the cone is missed, from instants or from means of the rate."""
    t = np.arange(int(rate_hz) + 2) / rate_hz
    rates, q = cone_rate(t), cone(t[1:2])[0].copy()
    if is_mean:
        half = 0.5 / rate_hz
        nodes = zip(*np.polynomial.legendre.leggauss(8), strict=True)
        rates = sum(w / 2 * cone_rate(t - half + x * half) for x, w in nodes)
    for earlier, before, last in zip(rates, rates[1:], rates[2:], strict=False):
        rotate(q, earlier, before, last, 1.0 / rate_hz, 1.0 / rate_hz, is_mean)
    error = multiply_columns(inverse_columns(cone(t[-1:])), q[None])[0]
    return 2.0 * math.asin(min(1.0, float(np.linalg.norm(error[1:]))))


@pytest.mark.parametrize(("is_mean", "order"), [(False, 2.9), (True, 4.9)])
def test_coning_converges_with_third_order_from_instants_and_fifth_from_means(is_mean, order):
    errors = [error_after_one_second(rate, is_mean) for rate in (100.0, 200.0, 400.0)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > order


@pytest.mark.parametrize(
    ("rate_hz", "is_mean", "limit_deg"),
    [(50.0, False, 0.1), (200.0, False, 2e-3), (50.0, True, 5e-3), (200.0, True, 3e-6)],
)
def test_coning_drifts_little(rate_hz, is_mean, limit_deg):
    # 5 Hz coning of 5.7 deg is violent: its axis drifts by 9 deg in that second.
    assert math.degrees(error_after_one_second(rate_hz, is_mean)) < limit_deg


@pytest.mark.parametrize("is_mean", [False, True])
@pytest.mark.parametrize("before_s", [0.0, 0.01, 0.2, 0.8])
def test_constant_rate_is_exact(is_mean, before_s):
    q = np.array([1.0, 0.0, 0.0, 0.0])
    rate = np.array([0.3, -0.2, 0.9])
    for _ in range(50):
        rotate(q, rate, rate, rate, before_s, 0.2, is_mean)
    angle = 10.0 * np.linalg.norm(rate)
    expected = np.concatenate(
        [[math.cos(angle / 2)], math.sin(angle / 2) * rate / np.linalg.norm(rate)]
    )
    np.testing.assert_allclose(q, expected * np.sign(expected[0]), atol=1e-12)


@pytest.mark.parametrize("before_s", [0.005, 0.01, 0.04])
def test_a_parabola_of_rate_is_exact_at_uneven_steps(before_s):
    """About one axis the rotation is the integral of the rate."""
    q, dt_s = np.array([1.0, 0.0, 0.0, 0.0]), 0.02
    polynomial = np.polynomial.Polynomial([0.4, -3.0, 50.0])
    rates = [np.array([0.0, polynomial(t), 0.0]) for t in (-before_s, 0.0, dt_s)]
    rotate(q, *rates, before_s, dt_s, False)
    assert 2.0 * math.asin(q[2]) == pytest.approx(polynomial.integ()(dt_s), rel=1e-13)


@pytest.mark.parametrize("before_s", [0.01, 0.02, 0.04])
@pytest.mark.parametrize("is_mean", [False, True])
def test_coning_is_of_the_right_size_at_uneven_steps(before_s, is_mean):
    """Savage 1998: a rate w + g t rotates by w dt + g dt^2 / 2 + (w x g) dt^3 / 12."""
    w, g, dt_s = np.array([0.3, 0.0, 0.0]), np.array([0.0, 4.0, 0.0]), 0.02
    ages = [-1.5 * before_s, -0.5 * before_s, 0.5 * dt_s] if is_mean else [-before_s, 0.0, dt_s]
    q = np.array([1.0, 0.0, 0.0, 0.0])
    rotate(q, *(w + g * age for age in ages), before_s, dt_s, is_mean)
    assert 2.0 * q[3] == pytest.approx(0.3 * 4.0 * dt_s**3 / 12.0, rel=1e-3)


def test_the_mean_force_of_a_body_that_turns_evenly_is_that_of_the_arc():
    rate, force, dt_s = np.array([0.0, 0.0, 2.0]), np.array([3.0, 0.0, -9.0]), 0.1
    out = np.empty(3)
    mean_force(rate, rate, force, force, dt_s, out)
    angle = 0.2
    arc = [3.0 * math.sin(angle) / angle, -3.0 * (1.0 - math.cos(angle)) / angle, -9.0]
    # The series ends at the third power of the angle.
    np.testing.assert_allclose(out, arc, atol=3.0 * angle**3 / 24.0 * 1.01)


@pytest.mark.parametrize("angle", [1e-9, 1e-5, 1.1e-4, 1e-2, 3.0])
def test_small_and_large_rotation_vectors_agree_with_the_formula(angle):
    q, zero = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    rotate(q, zero, zero, np.array([2 * angle, 0.0, 0.0]), 0.0, 1.0, False)
    assert q[0] == pytest.approx(math.cos(angle / 2), abs=1e-15)
    assert q[1] == pytest.approx(math.sin(angle / 2), rel=1e-13)
