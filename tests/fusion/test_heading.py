"""Heading on simulated rotations in a known field."""

from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2 as G
from ahrs_service.estimator import Estimator
from ahrs_service.fusion import heading
from ahrs_service.records import SAMPLE_DTYPE, Phase, empty
from ahrs_service.rotation import (
    euler_columns,
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)
from ahrs_service.settings import Settings

RATE_HZ = 100.0
FIELD_NED = np.array([16.0, 0.0, 42.0])


def settings(**fusion):
    base = Settings()
    chosen = {"airframe": "hand_held", "gyro_sample": "mean", **fusion}
    return replace(base, fusion=replace(base.fusion, **chosen))


def tumble(seconds, still_s=3.0, yaw=0.0, bias=(0.0, 0.0, 0.0)):
    """Samples of a sensor that rotates about all axes without acceleration, and its attitude."""
    count = round(seconds * RATE_HZ)
    t = np.arange(count) / RATE_HZ
    rate = np.stack([1.1 * np.sin(0.9 * t), 0.8 * np.sin(0.61 * t + 1.0), np.cos(0.37 * t)], axis=1)
    rate[t < still_s] = 0.0
    angle = np.linalg.norm(rate, axis=1, keepdims=True) / RATE_HZ
    axis = rate / np.maximum(np.linalg.norm(rate, axis=1, keepdims=True), 1e-12)
    steps = np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * axis], axis=1)
    attitude = np.empty((count, 4))
    now = np.array([[np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]])
    for n in range(count):
        now = multiply_columns(now, steps[n][None])
        attitude[n] = now[0]
    samples = empty(SAMPLE_DTYPE, count)
    samples["time_ns"] = np.rint(t * 1e9).astype(np.int64) + 10**9
    samples["gyro_rad_s"] = rate + np.asarray(bias)
    samples["accel_m_s2"] = in_body(attitude, np.array([0.0, 0.0, -G]))
    samples["mag_ut"] = in_body(attitude, FIELD_NED)
    return samples, attitude


def spin(seconds, still_s=3.0):
    """Samples of a sensor rotated over and over by hand, mostly one way, and its attitude.

    Exact for means of the rate: its integral over a sample by Simpson's rule.
    """
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ

    def angles(t):
        run = np.maximum(t - still_s, 0.0)
        run = run**3 / (1.0 + run**2)
        return np.stack([1.4 * np.sin(3.0 * run), 1.1 * np.sin(2.2 * run), 4.0 * run], axis=1)

    def rate(t):
        roll, pitch, _ = angles(t).T
        by_roll, by_pitch, by_yaw = ((angles(t + 1e-5) - angles(t - 1e-5)) / 2e-5).T
        across = np.cos(pitch) * by_yaw
        return np.stack(
            [
                by_roll - np.sin(pitch) * by_yaw,
                np.cos(roll) * by_pitch + np.sin(roll) * across,
                np.cos(roll) * across - np.sin(roll) * by_pitch,
            ],
            axis=1,
        )

    samples, attitude = empty(SAMPLE_DTYPE, len(t)), quaternion_columns(angles(t))
    samples["time_ns"] = np.rint(t * 1e9).astype(np.int64) + 10**9
    step = 1.0 / RATE_HZ
    samples["gyro_rad_s"] = (rate(t) + 4.0 * rate(t - 0.5 * step) + rate(t - step)) / 6.0
    samples["accel_m_s2"] = in_body(attitude, np.array([0.0, 0.0, -G]))
    samples["mag_ut"] = in_body(attitude, FIELD_NED)
    return samples, attitude


def in_body(attitude, vector):
    return rotate_columns(inverse_columns(attitude), np.broadcast_to(vector, (len(attitude), 3)))


def run(samples, **fusion):
    """Estimates and the state after the last sample."""
    estimator = Estimator(settings(**fusion))
    return estimator.run(samples), estimator.state


def heading_error(estimates, attitude):
    """Error angle about down [N] [rad]."""
    e = multiply_columns(estimates["ned_from_body"], inverse_columns(attitude))
    error = 2.0 * np.arctan2(e[:, 3], e[:, 0])
    return np.arctan2(np.sin(error), np.cos(error))


def at(seconds):
    return round(seconds * RATE_HZ)


@pytest.mark.parametrize("yaw", [0.0, 1.2, 3.1, -2.0])
def test_first_heading_is_magnetic_north_plus_declination(yaw):
    samples, _ = tumble(3.0, still_s=3.0, yaw=yaw)
    estimates, _ = run(samples, declination_deg=10.0)
    found = euler_columns(estimates["ned_from_body"])[-1, 2]
    expected = yaw + np.radians(10.0)
    assert np.cos(found - expected) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("offset", range(10))
def test_a_slow_magnetometer_is_used_at_any_sample_of_an_update(offset):
    """At the update rate, so it always falls on the same sample of an update."""
    samples, _ = tumble(3.0, still_s=3.0, yaw=1.0)
    slow = np.full_like(samples["mag_ut"], np.nan)
    slow[at(1.5) + offset :: 10] = samples["mag_ut"][at(1.5) + offset :: 10]
    samples["mag_ut"] = slow
    estimates, state = run(samples)
    assert state["heading_source"][0] == heading.FIELD
    assert euler_columns(estimates["ned_from_body"])[-1, 2] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("iron", [(0.0, 0.0, 25.0), (-6.0, 4.0, 3.0)])
def test_attached_magnet_is_found_and_taken_out(iron):
    samples, attitude = tumble(120.0)
    samples["mag_ut"][at(30.0) :] += iron
    estimates, state = run(samples)
    np.testing.assert_allclose(state["iron_ut"][0], iron, atol=0.5)
    error = heading_error(estimates, attitude)
    assert np.abs(error[at(30.0) :]).max() < np.radians(2.0)


@pytest.mark.parametrize(
    ("late_s", "every", "lag_s", "error_deg"),
    [(0.0, 1, 0.001, 0.3), (0.02, 1, 0.001, 0.5), (0.06, 10, 0.008, 3.0)],
)
def test_lag_of_the_magnetometer_is_learnt(late_s, every, lag_s, error_deg):
    """At 5 rad/s; the last rotates by 0.3 rad in its lag, where the correction is not small."""
    samples, attitude = spin(60.0)
    field = samples["mag_ut"].copy()
    samples["mag_ut"] = np.nan
    samples["mag_ut"][at(late_s) :: every] = field[: len(field) - at(late_s) : every]
    estimates, state = run(samples)
    assert state["field_lag_s"][0] == pytest.approx(late_s, abs=lag_s)
    assert state["field_lag_variance_s2"][0] ** 0.5 < 0.005
    assert np.abs(heading_error(estimates, attitude)[at(10.0) :]).max() < np.radians(error_deg)


def test_lag_is_reported_from_a_magnet_that_turns_with_the_sensor():
    samples, _ = spin(90.0)
    samples["mag_ut"][at(0.03) :] = samples["mag_ut"][: -at(0.03)].copy()
    samples["mag_ut"] += (5.0, -8.0, 10.0)
    _, state = run(samples)
    np.testing.assert_allclose(state["iron_ut"][0], (5.0, -8.0, 10.0), atol=0.5)
    assert state["field_lag_s"][0] == pytest.approx(0.03, abs=0.004)


@pytest.mark.parametrize("yaw", [0.7, 2.9])
def test_lag_is_the_same_wherever_north_is(yaw):
    samples, _ = spin(20.0)
    rng = np.random.default_rng(5)
    samples["mag_ut"][at(0.02) :] = samples["mag_ut"][: -at(0.02)].copy()
    samples["mag_ut"] += rng.standard_t(3, samples["mag_ut"].shape)
    _, state = run(samples)
    _, turned = run(samples, declination_deg=np.degrees(yaw))
    assert turned["field_lag_s"][0] == pytest.approx(state["field_lag_s"][0], rel=1e-6)


def test_removed_magnet_is_forgotten():
    samples, attitude = tumble(150.0)
    samples["mag_ut"][at(20.0) : at(80.0)] += (0.0, 0.0, 20.0)
    estimates, state = run(samples)
    np.testing.assert_allclose(state["iron_ut"][0], 0.0, atol=0.5)
    assert np.abs(heading_error(estimates, attitude)[at(20.0) :]).max() < np.radians(2.0)


@pytest.mark.parametrize("disturbance", [(0.0, 20.0, 20.0), (-40.0, 0.0, -30.0), (0.0, 0.0, -84.0)])
def test_disturbance_of_30_seconds_does_not_pull(disturbance):
    samples, attitude = tumble(80.0)
    disturbed = slice(at(40.0), at(70.0))
    samples["mag_ut"][disturbed] += in_body(attitude[disturbed], np.array(disturbance))
    estimates, _ = run(samples)
    assert np.abs(heading_error(estimates, attitude)[at(40.0) :]).max() < np.radians(3.0)


def test_field_of_the_right_norm_and_wrong_dip_is_hardly_trusted():
    """The same norm, 30 deg less dip, 60 deg off in azimuth."""
    norm, dip = np.linalg.norm(FIELD_NED), np.arctan2(42.0, 16.0) - np.radians(30.0)
    level = norm * np.cos(dip)
    wrong = np.array([0.5 * level, np.sqrt(0.75) * level, norm * np.sin(dip)])
    samples, attitude = tumble(70.0)
    samples["mag_ut"][at(40.0) :] = in_body(attitude[at(40.0) :], wrong)
    estimates, _ = run(samples)
    assert np.abs(heading_error(estimates, attitude)[-1]) < np.radians(4.0)


def test_another_field_becomes_the_reference_after_turning_in_it():
    other = np.array([22.0, 0.0, 30.0])
    samples, attitude = tumble(90.0)
    samples["mag_ut"][at(40.0) :] = in_body(attitude[at(40.0) :], other)
    _, early = run(samples[: at(65.0)])
    np.testing.assert_allclose(early["reference_ut"][0], [16.0, 42.0], atol=0.3)
    _, late = run(samples)
    # The update in which the field changed has both fields in its mean.
    np.testing.assert_allclose(late["reference_ut"][0], [22.0, 30.0], atol=0.6)


def test_first_reference_of_a_second_gives_way_within_seconds():
    samples, attitude = tumble(30.0)
    samples["mag_ut"][: at(4.0)] = in_body(attitude[: at(4.0)], np.array([30.0, 0.0, 30.0]))
    _, state = run(samples)
    np.testing.assert_allclose(state["reference_ut"][0], [16.0, 42.0], atol=0.5)


def test_another_field_at_rest_is_not_accepted():
    samples, attitude = tumble(100.0, still_s=100.0)
    samples["mag_ut"][at(40.0) :] = in_body(attitude[at(40.0) :], np.array([22.0, 9.0, 30.0]))
    estimates, state = run(samples)
    np.testing.assert_allclose(state["reference_ut"][0], [16.0, 42.0], atol=0.3)
    assert abs(heading_error(estimates, attitude)[-1]) < np.radians(4.0)


def test_without_magnetometer_the_heading_is_free_and_says_so():
    samples, attitude = tumble(60.0, bias=(0.01, -0.01, 0.01))
    samples["mag_ut"] = np.nan
    estimates, state = run(samples)
    assert state["heading_source"][0] == 0
    assert estimates["attitude_sigma_rad"][-1, 2] > 3.0
    drift = heading_error(estimates, attitude)
    assert abs(drift[-1] - drift[at(3.0)]) < np.radians(3.0)


def test_magnetometer_that_vanishes_and_comes_back():
    samples, attitude = tumble(120.0)
    samples["mag_ut"][at(30.0) : at(90.0)] = np.nan
    estimates, _ = run(samples)
    sigma = estimates["attitude_sigma_rad"][:, 2]
    assert sigma[at(89.9)] > 1.03 * sigma[at(29.9)]
    assert sigma[-1] < sigma[at(89.9)]
    error = heading_error(estimates, attitude)
    assert (np.abs(error[at(3.0) :]) < sigma[at(3.0) :]).all()


def test_magnetometer_that_comes_late_rotates_attitude_and_velocity():
    """The tilt does not move when the heading jumps by 2 rad."""
    samples, attitude = tumble(60.0, yaw=2.0)
    samples["mag_ut"][: at(30.0)] = np.nan
    estimates, _ = run(samples)
    error = heading_error(estimates, attitude)
    assert abs(error[at(29.9)]) > 1.5
    assert abs(error[at(31.0)]) < np.radians(1.0)
    e = multiply_columns(estimates["ned_from_body"], inverse_columns(attitude))
    tilt = 2.0 * np.arccos(np.minimum(np.hypot(e[:, 0], e[:, 3]), 1.0))
    assert abs(tilt[at(30.1)] - tilt[at(29.9)]) < np.radians(0.05)
    assert tilt[at(30.0) :].max() < np.radians(0.5)


def test_magnetic_error_does_not_tilt_the_horizon():
    samples, _ = tumble(60.0)
    rng = np.random.default_rng(5)
    samples["mag_ut"] += np.cumsum(rng.normal(0.0, 0.3, (len(samples), 3)), axis=0)
    nine, _ = run(samples)
    samples["mag_ut"] = np.nan
    six, _ = run(samples)
    # The same vertical in body axes, whatever the heading.
    down = np.array([0.0, 0.0, 1.0])
    with_mag, without = (in_body(one["ned_from_body"], down) for one in (nine, six))
    assert np.linalg.norm(with_mag - without, axis=1).max() < np.radians(0.1)


def test_gyro_bias_about_the_vertical_is_learnt_from_the_field():
    samples, _ = tumble(120.0, still_s=0.0, bias=(0.0, 0.0, 0.01))
    estimates, _ = run(samples)
    np.testing.assert_allclose(estimates["gyro_bias_rad_s"][-1], [0.0, 0.0, 0.01], atol=2e-3)


@pytest.mark.parametrize("value", [(0.0, 0.0, 0.0), (100.0, 0.0, 0.0), (np.inf, 0.0, 1.0)])
def test_no_plausible_field_gives_no_heading(value):
    samples, _ = tumble(5.0)
    samples["mag_ut"] = value
    estimates, state = run(samples)
    assert state["heading_source"][0] == 0
    assert np.isfinite(estimates["ned_from_body"]).all()


def test_a_field_straight_down_leaves_numbers():
    samples = empty(SAMPLE_DTYPE, 500)
    samples["time_ns"] = np.arange(500) * 10_000_000
    samples["gyro_rad_s"] = 0.0
    samples["accel_m_s2"] = (0.0, 0.0, -G)
    samples["mag_ut"] = (0.0, 0.0, 40.0)
    estimates, _ = run(samples)
    assert np.isfinite(estimates["ned_from_body"]).all()
    assert estimates["phase"][-1] == Phase.RUNNING
    assert estimates["attitude_sigma_rad"][-1, 2] > 1.0


@pytest.mark.parametrize(
    "field", ["reference_ut", "iron_ut", "iron_covariance", "mag_field_ut", "field_lag_s"]
)
def test_damaged_state_begins_anew(field):
    samples, attitude = tumble(20.0)
    estimator = Estimator(settings())
    estimator.run(samples[: at(10.0)])
    estimator.state[field] = np.nan
    estimates = estimator.run(samples[at(10.0) :])
    assert estimator.state["heading_source"][0] == 1
    assert abs(heading_error(estimates, attitude[at(10.0) :])[-1]) < np.radians(1.0)


def test_slow_magnetometer_serves_as_well():
    samples, attitude = tumble(60.0)
    missing = np.arange(len(samples)) % 10 != 0
    samples["mag_ut"][missing] = np.nan
    estimates, state = run(samples)
    np.testing.assert_allclose(state["reference_ut"][0], [16.0, 42.0], atol=0.3)
    assert np.abs(heading_error(estimates, attitude)[at(3.0) :]).max() < np.radians(1.0)


def test_correction_of_a_free_heading_brings_no_knowledge_of_it():
    """A velocity that was wrong is corrected, and the heading is as unknown as before."""
    samples, _ = tumble(30.0)
    samples["mag_ut"] = np.nan
    samples["accel_m_s2"][at(8.0) : at(9.0)] += (6.0, -4.0, 2.0)
    estimates, _ = run(samples)
    assert estimates["attitude_sigma_rad"][at(10.0) :, 2].min() > 3.1
