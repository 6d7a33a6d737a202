"""What samples and updates add to the covariance, against numbers worked out by hand."""

import math

import numpy as np
import pytest

from ahrs_service.fusion import mekf, propagation
from ahrs_service.fusion.states import ACCEL_BIAS, ERROR_STATES, GYRO_BIAS, VELOCITY, WIND
from ahrs_service.records import Flag
from tests.error_state import attitude, flying, matrix_of, stand
from tests.standing import WING, G, settings_of

TURN_S = 0.12


def level(rotvec=(0.0, 0.0, 0.0)):
    """At rest for long, nothing accumulated, all errors known."""
    state = flying(41)
    stand(state, attitude(rotvec))
    for name in ("covariance", "gyro_matrix", "gyro_bias_rad_s", "accel_bias_m_s2"):
        state[name] = 0.0
    for name in ("velocity_ned_m_s", "wind_ned_m_s", "smooth_rate_rad_s", "at_rest"):
        state[name] = 0.0
    propagation.begin_update(state)
    state["force_ned_m_s2"] = state["force_before_ned_m_s2"] = (0.0, 0.0, -G)
    return state


def test_half_of_what_the_rate_changes_is_not_known():
    """A change of 0.48 rad/s about one axis, evenly spread: 0.48^2 / 48.

    So even a change is no bend: three rates 0, 0.48, 0.96 in a row. Rates 0, 0.48, 0 bend by 0.96,
    of which 1 / 36 is assumed to be aliased vibration.
    """
    settings = settings_of(gyro_scale_error_rts=0.0)
    for last, expected in (
        (0.96, 0.48**2 / 48.0),
        (0.0, 0.48**2 / 48.0 + 0.96**2 / 36.0),
        (0.48, 0.48**2 / 36.0),
    ):
        state = level()
        state["rate_before_rad_s"], state["rate_rad_s"] = (0.0, 0.0, 0.0), (0.0, 0.48, 0.0)
        gyro, accel = np.array([0.0, last, 0.0]), np.array([0.0, 0.0, -G])
        propagation.move(settings, state, WING, gyro, accel, 0.01, 0)
        assert state["update_shake_variance"] == pytest.approx(expected * 1e-4)


def test_a_scale_error_grows_with_the_turn():
    settings = settings_of(gyro_scale_error_rts=0.01)
    state = level()
    gyro = np.array([2.0, 0.0, 1.0])
    propagation.move(settings, state, WING, gyro, np.array([0.0, 0.0, -G]), 0.02, 0)
    assert state["update_angle_variance"] == pytest.approx(1e-4 * 5.0 * 0.02)
    np.testing.assert_allclose(state["delta_angle_rad"], [0.04, 0.0, 0.02])


def test_the_rate_is_smoothed_and_its_derivative_is_what_moves_it():
    """0.5 s of smoothing: 0.1 s pull by 1 / 0.6 of the difference a second."""
    settings, state = settings_of(smoothing_s=0.5), level()
    state["smooth_rate_rad_s"] = (0.0, 0.0, 1.0)
    gyro = np.array([0.6, 0.0, 0.4])
    propagation.move(settings, state, WING, gyro, np.array([0.0, 0.0, -G]), 0.1, 0)
    np.testing.assert_allclose(state["angular_acceleration_rad_s2"], [1.0, 0.0, -1.0])
    np.testing.assert_allclose(state["smooth_rate_rad_s"], [0.1, 0.0, 0.9])


def test_the_force_is_averaged_where_gravity_stands_still():
    """Facing east, 3 m/s^2 forward is 3 east: a sixth of it in 0.1 s of 0.5."""
    settings, state = settings_of(smoothing_s=0.5), level((0.0, 0.0, 0.5 * math.pi))
    accel = np.array([3.0, 0.0, -G])
    propagation.move(settings, state, WING, np.zeros(3), accel, 0.1, 0)
    np.testing.assert_allclose(state["force_ned_m_s2"], [0.0, 0.5, -G], atol=1e-12)


@pytest.mark.parametrize("samples_are_means", [0, 1])
def test_at_rest_nothing_moves_and_what_falls_falls(samples_are_means):
    settings = settings_of(samples_are_means=samples_are_means)
    for accel, expected in (((0.0, 0.0, -G), 0.0), ((0.0, 0.0, 0.0), G * 0.01)):
        state = level()
        state["accel_before_m_s2"] = state["force_before_ned_m_s2"] = accel
        propagation.move(settings, state, WING, np.zeros(3), np.array(accel), 0.01, 0)
        np.testing.assert_allclose(state["velocity_ned_m_s"], [0.0, 0.0, expected], atol=1e-12)
        np.testing.assert_allclose(state["delta_velocity_m_s"], 0.01 * np.array(accel), atol=1e-12)


def test_what_shakes_makes_the_bias_walk_and_the_velocity_unsure():
    """From 0 to 2 m/s^2 forward: the mean is 1; 0.5 * 2^2 of vibration, 0.03^2 of it a second.

    norm(f) = 12: 5 % of the 2.19335 m/s^2 beyond g, and 0.4 m/s per root of a second.
    """
    settings = settings_of(
        samples_are_means=0,
        shaken_bias_walk_s_m_rts=0.03,
        velocity_noise_m_s_rts=0.4,
        accel_scale_error=0.05,
    )
    state = level()
    propagation.move(settings, state, WING, np.zeros(3), np.array([2.0, 0.0, -G]), 0.01, 0)
    assert state["velocity_ned_m_s"][0] == pytest.approx(0.01)
    assert state["update_bias_variance"] == pytest.approx(9e-4 * 2.0 * 0.01)
    state = level()
    state["force_before_ned_m_s2"] = (0.0, 0.0, -12.0)
    propagation.move(settings, state, WING, np.zeros(3), np.array([0.0, 0.0, -12.0]), 0.01, 0)
    excess2 = (0.05 * 2.19335) ** 2
    assert state["update_velocity_variance"] == pytest.approx((0.16 + excess2) * 0.01)
    state = level()
    state["at_rest"], state["force_variance"] = 1, 0.06
    propagation.move(settings, state, WING, np.zeros(3), np.array([0.0, 0.0, -G]), 0.01, 0)
    assert state["update_velocity_variance"] == pytest.approx(0.06 * 0.1 * 0.01)


def test_over_a_gap_any_rotation_and_flight_is_possible():
    """0.4 s: 1 rad/s and 3 m/s^2 all the time, not at random."""
    settings, state = settings_of(gyro_scale_error_rts=0.0), level()
    q = state["ned_from_body"].copy()
    accel = np.array([0.0, 0.0, -G])
    propagation.move(settings, state, WING, np.ones(3), accel, 0.4, int(Flag.GAP))
    assert state["update_angle_variance"] == pytest.approx(0.16)
    assert state["update_velocity_variance"] == pytest.approx(1.44)
    np.testing.assert_array_equal(state["ned_from_body"], q)


def test_an_axis_that_shows_nothing_is_unsure_by_the_square_of_its_time():
    """1 rad/s for 0.3 s, then 0.1 s more: from 0.09 to 0.16 rad^2 about that axis alone."""
    settings, state = settings_of(gyro_scale_error_rts=0.0), level()
    state["gyro_is_unobserved"], state["unobserved_s"] = (0, 1, 0), 0.3
    propagation.move(
        settings, state, WING, np.zeros(3), np.array([0.0, 0.0, -G]), 0.1, int(Flag.SATURATED)
    )
    np.testing.assert_allclose(state["unobserved_variance"], [0.0, 0.07, 0.0])
    assert state["unobserved_s"][1] == pytest.approx(0.4)


def grown(state, update_s=TURN_S, degc=math.nan, is_compensated=False, **given):
    quiet = {
        "gyro_noise_rad_s_rthz": 0.0,
        "gyro_bias_walk_rad_s2_rthz": 0.0,
        "gyro_bias_per_rtdegc_rad_s": 0.0,
        "compensated_bias_per_rtdegc_rad_s": 0.0,
    }
    state["update_s"] = update_s
    propagation.grow(settings_of(**{**quiet, **given}), state, degc, is_compensated)
    return state["covariance"]


def test_an_update_adds_the_noise_of_its_time():
    """Densities squared times 0.12 s; the bias and the wind walk, and the force's variance."""
    state = level()
    state["update_velocity_variance"], state["update_angle_variance"] = 0.3, 1e-4
    state["update_bias_variance"] = 2e-8
    p = grown(state, gyro_noise_rad_s_rthz=0.02, gyro_bias_walk_rad_s2_rthz=0.001)
    expected = np.zeros(ERROR_STATES)
    expected[:3] = 4e-4 * TURN_S + 1e-4
    expected[GYRO_BIAS : GYRO_BIAS + 3] = 1e-6 * TURN_S + 2e-8
    expected[VELOCITY : VELOCITY + 3] = 0.3
    expected[ACCEL_BIAS : ACCEL_BIAS + 3] = 1e-6 * TURN_S
    expected[WIND : WIND + 2] = 0.01 * TURN_S
    np.testing.assert_allclose(p, np.diag(expected), rtol=1e-12, atol=1e-18)


def test_of_noise_and_shake_the_larger_counts():
    state = level()
    state["update_shake_variance"] = 5e-4
    p = grown(state, gyro_noise_rad_s_rthz=0.02)
    np.testing.assert_allclose(np.diag(p)[:3], 5e-4)


@pytest.mark.parametrize("change", [4.0, -4.0])
def test_a_bias_grows_with_the_root_of_the_change_of_temperature(change):
    """0.003 rad/s per root of a degree, compensated 0.001: 9e-6 and 1e-6 times 4 degC."""
    for is_compensated, expected in ((False, 3.6e-5), (True, 4e-6)):
        state = level()
        state["update_degc"] = 30.0
        sizes = {
            "gyro_bias_per_rtdegc_rad_s": 0.003,
            "compensated_bias_per_rtdegc_rad_s": 0.001,
        }
        p = grown(state, degc=30.0 + change, is_compensated=is_compensated, **sizes)
        np.testing.assert_allclose(np.diag(p)[GYRO_BIAS : GYRO_BIAS + 3], expected)
        assert state["update_degc"] == 30.0 + change


def test_an_axis_not_known_widens_the_angle_about_where_it_points():
    """Right wing down by 30 deg and facing elsewhere: C e_y e_y' C'."""
    state = level((0.5, -0.3, 1.0))
    state["unobserved_variance"] = (0.0, 0.09, 0.0)
    axis = matrix_of(state["ned_from_body"])[:, 1]
    np.testing.assert_allclose(grown(state)[:3, :3], 0.09 * np.outer(axis, axis), atol=1e-12)


def test_an_attitude_that_is_not_known_at_all_stays_so():
    """Beyond pi^2 the row shrinks by the root; its covariances shrink in proportion."""
    state = level()
    p = state["covariance"]
    p[2, 2], p[2, 7], p[7, 2], p[7, 7] = 4.0 * math.pi**2, 6.0, 6.0, 8.0
    grown(state, update_s=1e-9)
    np.testing.assert_allclose(p[2:8:5, 2:8:5], [[math.pi**2, 3.0], [3.0, 8.0]], rtol=1e-6)


def test_the_larger_principal_variance_of_a_tilt_does_not_depend_on_where_north_is():
    """Variances 0.09 and 0.01 along axes rotated by any angle: 0.09."""
    for angle in (0.0, 0.4, 1.1, 2.0):
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, -s], [s, c]])
        p = np.zeros((3, 3))
        p[:2, :2] = turn @ np.diag([0.09, 0.01]) @ turn.T
        assert mekf.tilt_variance(p) == pytest.approx(0.09)
