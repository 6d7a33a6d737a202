"""Oracles of the truth: an error-free strapdown, and flight mechanics."""

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.rotation import (
    euler_columns,
    inverse_columns,
    multiply_columns,
    rotate_columns,
)
from ahrs_service.simulation.phases import command_curves, flight_phases
from ahrs_service.simulation.trajectory import Bumps, fly

GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
SECONDS = 60.0
WIND = np.array([3.0, -2.0, 0.0])


def truth(rate_hz, wind=WIND, turbulence=1.0):
    dice = np.random.default_rng(11)
    curves = command_curves(flight_phases(SECONDS), turbulence, dice)
    time_s = np.arange(round(SECONDS * rate_hz) + 1) / rate_hz
    return fly(curves, Bumps.draw(dice), wind, 0.7, time_s)


@pytest.fixture(scope="module")
def smooth():
    return truth(200.0, wind=np.zeros(3), turbulence=0.0)


def attitude_error(rate_hz):
    """Largest angle between truth and the integral of the rates at interval middles [rad]."""
    fine = truth(2.0 * rate_hz)
    step = fine["rate_rad_s"][1::2] / rate_hz
    angle = np.linalg.norm(step, axis=1, keepdims=True)
    turns = np.concatenate([np.cos(angle / 2.0), np.sinc(angle / 2.0 / np.pi) * step / 2.0], axis=1)
    q = fine["ned_from_body"][:1]
    worst = 0.0
    for k, turn in enumerate(turns, start=1):
        q = multiply_columns(q, turn[None])
        error = multiply_columns(inverse_columns(q), fine["ned_from_body"][2 * k : 2 * k + 1])
        worst = max(worst, 2.0 * float(np.linalg.norm(error[0, 1:])))
    return worst


def velocity_error(rate_hz):
    """Largest distance of the velocity from the trapezoid sum of rotated force and gravity."""
    rows = truth(rate_hz)
    acceleration = rotate_columns(rows["ned_from_body"], rows["force_m_s2"]) + GRAVITY
    steps = 0.5 * (acceleration[1:] + acceleration[:-1]) / rate_hz
    velocity = rows["velocity_ned_m_s"][0] + np.cumsum(steps, axis=0)
    return float(np.abs(velocity - rows["velocity_ned_m_s"][1:]).max())


@pytest.mark.parametrize("error", [attitude_error, velocity_error])
def test_integrating_the_truth_gives_the_truth_at_second_order(error):
    coarse, middle, fine = error(50.0), error(100.0), error(200.0)
    assert np.log2(coarse / middle) == pytest.approx(2.0, abs=0.15)
    assert np.log2(middle / fine) == pytest.approx(2.0, abs=0.15)
    assert fine < 1e-3


def test_position_is_the_integral_of_velocity():
    """Simpson's rule over the velocity at twice the rate, of the same fourth order."""
    rows = truth(400.0)
    v = rows["velocity_ned_m_s"]
    steps = (v[:-2:2] + 4.0 * v[1::2] + v[2::2]) / 1200.0
    np.testing.assert_allclose(np.cumsum(steps, axis=0), rows["position_ned_m"][2::2], atol=1e-6)


def test_a_turn_has_no_lateral_force(smooth):
    in_air = smooth["airborne"] > 1.0 - 1e-12
    roll = euler_columns(smooth["ned_from_body"])[:, 0]
    assert np.degrees(roll[in_air].min()) < -35.0
    assert np.degrees(roll[in_air].max()) > 25.0
    assert np.abs(smooth["force_m_s2"][in_air, 1]).max() < 1e-9


def test_circling_has_its_centripetal_acceleration(smooth):
    """In the level part of the circle: a = V dpsi/dt across the path, and tan(roll) = a / g."""
    time_s, velocity = smooth["time_s"], smooth["velocity_ned_m_s"]
    begins = np.cumsum([0.0, *(phase.seconds for phase in flight_phases(SECONDS))])
    names = [phase.name for phase in flight_phases(SECONDS)]
    start = begins[names.index("circling")]
    steady = (time_s > start + 3.0) & (time_s < start + 7.0)
    acceleration = rotate_columns(smooth["ned_from_body"], smooth["force_m_s2"]) + GRAVITY
    heading = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    turn_rate = np.gradient(heading, time_s)[steady]
    speed = np.hypot(velocity[steady, 0], velocity[steady, 1])
    across = acceleration[steady, 1] * velocity[steady, 0]
    across = (across - acceleration[steady, 0] * velocity[steady, 1]) / speed
    roll = euler_columns(smooth["ned_from_body"])[steady, 0]
    np.testing.assert_allclose(across, speed * turn_rate, rtol=1e-3)
    np.testing.assert_allclose(np.tan(roll), across / STANDARD_GRAVITY_M_S2, rtol=0.01)
    assert np.abs(velocity[steady, 2]).max() < 0.3


def test_at_rest_there_is_gravity_alone(smooth):
    rest = smooth["time_s"] < 4.0
    assert np.abs(smooth["rate_rad_s"][rest]).max() < 1e-15
    assert np.abs(smooth["velocity_ned_m_s"][rest]).max() < 1e-15
    up = rotate_columns(smooth["ned_from_body"][rest], smooth["force_m_s2"][rest])
    np.testing.assert_allclose(up, np.tile(-GRAVITY, (rest.sum(), 1)), atol=1e-14)


def test_the_take_off_run_is_long_straight_and_rough(smooth):
    run = (smooth["time_s"] > 8.0) & (smooth["time_s"] < 11.5)
    force = smooth["force_m_s2"][run]
    assert force[:, 0].min() > 2.0
    assert np.std(force[:, 2]) > 0.3
    assert np.ptp(euler_columns(smooth["ned_from_body"])[run, 2]) < np.radians(1.0)
    assert np.abs(smooth["position_ned_m"][run, 2]).max() < 0.2
