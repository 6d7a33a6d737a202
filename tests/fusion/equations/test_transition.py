"""The covariance's transition against how two states that differ a little fly apart."""

import numpy as np
import pytest

from ahrs_service import pipeline
from ahrs_service.fusion import mekf, states
from ahrs_service.records import ESTIMATE_DTYPE, SAMPLE_DTYPE, empty
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.settings import FusionSettings, Settings
from tests.error_state import error_between, flying, moved

STEP_S, COUNT = 0.002, 25
STARTED_NS = 10**9
IDEAL = coefficients(Calibration.ideal())
GYRO = np.array([[0.9, -0.6, 0.4]]) + np.outer(np.arange(COUNT + 1), [2e-3, -3e-3, 1e-3])
ACCEL = np.array([[1.5, -2.0, -9.0]]) + np.outer(np.arange(COUNT + 1), [0.02, 0.03, -0.01])


def fly(state, gyro_sample):
    """Fly on for less than one filter update, from steady earlier readings."""
    return flown(state, gyro_sample)[0]


def flown(state, gyro_sample):
    """The state after the flight, and the estimates of it."""
    state = state.copy()
    gyro, accel = GYRO[0], ACCEL[0] * state["force_scale"] - state["accel_bias_m_s2"]
    rate = gyro - state["gyro_bias_rad_s"] - state["gyro_matrix"] @ gyro
    state["rate_rad_s"] = state["rate_before_rad_s"] = rate
    state["accel_before_m_s2"] = accel
    state["force_before_ned_m_s2"] = state["dcm"] @ accel
    state["samples"], state["time_ns"], state["interval_s"] = 100, STARTED_NS, STEP_S
    state["interval_before_s"] = STEP_S
    samples = empty(SAMPLE_DTYPE, COUNT)
    samples["time_ns"] = STARTED_NS + np.arange(1, COUNT + 1) * round(STEP_S * 1e9)
    samples["gyro_rad_s"], samples["accel_m_s2"] = GYRO[1:], ACCEL[1:]
    settings = Settings(fusion=FusionSettings(gyro_sample=gyro_sample, magnetometer=False))
    rows = np.array([state])
    estimates = empty(ESTIMATE_DTYPE, COUNT)
    pipeline.batch(pipeline.parameters(settings), IDEAL, rows, samples, estimates)
    return rows[0], estimates


@pytest.mark.parametrize("gyro_sample", ["instant", "mean"])
def test_two_states_fly_apart_as_the_transition_says(gyro_sample):
    """Within an update of 50 ms, each error state one after the other.

    The transition neglects terms of second order in the update time: a gyro's error tilts the
    force, which is velocity of g t^2 / 2, 12 mm/s per rad/s.
    """
    start = flying(7)
    start["force_scale"] = 1.0
    end = fly(start, gyro_sample)
    update_s = COUNT * STEP_S
    assert end["update_s"] == pytest.approx(update_s)
    transition = np.eye(states.ERROR_STATES)
    rate = end["delta_angle_rad"] / update_s
    room = np.empty((3, states.ERROR_STATES))
    mekf.transition_rows(
        transition, states.AIDED, end["update_rotation_s"], rate, end["delta_velocity_m_s"], room
    )
    for n in range(states.ERROR_STATES):
        error = np.zeros(states.ERROR_STATES)
        error[n] = 1e-5
        found = error_between(end, fly(moved(start, error), gyro_sample)) / 1e-5
        by_gyro = states.GYRO_BIAS <= n < states.VELOCITY or states.GYRO_MATRIX <= n < states.WIND
        if by_gyro:
            velocity = found[states.VELOCITY : states.ACCEL_BIAS]
            assert np.abs(velocity).max() < 0.5 * 11.0 * update_s**2 * 1.2
            found[states.VELOCITY : states.ACCEL_BIAS] = 0.0
        largest = np.abs(transition[:, n] - np.eye(states.ERROR_STATES)[:, n]).max()
        np.testing.assert_allclose(found, transition[:, n], atol=0.03 * largest + 1e-4, err_msg=n)


def test_what_is_known_of_the_sensors_is_taken_off_the_readings():
    """Rate: w - b - M w; force: scale f - bias. What is left of that without gravity, C' (0, 0, g).

    The innovation of the tilt about north and east is in body axes.
    """
    start = flying(8)
    start["force_scale"], start["tilt_innovation_rad"] = 1.05, (0.03, -0.01)
    end, estimates = flown(start, "instant")
    row = estimates[-1]
    np.testing.assert_allclose(
        row["rate_rad_s"], GYRO[-1] - start["gyro_bias_rad_s"] - start["gyro_matrix"] @ GYRO[-1]
    )
    force = 1.05 * ACCEL[-1] - start["accel_bias_m_s2"]
    np.testing.assert_allclose(row["accel_m_s2"], force)
    body_from_ned = end["dcm"].T
    np.testing.assert_allclose(row["residual_m_s2"], force + body_from_ned @ [0.0, 0.0, 9.80665])
    np.testing.assert_allclose(row["innovation_rad"], body_from_ned @ [0.03, -0.01, 0.0])


def test_a_level_vehicle_by_hand():
    """0.1 s at rest, level, to the north; g = 9.80665 up as it is felt.

    An axis tilted by psi_E (nose up) puts the force component towards north: v_N += psi_E * g up
    = -psi_E * 9.80665 * 0.1 * -1. A bias of the gyro along x, too little taken off, turns the truth
    back; one of the accelerometer slows the truth down.
    """
    f = np.eye(states.ERROR_STATES)
    impulse = np.array([0.0, 0.0, -0.980665])
    rate = np.array([0.0, 0.0, 2.0])
    mekf.transition_rows(f, states.AIDED, 0.1 * np.eye(3), rate, impulse, np.empty((3, 24)))
    north, east = states.VELOCITY, states.VELOCITY + 1
    # psi x impulse = (psi_E * -0.98, psi_N * 0.98, 0).
    assert f[north, states.ANGLE + 1] == pytest.approx(-0.980665)
    assert f[east, states.ANGLE] == pytest.approx(0.980665)
    assert f[states.ANGLE, states.GYRO_BIAS] == pytest.approx(-0.1)
    assert f[north, states.ACCEL_BIAS] == pytest.approx(-0.1)
    # At 2 rad/s about z, an element xz of the gyro's matrix counts as a bias of 2 along x.
    assert f[states.ANGLE, states.GYRO_MATRIX + 2] == pytest.approx(-0.2)
    assert f[states.ANGLE, states.GYRO_MATRIX] == 0.0
    assert f[states.ANGLE + 2, states.GYRO_MATRIX + 8] == pytest.approx(-0.2)


@pytest.mark.parametrize("count", [states.GATED, states.UNAIDED, states.AIDED])
def test_a_correction_moves_the_state_to_the_truth_it_stands_for(count):
    state = flying(3, count)
    state["force_ned_m_s2"], state["delta_velocity_m_s"] = (1.0, 2.0, -9.0), 0.0
    error = np.zeros(states.ERROR_STATES)
    error[:count] = 1e-4 * np.random.default_rng(1).normal(size=count)
    expected = moved(state, error)
    before = state.copy()
    state["correction"][:] = error
    mekf.apply_correction(state)
    np.testing.assert_allclose(error_between(expected, state), 0.0, atol=1e-12)
    np.testing.assert_allclose(state["dcm"], expected["dcm"], atol=1e-12)
    # The force in earth axes rotates too: C' f_body.
    felt = before["dcm"].T @ before["force_ned_m_s2"]
    np.testing.assert_allclose(state["force_ned_m_s2"], expected["dcm"] @ felt, atol=1e-6)
    added = state["velocity_ned_m_s"] - before["velocity_ned_m_s"]
    np.testing.assert_allclose(state["delta_velocity_m_s"], added, atol=1e-15)
    np.testing.assert_array_equal(state["applied"], error)


def test_rotated_about_down_all_that_is_reported_in_earth_axes_rotates():
    """By 0.7 rad: what was north is (cos, sin). Nothing in body axes changes."""
    angle = 0.7
    state = flying(4)
    rng = np.random.default_rng(2)
    names = ("velocity_ned_m_s", "wind_ned_m_s", "force_ned_m_s2", "force_before_ned_m_s2")
    for name in names[2:]:
        state[name] = rng.normal(size=3)
    state["history_m_s"] = rng.normal(size=state["history_m_s"].shape)
    state["applied"] = rng.normal(size=states.ERROR_STATES)
    before = state.copy()
    mekf.rotate_about_down(state, angle)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for name in (*names, "history_m_s", "dcm"):
        np.testing.assert_allclose(state[name], turn @ before[name], atol=1e-12, err_msg=name)
    whole = np.eye(states.ERROR_STATES)
    for k in (states.ANGLE, states.VELOCITY, states.WIND):
        whole[k : k + 2, k : k + 2] = turn[:2, :2]
    np.testing.assert_allclose(
        state["covariance"], whole @ before["covariance"] @ whole.T, atol=1e-12
    )
    np.testing.assert_allclose(state["applied"], whole @ before["applied"], atol=1e-12)
    assert state["rotated_rad"] == angle
