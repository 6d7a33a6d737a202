"""The force of a body that the air pushes, against closed forms."""

import math

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.rotation import rotate_columns
from tests.benchmarks.ensemble.air_resistance import attitude_of_rate, pushed_force

STEP_S = 1e-3
DOWN = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])


def test_a_leaning_body_reaches_the_speed_at_which_drag_balances_gravity():
    """f = -g sin(lean) (1 - exp(-t / T)) along x: the speed is g sin(lean) T at last."""
    lean, drag_s, count = math.radians(10.0), 4.0, 20000
    still = np.zeros((count, 3))
    gravity = np.broadcast_to(
        [-DOWN[2] * math.sin(lean), 0.0, DOWN[2] * math.cos(lean)], (count, 3)
    )
    drag = np.broadcast_to([drag_s, 0.0, 0.0], (count, 3))
    force = pushed_force(still, still, drag, still, np.ascontiguousarray(gravity), STEP_S)
    grown = 1.0 - np.exp(-np.arange(count) * STEP_S / drag_s)
    np.testing.assert_allclose(force[:, 0], DOWN[2] * math.sin(lean) * grown, atol=2e-3)
    np.testing.assert_allclose(force[:, 2], -DOWN[2] * math.cos(lean))


def held(*vector):
    """The same vector [10, 3] at ten steps."""
    return np.tile(np.array(vector), (10, 1))


def test_a_commanded_turn_shows_its_centripetal_force():
    speed, rate, none = 15.0, 0.4, held(0.0, 0.0, 0.0)
    force = pushed_force(
        held(speed, 0.0, 0.0), none, none, held(0.0, 0.0, rate), held(*DOWN), STEP_S
    )
    np.testing.assert_allclose(force, held(0.0, speed * rate, -DOWN[2]), atol=1e-9)


def test_a_gust_from_the_side_pushes_by_its_share():
    none, drag_s = held(0.0, 0.0, 0.0), held(0.0, 1.5, 0.2)
    force = pushed_force(none, held(0.0, 3.0, 0.0), drag_s, none, held(*DOWN), STEP_S)
    np.testing.assert_allclose(force[0], [0.0, 2.0, -DOWN[2]])


def test_a_constant_rate_turns_by_its_angle():
    rate = np.array([0.3, -0.5, 0.2])
    attitude = attitude_of_rate(
        np.broadcast_to(rate, (1001, 3)).copy(), np.array([1.0, 0, 0, 0]), STEP_S
    )
    angle = np.linalg.norm(rate)
    expected = [math.cos(angle / 2), *(math.sin(angle / 2) * rate / angle)]
    np.testing.assert_allclose(attitude[-1], expected, atol=1e-12)
    assert rotate_columns(attitude[-1:], rate[None])[0] == pytest.approx(rate)
