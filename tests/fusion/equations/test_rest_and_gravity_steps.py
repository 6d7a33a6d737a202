"""Rest, the scale of the force, the vertical and the first attitude, by numbers and finite steps."""

import math

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.fusion import alignment, force_scale, gravity, plausibility, zero_velocity
from ahrs_service.fusion.states import (
    ACCEL_BIAS,
    AIDED,
    ERROR_STATES,
    GYRO_BIAS,
    UNAIDED,
    VELOCITY,
)
from ahrs_service.records import SAMPLE_DTYPE, Airframe, Flag, Gate, Phase, empty
from ahrs_service.settings import Settings
from tests.error_state import attitude, flying, matrix_of, moved, stand, update

G = 9.80665
WING = int(Airframe.FIXED_WING)


def settings_of(**given):
    settings = pipeline.parameters(Settings())[0]
    for name, value in given.items():
        if settings[name].shape:
            settings[name][:] = value
        else:
            settings[name] = value
    return settings


def standing(count=UNAIDED):
    """Level and at rest, every variance zero."""
    state = flying(51, count)
    stand(state, attitude([0.0, 0.0, 0.0]))
    for name in ("covariance", "velocity_ned_m_s", "wind_ned_m_s", "gyro_bias_rad_s"):
        state[name] = 0.0
    state["force_ned_m_s2"] = state["mean_force_m_s2"] = (0.0, 0.0, -G)
    state["time_ns"] = 60 * 10**9
    return state


def test_rest_is_followed_over_half_a_second():
    """0.1 s: weight 0.1 / 0.6 = 1/6 of what differs from the mean, after the mean has moved."""
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
    """k = V / (V + (0.5 / g)^2 / 0.1) where nothing shakes; too much shown, the scale goes down."""
    settings, state = settings_of(accel_bias_sigma_m_s2=0.0), standing()
    state["force_scale"], state["force_scale_variance"], state["at_rest"] = 1.1, 1.6e-3, 0
    state["force_variance"], state["smooth_rate_rad_s"] = 0.01, 0.0
    state["mean_force_m_s2"] = (0.6 * G * shown, 0.0, -0.8 * G * shown)
    force_scale.learn(settings, state, WING, 0.1)
    k = 1.6e-3 / (1.6e-3 + (0.5 / G) ** 2 * 10.0)
    change = 1.0 + k * (1.0 / shown - 1.0)
    assert state["force_scale"] == pytest.approx(1.1 * change, rel=1e-12)
    assert state["force_scale_variance"] == pytest.approx((1.0 - k) * 1.6e-3, rel=1e-12)
    np.testing.assert_allclose(
        state["mean_force_m_s2"], np.array([0.6, 0.0, -0.8]) * G * shown * change
    )
    # Without a prior no scale walks; with one of 0.03 it does by 0.025 of that, squared.
    other = standing()
    other["force_scale_variance"], other["force_variance"] = 1.6e-3, 9.0
    sized = settings_of(accel_scale_error=0.03, accel_bias_sigma_m_s2=0.1)
    force_scale.learn(sized, other, WING, 0.1)
    assert other["force_scale_variance"] == pytest.approx(1.6e-3 + (0.025 * 0.03) ** 2 * 0.1)


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


def test_gravity_corrects_the_tilt_by_how_long_it_was_averaged():
    """(0.3 / g)^2, and of a slow turn 2 v^2 r / g^2, over 1 s of which 0.12 s were averaged.

    The turn is that about down, to which y of the body points, rolled right by 90 deg. Over ground
    (7, 4) m/s, of which the wind is (4, 0): 5 m/s.
    """
    settings, state = settings_of(accel_noise_m_s2=0.3), standing()
    stand(state, attitude([0.5 * math.pi, 0.0, 0.0]))
    state["smooth_rate_rad_s"] = (0.5, 0.02, 0.7)
    state["velocity_ned_m_s"], state["wind_ned_m_s"] = (7.0, 4.0, 9.0), (4.0, 0.0, 0.0)
    state["turn_s"], state["gate"], state["tilt_innovation_rad"] = 0.12, 0, (0.01, -0.02)
    state["covariance"][0, 0] = state["covariance"][1, 1] = 1e-3
    gravity.correct(settings, state, WING, 0)
    variance = (0.09 + 2.0 * 0.02 * 25.0) / G**2 / 0.12
    np.testing.assert_allclose(
        state["correction"][:2], np.array([0.01, -0.02]) * 1e-3 / (1e-3 + variance), rtol=1e-9
    )


def test_while_it_aligns_what_the_norm_shows_counts_as_well():
    """A norm 0.4 m/s^2 off, turned at 0.1 rad/s by a class that flies at 15 m/s: 0.16 + 2.25."""
    settings = settings_of(accel_noise_m_s2=0.3, forward_speed_m_s=15.0)
    state = standing()
    state["phase"], state["gate"], state["gate_metrics"] = Phase.ALIGNING, 1, (0.4, 0.1, 0.0, 0.0)
    state["smooth_rate_rad_s"], state["turn_s"] = 0.0, 0.12
    state["tilt_innovation_rad"] = (0.01, -0.02)
    state["covariance"][0, 0] = state["covariance"][1, 1] = 1e-3
    gravity.correct(settings, state, WING, 0)
    variance = (0.09 + 0.16 + 2.25) / G**2 / 0.12
    assert state["correction"][0] == pytest.approx(0.01 * 1e-3 / (1e-3 + variance), rel=1e-9)


@pytest.mark.parametrize("airframe", [Airframe.FIXED_WING, Airframe.OTHER])
@pytest.mark.parametrize(("roll", "pitch"), [(0.3, -0.4), (-1.0, 0.2), (2.5, 0.6)])
def test_a_first_attitude_is_that_of_gravity(roll, pitch, airframe):
    """Up in body axes: (sin(pitch), -sin(roll) cos(pitch), -cos(roll) cos(pitch)) g."""
    state = standing()
    accel = G * np.array(
        [math.sin(pitch), -math.sin(roll) * math.cos(pitch), -math.cos(roll) * math.cos(pitch)]
    )
    alignment.first_attitude(settings_of(), state, airframe, np.zeros(3), accel)
    np.testing.assert_allclose(state["dcm"] @ accel, [0.0, 0.0, -G], atol=1e-9)
    assert math.atan2(state["dcm"][2, 1], state["dcm"][2, 2]) == pytest.approx(roll)


def in_a_turn(state, settings, rate=(0.02, 0.11, 0.3), speed=14.0):
    """First attitude of a wing at this rate that flies along its nose: f = w x v - gravity."""
    rate, along = np.array(rate), np.array([speed, 0.0, 0.0])
    body_from_ned = matrix_of(attitude([0.35, 0.05, 0.0])).T
    accel = np.cross(rate, along) - body_from_ned @ [0.0, 0.0, G]
    alignment.first_attitude(settings, state, WING, rate, accel)
    return body_from_ned


def test_a_first_attitude_in_a_turn_leaves_the_turns_force_out():
    settings = settings_of(forward_speed_m_s=14.0)
    state = standing()
    body_from_ned = in_a_turn(state, settings)
    np.testing.assert_allclose(state["dcm"][2], body_from_ned[:, 2], atol=1e-9)
    np.testing.assert_allclose(state["velocity_ned_m_s"], 14.0 * state["dcm"][:, 0], atol=1e-9)


def test_a_velocity_along_the_nose_is_as_unsure_as_the_nose():
    """v = C v_body: J diag(sigma^2) J' with J of angles and body velocity by finite steps."""
    settings = settings_of(forward_speed_m_s=14.0, accel_scale_error=0.03)
    settings["velocity_sigma_m_s"][WING] = (3.0, 2.0, 1.0)
    settings["accel_bias_sigma_m_s2"][WING] = 0.2
    state = standing()
    prior = state["covariance"]
    prior[0, 0], prior[1, 1], prior[2, 2] = 0.25, 0.16, 4.0
    prior[ACCEL_BIAS + 2, ACCEL_BIAS + 2] = 0.04
    in_a_turn(state, settings)
    still = state.copy()
    joined = np.zeros((ERROR_STATES, ERROR_STATES))
    for n in range(ERROR_STATES):
        joined[n, n] = 1.0 if n < VELOCITY or n >= ACCEL_BIAS else 0.0
    for k in range(3):
        error = np.zeros(ERROR_STATES)
        error[k] = 1e-6
        turned = moved(still, error)["dcm"] - moved(still, -error)["dcm"]
        joined[VELOCITY : VELOCITY + 3, k] = 14.0 * turned[:, 0] / 2e-6
        joined[VELOCITY : VELOCITY + 3, VELOCITY + k] = still["dcm"][:, k]
    known = np.diag([0.25, 0.16, 4.0, 0.0, 0.0, 0.0, 14.0**2, 4.0, 1.0] + [0.0] * 15)
    known[ACCEL_BIAS + 2, ACCEL_BIAS + 2] = 0.04 + (0.03 * G) ** 2
    np.testing.assert_allclose(
        state["covariance"], joined @ known @ joined.T, rtol=1e-6, atol=1e-6
    )


@pytest.mark.parametrize("rate", [0.03, -0.03])
def test_a_mean_rate_at_rest_is_the_bias(rate):
    """Less what is taken for the bias already is what was applied; 0.002 rad/s it may be wrong."""
    settings, state = settings_of(alignment_s=0.5), standing()
    state["aligned_samples"], state["alignment_start_ns"] = 1, state["time_ns"]
    for name in ("gyro_sum_rad_s", "gyro_square_sum", "force_error_sum", "applied"):
        state[name] = 0.0
    state["gyro_bias_rad_s"] = (0.01, 0.0, 0.0)
    done = False
    for n in range(11):
        state["time_ns"] += 50_000_000
        gyro = np.array([rate, 0.0, 0.01 * (-1) ** n])
        done = alignment.gather(settings, state, Airframe.OTHER, gyro, np.array([0.0, 0.0, -G]))
        if done:
            break
    assert done
    assert state["gyro_bias_rad_s"][0] == pytest.approx(rate)
    assert state["applied"][GYRO_BIAS] == pytest.approx(rate - 0.01)
    assert state["covariance"][GYRO_BIAS, GYRO_BIAS] == pytest.approx(4e-6)


@pytest.mark.parametrize(("spread", "rests"), [(0.015, True), (0.025, False)])
def test_a_gyro_that_spreads_by_0_02_rad_s_is_not_at_rest(spread, rests):
    """Its mean of 0.05 rad/s is none of the spread."""
    settings, state = settings_of(), standing()
    state["aligned_samples"], state["force_error_sum"] = 11, 0.0
    rates = 0.05 + spread * np.array([1.0, -1.0] * 5)
    state["gyro_sum_rad_s"], state["gyro_square_sum"] = rates.sum(), (rates**2).sum()
    alignment._take_rest_bias(settings, state, Airframe.OTHER)
    assert state["gyro_bias_rad_s"][0] == pytest.approx(0.05 if rests else 0.0)


@pytest.mark.parametrize(
    ("gyro", "accel", "flags"),
    [
        ((4.9, 0.0, 0.0), (0.0, 0.0, -49.0), Flag.NONE),
        ((5.0, 0.0, 0.0), (0.0, 0.0, -9.8), Flag.SATURATED),
        ((0.0, -5.0, 0.0), (0.0, 0.0, -9.8), Flag.SATURATED),
        ((0.0, 0.0, 0.0), (0.0, 0.0, -50.0), Flag.SATURATED),
        ((0.0, 0.0, 0.0), (51.0, 0.0, -9.8), Flag.SATURATED),
    ],
)
def test_what_clips_at_either_end_is_saturated(gyro, accel, flags):
    settings, state = settings_of(gyro_range_rad_s=5.0, accel_range_m_s2=50.0), standing()
    state["samples"], state["interval_s"], state["spikes"] = 9, 0.01, 0
    state["gyro_bias_rad_s"] = (0.1, 0.0, 0.0)
    state["rate_rad_s"] = 0.0
    sample = empty(SAMPLE_DTYPE)[0]
    sample["gyro_rad_s"], sample["accel_m_s2"] = gyro, accel
    found = plausibility.check(settings, state, sample, np.array(gyro), np.array(accel))
    assert found == flags


@pytest.mark.parametrize(("gyro", "is_spike"), [(4.85, False), (4.95, True)])
def test_a_rate_that_jumps_by_10_rad_s_is_a_spike(gyro, is_spike):
    """From -5.2 with a bias of 0.1 to take off: by 9.95, and by 10.05."""
    settings, state = settings_of(gyro_range_rad_s=50.0), standing()
    state["samples"], state["interval_s"], state["spikes"] = 9, 0.01, 0
    state["gyro_bias_rad_s"], state["rate_rad_s"] = (0.1, 0.0, 0.0), (-5.2, 0.0, 0.0)
    sample = empty(SAMPLE_DTYPE)[0]
    sample["gyro_rad_s"], sample["accel_m_s2"] = (gyro, 0.0, 0.0), (0.0, 0.0, -G)
    rate, force = sample["gyro_rad_s"].copy(), sample["accel_m_s2"].copy()
    found = plausibility.check(settings, state, sample, rate, force)
    assert found == (Flag.SPIKE if is_spike else Flag.NONE)


def test_an_update_in_one_piece_is_the_textbooks():
    """Of a variance of 4 measured with 1: 4/5 of the innovation, and 4/5 are left."""
    p, h = np.zeros((24, 24)), np.zeros((1, 24))
    p[0, 0], h[0, 0] = 4.0, 1.0
    x, left = update(p, h, [10.0], [1.0])
    assert (x[0], left[0, 0]) == pytest.approx((8.0, 0.8))
