"""The first attitude, and impossible samples, worked out by hand."""

import math

import numpy as np
import pytest

from ahrs_service.fusion import alignment, plausibility
from ahrs_service.fusion.states import ACCEL_BIAS, ERROR_STATES, GYRO_BIAS, VELOCITY
from ahrs_service.records import SAMPLE_DTYPE, Airframe, Flag, empty
from tests.error_state import attitude, flying, matrix_of, moved, update
from tests.standing import WING, G, settings_of, standing


@pytest.mark.parametrize("airframe", [Airframe.FIXED_WING, Airframe.OTHER])
@pytest.mark.parametrize(("roll", "pitch"), [(0.3, -0.4), (-1.0, 0.2), (2.5, 0.6)])
def test_a_first_attitude_is_that_of_gravity(roll, pitch, airframe):
    """Up in body axes: (sin(pitch), -sin(roll) cos(pitch), -cos(roll) cos(pitch)) g."""
    state = standing()
    accel = G * np.array(
        [math.sin(pitch), -math.sin(roll) * math.cos(pitch), -math.cos(roll) * math.cos(pitch)]
    )
    bias = state["gyro_bias_rad_s"] = np.array([0.01, -0.02, 0.015])
    # 0.05 rad/s are those of a bias, not of a turn; rolling in place is none either.
    rate = np.array([0.3, 0.03, -0.04])
    alignment.first_attitude(settings_of(), state, airframe, bias + rate, accel)
    np.testing.assert_allclose(state["rate_rad_s"], rate)
    np.testing.assert_allclose(state["smooth_rate_rad_s"], rate)
    for name in ("force_ned_m_s2", "force_before_ned_m_s2"):
        np.testing.assert_allclose(state[name], [0.0, 0.0, -G], atol=1e-9)
    np.testing.assert_array_equal(state["velocity_ned_m_s"], 0.0)
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
    np.testing.assert_allclose(state["covariance"], joined @ known @ joined.T, rtol=1e-6, atol=1e-6)


def lean(force):
    """A force of this size whose parts are 2, -3 and -6 of 7."""
    return force * np.array([2.0, -3.0, -6.0]) / 7.0


@pytest.mark.parametrize(("more", "rests"), [(0.45, True), (0.55, False), (-0.55, False)])
def test_a_force_that_is_off_by_half_a_m_s2_is_not_that_of_rest(more, rests):
    settings, state = settings_of(alignment_s=0.0), standing()
    state["aligned_samples"], state["alignment_start_ns"] = 1, state["time_ns"]
    for name in ("gyro_sum_rad_s", "gyro_square_sum", "force_error_sum"):
        state[name] = 0.0
    while not alignment.gather(
        settings, state, Airframe.OTHER, np.array([0.03, 0.0, 0.0]), lean(G + more)
    ):
        pass
    assert state["gyro_bias_rad_s"][0] == pytest.approx(0.03 if rests else 0.0)


@pytest.mark.parametrize(("spread", "rests"), [(0.01, True), (0.03, False)])
def test_a_rate_that_goes_to_and_fro_is_not_that_of_rest(spread, rests):
    settings, state = settings_of(alignment_s=0.0), standing()
    state["aligned_samples"], state["alignment_start_ns"] = 1, state["time_ns"]
    for name in ("gyro_sum_rad_s", "gyro_square_sum", "force_error_sum"):
        state[name] = 0.0
    done, sign = False, 1.0
    while not done:
        gyro = np.array([0.0, 0.02 + sign * spread, 0.0])
        done, sign = alignment.gather(settings, state, Airframe.OTHER, gyro, lean(G)), -sign
    assert (state["gyro_bias_rad_s"][1] != 0.0) == rests


@pytest.mark.parametrize(
    ("name", "index", "value"),
    [
        ("ned_from_body", slice(None), 0.6),
        ("covariance", (5, 5), -1.0),
        ("covariance", (1, 1), 0.0),
        ("gyro_matrix", (0, 2), -1.5),
        ("velocity_ned_m_s", 1, np.inf),
        ("velocity_lag_s", (), np.nan),
    ],
)
def test_a_state_that_no_flight_brings_about_is_not_sound(name, index, value):
    state = flying(61)
    assert alignment.is_sound(state)
    if index == ():
        state[name] = value
    else:
        state[name][index] = value
    assert not alignment.is_sound(state)
    np.testing.assert_array_equal(state["ned_from_body"], [1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("rate", [0.03, -0.03])
def test_a_mean_rate_at_rest_is_the_bias(rate):
    """The applied bias is subtracted; it may be wrong by 0.002 rad/s."""
    settings, state = settings_of(alignment_s=0.5), standing()
    state["aligned_samples"], state["alignment_start_ns"] = 1, state["time_ns"]
    for name in ("gyro_sum_rad_s", "gyro_square_sum", "force_error_sum", "applied"):
        state[name] = 0.0
    state["gyro_bias_rad_s"] = (0.01, 0.0, 0.0)
    done = False
    for n in range(11):
        state["time_ns"] += 50_000_000
        gyro = np.array([rate, 0.0, 0.01 * (-1) ** n])
        done = alignment.gather(settings, state, Airframe.OTHER, gyro, lean(G))
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
