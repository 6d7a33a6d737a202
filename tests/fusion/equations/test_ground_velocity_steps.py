"""Wind added and removed, a heading from velocity changes, and the stored velocities."""

import math

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.fusion import ground_velocity, heading, mekf, timebase
from ahrs_service.fusion.states import AIDED, ANGLE, ERROR_STATES, LAG, UNAIDED, VELOCITY, WIND
from ahrs_service.records import SAMPLE_DTYPE, Airframe, empty
from ahrs_service.settings import Settings
from tests.error_state import attitude, flying, stand

SETTINGS = pipeline.parameters(Settings())[0]


@pytest.mark.parametrize("at_rest", [0, 1])
def test_velocity_over_ground_is_that_through_the_air_and_the_wind(at_rest):
    """In flight v = v_air + wind, 5 m/s of it unknown; at rest the velocity was over ground."""
    state = flying(21, UNAIDED)
    state["at_rest"] = at_rest
    before = state["covariance"].copy()
    ground_velocity._begin(state, 0.0)
    known = before.copy()
    known[WIND, WIND] = known[WIND + 1, WIND + 1] = 25.0
    known[LAG, LAG] = 0.15**2
    joined = np.eye(ERROR_STATES)
    if not at_rest:
        joined[VELOCITY, WIND] = joined[VELOCITY + 1, WIND + 1] = 1.0
    np.testing.assert_allclose(state["covariance"], joined @ known @ joined.T, atol=1e-12)
    assert state["states"] == AIDED


def test_let_go_the_velocity_is_the_one_through_the_air():
    state = flying(22, AIDED)
    state["velocity_ned_m_s"], state["wind_ned_m_s"] = (10.0, 4.0, 1.0), (3.0, -2.0, 0.0)
    state["history_m_s"] = 7.0
    before = state["covariance"].copy()
    ground_velocity._let_go(state)
    parted = np.eye(ERROR_STATES)
    parted[VELOCITY, WIND] = parted[VELOCITY + 1, WIND + 1] = -1.0
    parted[UNAIDED:] = 0.0
    np.testing.assert_allclose(state["covariance"], parted @ before @ parted.T, atol=1e-12)
    np.testing.assert_allclose(state["velocity_ned_m_s"], [7.0, 6.0, 1.0])
    np.testing.assert_allclose(state["history_m_s"][:, 0], [4.0, 9.0, 7.0])
    np.testing.assert_array_equal(state["wind_ned_m_s"], 0.0)


def test_a_heading_that_must_be_wrong_takes_its_corrections_along():
    """What is to be corrected of velocity and wind is one of the velocity through the air."""
    state = flying(23, AIDED)
    state["velocity_nis"] = 40.0
    state["correction"][VELOCITY : VELOCITY + 2] = (0.5, 0.7)
    state["correction"][WIND : WIND + 2] = (0.2, -0.1)
    state["correction"][LAG] = 0.1
    state["measured_velocity_m_s"] = np.nan
    p = state["covariance"][:2, :2].copy()
    ground_velocity._take(state, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    np.testing.assert_allclose(state["correction"][VELOCITY : VELOCITY + 2], [0.3, 0.8])
    np.testing.assert_array_equal(state["correction"][WIND:], 0.0)
    assert (state["states"], state["heading_source"]) == (UNAIDED, heading.NONE)
    assert state["covariance"][2, 2] == pytest.approx(math.pi**2)
    np.testing.assert_allclose(np.diag(state["covariance"])[:2], np.diag(p) + 0.09)


def flown(state, seconds, ours, measured, airframe):
    """Fly for some seconds with our velocity [2] of the time and one measured at each second."""
    for n in range(round(seconds / 0.12)):
        t = n * 0.12
        state["time_ns"] = 10**10 + round(t * 1e9)
        state["velocity_ned_m_s"][:2] = ours(t)
        ground_velocity.remember(state)
        if n % 8 == 0 and n > 0:
            state["measured_velocity_m_s"][:2] = measured(t)
            state["measured_time_ns"], state["measured_new"] = state["time_ns"], 1
        ground_velocity.correct_velocity(SETTINGS, state, airframe)
        if state["states"] == AIDED:
            return t
    return None


def unknown_heading():
    """Level, estimated heading 17 deg off north; no heading source."""
    state = flying(24, UNAIDED, sigma=1e-3)
    stand(state, attitude([0.0, 0.0, 0.3]))
    state["velocity_lag_s"], state["measured_time_ns"] = 1e-9, 0
    for name in ("match", "matched_time_ns", "history_time_ns", "course_doubted"):
        state[name] = 0
    state["covariance"][ANGLE + 2, ANGLE + 2] = 9.0
    return state


@pytest.mark.parametrize("turned", [0.8, -2.0])
def test_a_heading_is_the_rotation_of_the_measured_changes_against_ours(turned):
    """Constant wind has no influence; all rotates to where the changes agree."""
    state = unknown_heading()
    c, s = math.cos(turned), math.sin(turned)

    def ours(t):
        return 10.0 * np.array([math.cos(0.6 * t), math.sin(0.6 * t)])

    def measured(t):
        north, east = ours(t)
        return np.array([c * north - s * east + 4.0, s * north + c * east - 3.0])

    at_s = flown(state, 20.0, ours, measured, Airframe.OTHER)
    assert at_s is not None
    yaw = math.atan2(state["dcm"][1, 0], state["dcm"][0, 0])
    assert math.remainder(yaw - (0.3 + turned), 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)
    expected = measured(at_s) - [4.0, -3.0]
    np.testing.assert_allclose(state["velocity_ned_m_s"][:2], expected, atol=1e-5)
    assert state["covariance"][2, 2] == pytest.approx(0.09)
    assert state["heading_source"] == heading.VELOCITY


def test_changes_are_forgotten_over_a_minute():
    """Two changes of 2 m/s north against ours of 1: (2 + 2 exp(-1 / 60)) exp(-1 / 60), to rounding.

    Then 3 m/s to the east against ours of 1 north: a quarter turn to the right, +3.
    """
    state = unknown_heading()
    state["measured_time_ns"] = 10**10
    for n, (measured, ours) in enumerate([((0, 0), (0, 0)), ((2, 0), (1, 0)), ((4, 0), (2, 0))]):
        state["measured_velocity_m_s"][:2] = measured
        state["measured_time_ns"] = 10**10 + n * 10**9
        ground_velocity._match(state, (*ours, 0.0))
    kept = math.exp(-1.0 / 60.0)
    common = 2.0 * kept * (1.0 + kept)
    count = kept * (1.0 + kept)
    np.testing.assert_allclose(state["match"], [common, 0.0, 2.0 * common, 0.5 * common, count])
    state["measured_velocity_m_s"][:2] = (4.0, 3.0)
    state["measured_time_ns"] += 10**9
    ground_velocity._match(state, (3.0, 0.0, 0.0))
    assert state["match"][0] == pytest.approx(kept * common)
    assert state["match"][1] == pytest.approx(kept * 3.0)


@pytest.mark.parametrize(
    ("north", "east", "yaw"), [(0.0, 15.0, 0.5 * math.pi), (-9.0, -9.0, -0.75 * math.pi)]
)
def test_a_fixed_wing_points_about_where_it_flies(north, east, yaw):
    state = unknown_heading()
    ours, measured = np.array([12.0, 0.0]), np.array([north, east])
    at_s = flown(state, 20.0, lambda _: ours, lambda _: measured, Airframe.FIXED_WING)
    assert at_s is not None
    found = math.atan2(state["dcm"][1, 0], state["dcm"][0, 0])
    assert math.remainder(found - yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-4)
    assert state["covariance"][2, 2] == pytest.approx(0.35**2)


@pytest.mark.parametrize(("common", "is_reported"), [(99.4, True), (95.0, False)])
def test_a_heading_is_reported_where_the_changes_share_enough(common, is_reported):
    """(1 - r^2) / (2 n r^2) below 0.1^2: of 5 changes r^2 above 1 / 1.1 = 0.909, r above 0.9535."""
    state = unknown_heading()
    for scale in (1.0, 0.97):
        state = unknown_heading()
        state["match"] = (0.0, common * scale, 100.0, 100.0, 5.0)
        ground_velocity._begin_if_it_agrees(state, Airframe.OTHER)
        # 99.4 and 96.4 of 100 are accepted; 95 and 92 are not.
        assert (state["states"] == AIDED) == is_reported


def test_changes_that_are_not_ours_are_not_used():
    """60 + 60 - 2 * 30 = 60 m^2/s^2 left of 6 changes: 10 each, beyond 2^2."""
    state = unknown_heading()
    state["match"] = (30.0, 0.0, 60.0, 60.0, 6.0)
    state["measured_velocity_m_s"] = (15.0, 0.0, 0.0)
    ground_velocity._begin_if_it_agrees(state, Airframe.FIXED_WING)
    assert state["states"] == UNAIDED


def test_pending_corrections_rotate_to_the_heading_found():
    """A quarter to the right: a correction to the north becomes one to the east."""
    state = unknown_heading()
    mekf.settle(state)
    state["correction"][:3] = (0.01, 0.02, 0.5)
    state["correction"][VELOCITY : VELOCITY + 3] = (3.0, 4.0, 5.0)
    ground_velocity._rotate_heading(state, 0.5 * math.pi, 0.3)
    np.testing.assert_allclose(state["correction"][:3], [-0.02, 0.01, 0.0], atol=1e-15)
    found = state["correction"][VELOCITY : VELOCITY + 3]
    np.testing.assert_allclose(found, [-4.0, 3.0, 5.0], atol=1e-12)


def test_what_is_remembered_is_corrected_as_the_present_velocity():
    state = unknown_heading()
    state["history_m_s"] = 1.0
    state["correction"][VELOCITY : VELOCITY + 3] = (0.5, -0.25, 2.0)
    ground_velocity.shift_history(state)
    np.testing.assert_allclose(state["history_m_s"][:, 5], [1.5, 0.75, 3.0])


def test_between_two_updates_the_velocity_is_that_of_the_time_between():
    """From 2 m/s at 10.00 s to 6 at 10.12: 30 ms after the first it is 3 m/s."""
    state = unknown_heading()
    for time_ns, north in ((10 * 10**9, 2.0), (10_120_000_000, 6.0), (10_240_000_000, 0.0)):
        state["time_ns"], state["velocity_ned_m_s"] = time_ns, (north, 0.0, 0.0)
        ground_velocity.remember(state)
    is_known, then = ground_velocity._velocity_at(state, 10_030_000_000)
    assert is_known
    assert then == pytest.approx((3.0, 0.0, 0.0))
    assert not ground_velocity._velocity_at(state, 9_990_000_000)[0]


@pytest.mark.parametrize(
    ("later_ns", "is_new"), [(149_000_000, 0), (151_000_000, 1), (-(10**9), 1)]
)
def test_what_comes_within_150_ms_shares_the_error_of_the_last(later_ns, is_new):
    """A clock that was set back by a second brings a new one."""
    state, sample = unknown_heading(), empty(SAMPLE_DTYPE)[0]
    state["measured_time_ns"], state["measured_new"] = 50 * 10**9, 0
    state["measured_velocity_m_s"] = 0.0
    sample["time_ns"], sample["velocity_ned_m_s"] = 50 * 10**9 + later_ns, (3.0, 4.0, np.nan)
    ground_velocity.hear_velocity(state, sample)
    assert state["measured_new"] == is_new
    assert state["measured_velocity_m_s"][1] == 4.0 * is_new


def test_the_usual_step_follows_by_a_twentieth_of_what_it_is_off():
    """From 10 ms to 14 by 0.2 ms; a step of 100 ms counts as three usual ones, 30: 1 ms."""
    for step_s, expected_s in ((0.014, 0.0102), (0.1, 0.011), (0.006, 0.0098)):
        state = unknown_heading()
        state["interval_s"] = 0.01
        timebase._follow_interval(state, step_s)
        assert state["interval_s"] == pytest.approx(expected_s)
