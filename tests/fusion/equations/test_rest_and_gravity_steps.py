"""Rest, the scale of the force and the vertical, worked out by hand."""

import math

import numpy as np
import pytest

from ahrs_service.fusion import force_scale, gravity, zero_velocity
from ahrs_service.fusion.states import ACCEL_BIAS, AIDED, GYRO_BIAS, UNAIDED, VELOCITY
from ahrs_service.records import Gate, Phase
from tests.error_state import attitude, matrix_of, stand
from tests.standing import WING, G, settings_of, standing


def test_rest_is_followed_over_half_a_second():
    """0.1 s: weight 0.1 / 0.6 = 1/6 of the difference from the mean, after the mean has moved."""
    state = standing()
    state["mean_rate_rad_s"], state["rate_variance"], state["force_variance"] = 0.0, 6e-4, 0.012
    gyro, accel = np.array([0.06, 0.0, 0.0]), np.array([0.0, 0.3, -G])
    state["rate_rad_s"] = gyro
    zero_velocity.follow(state, gyro, accel, 0.1, 0.1)
    np.testing.assert_allclose(state["mean_rate_rad_s"], [0.01, 0.0, 0.0])
    np.testing.assert_allclose(state["mean_force_m_s2"], [0.0, 0.05, -G])
    # (0.05^2 - 6e-4) / 6 and (0.25^2 - 0.012) / 6 more.
    assert state["rate_variance"] == pytest.approx(6e-4 + 1.9e-3 / 6.0)
    assert state["force_variance"] == pytest.approx(0.012 + 0.0505 / 6.0)


@pytest.mark.parametrize(
    ("name", "value", "is_still"),
    [
        ("rate_rad_s", (0.09, 0.0, 0.0), True),
        ("rate_rad_s", (0.09, 0.09, 0.0), False),
        ("mean_force_m_s2", (0.0, 0.0, -G - 1.0), True),
        ("mean_force_m_s2", (0.0, 0.0, -G + 1.5), False),
        ("force_variance", 0.05, False),
        ("rate_variance", 0.05, False),
    ],
)
def test_what_turns_or_shakes_or_weighs_otherwise_is_not_still(name, value, is_still):
    state = standing()
    for one in ("mean_rate_rad_s", "rate_rad_s", "rate_variance", "force_variance"):
        state[one] = 0.0
    state["rest_s"], state[name] = 3.0, value
    felt = state["mean_force_m_s2"].copy()
    zero_velocity.follow(state, np.zeros(3), felt, 0.1, 0.1)
    assert state["rest_s"] == pytest.approx(3.1 if is_still else 0.0)


def test_between_rest_and_flight_lies_the_wind():
    """5 m/s along north and east, unless it is a state already."""
    for count, expected in ((UNAIDED, [25.0, 25.0, 0.0]), (AIDED, [0.0, 0.0, 0.0])):
        state = standing(count)
        state["rest_s"], state["at_rest"], state["tilt_innovation_rad"] = 2.0, 0, 0.0
        state["airspeed_time_ns"] = state["measured_time_ns"] = 0
        assert zero_velocity.come_to_rest(state)
        np.testing.assert_allclose(np.diag(state["covariance"])[VELOCITY:ACCEL_BIAS], expected)


@pytest.mark.parametrize(("speed", "rests"), [(0.59, True), (0.61, False), (-0.61, False)])
def test_what_is_known_to_move_by_three_sigmas_does_not_rest(speed, rests):
    """0.2 m/s, 1-sigma."""
    state = standing()
    state["rest_s"], state["at_rest"], state["tilt_innovation_rad"] = 2.0, 0, 0.0
    state["airspeed_time_ns"] = state["measured_time_ns"] = 0
    state["covariance"][VELOCITY + 1, VELOCITY + 1] = 0.04
    state["velocity_ned_m_s"][1] = speed
    assert zero_velocity.come_to_rest(state) == rests


@pytest.mark.parametrize(("tilt", "rests"), [(0.04, True), (0.07, False)])
def test_a_force_that_leans_by_three_sigmas_is_no_gravity(tilt, rests):
    """The larger principal variance and (0.1 / g)^2: 3 sqrt(3.96e-4 + 1.04e-4) = 0.067."""
    state = standing()
    state["rest_s"], state["at_rest"] = 2.0, 0
    state["airspeed_time_ns"] = state["measured_time_ns"] = 0
    state["covariance"][0, 0], state["covariance"][1, 1] = 1e-4, 3.96e-4
    state["tilt_innovation_rad"] = (0.0, tilt)
    assert zero_velocity.come_to_rest(state) == rests


def test_a_long_rest_that_shows_another_bias_doubts_it():
    """0.06 rad/s beyond a bias of 0.02, 1-sigma 0.01: 0.06^2 / 9 a second; 0.02 is within 3."""
    state = standing()
    state["rest_s"] = 6.0
    state["gyro_bias_rad_s"] = (0.02, 0.02, -0.02)
    state["mean_rate_rad_s"] = (0.08, 0.04, 0.0)
    for i in range(3):
        state["covariance"][GYRO_BIAS + i, GYRO_BIAS + i] = 1e-4
    zero_velocity.doubt_bias(state, 0.12)
    found = np.diag(state["covariance"])[GYRO_BIAS : GYRO_BIAS + 3]
    np.testing.assert_allclose(found, [1e-4 + 0.0036 / 9.0 * 0.12, 1e-4, 1e-4])


@pytest.mark.parametrize("shown", [1.05, 0.97])
def test_a_scale_is_found_by_how_much_of_gravity_is_shown(shown):
    """k = V / (V + (0.5 / g)^2 / 0.1) without vibration; a reading too large lowers the scale."""
    settings, state = settings_of(accel_bias_sigma_m_s2=0.0), standing()
    state["force_scale"], state["force_scale_variance"], state["at_rest"] = 1.1, 1.6e-3, 0
    state["force_variance"], state["smooth_rate_rad_s"] = 0.01, 0.0
    state["mean_force_m_s2"] = G * shown * np.array([0.6, 0.48, -0.64])
    force_scale.learn(settings, state, WING, 0.1)
    k = 1.6e-3 / (1.6e-3 + (0.5 / G) ** 2 * 10.0)
    change = 1.0 + k * (1.0 / shown - 1.0)
    assert state["force_scale"] == pytest.approx(1.1 * change, rel=1e-12)
    assert state["force_scale_variance"] == pytest.approx((1.0 - k) * 1.6e-3, rel=1e-12)
    np.testing.assert_allclose(
        state["mean_force_m_s2"], np.array([0.6, 0.48, -0.64]) * G * shown * change
    )
    # Without a prior no scale walks; with one of 0.03 it does by 0.025 of that, squared.
    other = standing()
    other["force_scale_variance"], other["force_variance"] = 1.6e-3, 9.0
    sized = settings_of(accel_scale_error=0.03, accel_bias_sigma_m_s2=0.1)
    force_scale.learn(sized, other, WING, 0.1)
    assert other["force_scale_variance"] == pytest.approx(1.6e-3 + (0.025 * 0.03) ** 2 * 0.1)


@pytest.mark.parametrize(("known", "kept"), [(1.2, 1.2), (0.8, 0.8), (1.3, 1.0), (0.7, 1.0)])
def test_a_scale_that_was_found_is_doubted_and_kept_if_it_can_be(known, kept):
    """Within 24 %; 1-sigma that of the class, 4 % at most."""
    for error, sigma in ((0.03, 0.03), (0.1, 0.04)):
        settings = settings_of(accel_scale_error=error, accel_bias_sigma_m_s2=0.2)
        state = standing()
        state["force_scale"] = known
        force_scale.start(settings, state, WING)
        assert state["force_scale"] == kept
        assert state["force_scale_variance"] == pytest.approx(sigma**2)


def test_the_gates_look_at_norms_and_at_the_tilt_in_its_sigmas():
    """f = (0.6, -0.8, -g - 1): leaning by 1 in 10.80665, east by 0.6 and north by 0.8 of that."""
    settings, state = settings_of(accel_noise_m_s2=0.3 * G, gate_innovation_sigma=0.1), standing()
    state["force_ned_m_s2"] = (0.6, -0.8, -G - 1.0)
    state["smooth_rate_rad_s"] = (0.02, 0.01, -0.02)
    state["angular_acceleration_rad_s2"] = (0.02, 0.03, 0.06)
    state["covariance"][0, 0], state["covariance"][1, 1] = 0.07, 0.01
    gravity.judge(settings, state, WING, 0.12, 0)
    angle = math.atan2(1.0, G + 1.0)
    norm = math.sqrt(1.0 + (G + 1.0) ** 2) - G
    # sqrt(0.07 + 0.09) = 0.4.
    np.testing.assert_allclose(state["gate_metrics"], [norm, 0.03, 0.07, angle / 0.4])
    np.testing.assert_allclose(state["tilt_innovation_rad"], [0.8 * angle, 0.6 * angle])


def test_a_tilt_that_steady_motion_contradicts_becomes_doubtful():
    """0.05 rad per root of a second."""
    settings = settings_of(accel_noise_m_s2=0.1, gate_innovation_sigma=3.0)
    state = standing()
    state["force_ned_m_s2"] = (0.6, 0.0, -G)
    state["smooth_rate_rad_s"] = state["angular_acceleration_rad_s2"] = 0.0
    state["covariance"][0, 0] = state["covariance"][1, 1] = 1e-4
    gravity.judge(settings, state, WING, 0.12, 0)
    assert state["gate"] == Gate.INNOVATION
    np.testing.assert_allclose(np.diag(state["covariance"])[:3], [4e-4, 4e-4, 0.0])


@pytest.mark.parametrize("stands", [(0.0, 0.0, 0.0), (0.5 * math.pi, 0.0, 0.0), (0.5, -0.3, 1.0)])
def test_gravity_corrects_the_tilt_by_how_long_it_was_averaged(stands):
    """(0.3 / g)^2, and of a slow turn 2 v^2 r / g^2, over 1 s of which 0.12 s were averaged.

    The turn is that about down: 0.02 rad/s, for any attitude and any other rotation of the body.
    Over ground (7, 4) m/s, of which the wind is (4, 0): 5 m/s.
    """
    settings, state = settings_of(accel_noise_m_s2=0.3), standing()
    stand(state, attitude(stands))
    state["smooth_rate_rad_s"] = matrix_of(state["ned_from_body"]).T @ [0.5, 0.7, -0.02]
    state["velocity_ned_m_s"], state["wind_ned_m_s"] = (7.0, 4.0, 9.0), (4.0, 0.0, 0.0)
    state["update_s"], state["gate"], state["tilt_innovation_rad"] = 0.12, 0, (0.01, -0.02)
    state["covariance"][0, 0] = state["covariance"][1, 1] = 1e-3
    gravity.correct(settings, state, WING, 0)
    variance = (0.09 + 2.0 * 0.02 * 25.0) / G**2 / 0.12
    np.testing.assert_allclose(
        state["correction"][:2], np.array([0.01, -0.02]) * 1e-3 / (1e-3 + variance), rtol=1e-9
    )


def test_while_it_aligns_what_the_norm_shows_counts_as_well():
    """A norm 0.4 m/s^2 off, a turn of 0.1 rad/s by a class that flies at 15 m/s: 0.16 + 2.25."""
    settings = settings_of(accel_noise_m_s2=0.3, forward_speed_m_s=15.0)
    state = standing()
    state["phase"], state["gate"], state["gate_metrics"] = Phase.ALIGNING, 1, (0.4, 0.1, 0.0, 0.0)
    state["smooth_rate_rad_s"], state["update_s"] = 0.0, 0.12
    state["tilt_innovation_rad"] = (0.01, -0.02)
    state["covariance"][0, 0] = state["covariance"][1, 1] = 1e-3
    gravity.correct(settings, state, WING, 0)
    variance = (0.09 + 0.16 + 2.25) / G**2 / 0.12
    assert state["correction"][0] == pytest.approx(0.01 * 1e-3 / (1e-3 + variance), rel=1e-9)
