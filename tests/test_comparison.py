"""Comparison with a reference: errors put in must come out, and what is excluded is counted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.comparison import compare, motion, rate_around, statistics, steady_flight
from ahrs_service.records import ESTIMATE_DTYPE, Phase, empty
from ahrs_service.rotation import (
    euler_columns,
    inverse_columns,
    multiply_columns,
    quaternion_columns,
)

S = 1_000_000_000


def flown(t_s, amplitude=0.3):
    """A smooth flight [N, 3]: gentle rolls and pitches, a slow turn."""
    roll = amplitude * np.sin(0.7 * t_s)
    pitch = 0.5 * amplitude * np.sin(0.4 * t_s + 1.0)
    return np.stack([roll, pitch, 0.05 * t_s], axis=-1)


def estimates_of(t_s, euler):
    rows = empty(ESTIMATE_DTYPE, len(t_s))
    rows["time_ns"] = np.round(t_s * S)
    rows["received_ns"] = rows["time_ns"]
    rows["ned_from_body"] = quaternion_columns(euler)
    rows["phase"] = Phase.RUNNING
    rates = np.zeros((len(t_s), 3))
    q = rows["ned_from_body"]
    step = multiply_columns(inverse_columns(q[:-1]), q[1:])
    between = 2.0 * step[:, 1:] / np.diff(t_s)[:, None]
    rates[1:-1] = 0.5 * (between[1:] + between[:-1])
    rows["rate_rad_s"] = rates
    return rows


def reference_of(t_s, euler):
    return np.round(t_s * S).astype(np.int64), quaternion_columns(euler)


OURS_S = np.arange(0.0, 60.0, 0.01)
THEIRS_S = np.arange(0.5, 59.0, 0.097)


def test_equal_attitudes_differ_by_nothing_between_the_samples():
    rows = estimates_of(OURS_S, flown(OURS_S))
    found = compare(rows, *reference_of(THEIRS_S, flown(THEIRS_S)), True)
    assert found.compared == len(THEIRS_S)
    assert found.out_of_reach == 0
    assert found.roll.max < 1e-5
    assert found.pitch.max < 1e-5
    assert found.tilt.max < 1e-5
    assert found.heading.max_rad < 1e-5


def test_offset_and_wave_put_in_come_out():
    wave = 0.02 * np.sin(2.0 * np.pi * OURS_S)
    euler = flown(OURS_S) + np.stack([0.03 + wave, -0.01 + 0 * wave, 0.2 + 0 * wave], axis=-1)
    rows = estimates_of(OURS_S, euler)
    found = compare(rows, *reference_of(THEIRS_S, flown(THEIRS_S)), True)
    assert found.roll.mean == pytest.approx(0.03, abs=2e-4)
    assert found.roll.sigma == pytest.approx(0.02 / np.sqrt(2.0), rel=0.02)
    assert found.roll.rms == pytest.approx(np.hypot(found.roll.mean, found.roll.sigma))
    assert found.roll.max == pytest.approx(0.05, abs=5e-4)
    assert found.pitch.mean == pytest.approx(-0.01, abs=2e-4)
    assert found.heading.offset_rad == pytest.approx(0.2, abs=1e-3)
    assert found.heading.sigma_rad < 1e-3


@settings(max_examples=20, deadline=None)
@given(lag_s=st.floats(-0.2, 0.2))
def test_a_lag_put_in_comes_out(lag_s):
    rows = estimates_of(OURS_S, flown(OURS_S))
    time_ns, q = reference_of(THEIRS_S, flown(THEIRS_S - lag_s))
    assert compare(rows, time_ns, q, False).lag_s == pytest.approx(lag_s, abs=0.001)


def test_a_lag_is_not_made_up_at_rest_or_from_noise():
    rng = np.random.default_rng(3)
    rows = estimates_of(OURS_S, np.zeros((len(OURS_S), 3)))
    noise = 1e-3 * rng.standard_normal((len(THEIRS_S), 3))
    assert np.isnan(compare(rows, *reference_of(THEIRS_S, noise), False).lag_s)


def test_the_wrap_at_180_deg_is_no_error():
    euler = np.zeros((len(OURS_S), 3))
    euler[:, 0] = np.pi - 0.001
    theirs = np.zeros((len(THEIRS_S), 3))
    theirs[:, 0] = -np.pi + 0.001
    found = compare(estimates_of(OURS_S, euler), *reference_of(THEIRS_S, theirs), False)
    assert found.roll.mean == pytest.approx(-0.002, abs=1e-6)


def test_steep_pitch_is_left_out_of_euler_errors_but_not_of_tilt():
    euler = np.zeros((len(OURS_S), 3))
    euler[:, 1] = np.radians(88.0)
    euler[:, 0] = 2.0
    theirs = np.zeros((len(THEIRS_S), 3))
    theirs[:, 1] = np.radians(88.0)
    found = compare(estimates_of(OURS_S, euler), *reference_of(THEIRS_S, theirs), True)
    assert found.steep == len(THEIRS_S)
    assert found.roll.count == 0
    assert np.isnan(found.roll.mean)
    assert found.heading is None
    assert found.tilt.count == len(THEIRS_S)
    assert found.tilt.max < np.radians(4.1)


def test_what_is_not_running_or_in_a_gap_is_out_of_reach():
    euler = flown(OURS_S)
    euler[(OURS_S > 20.0) & (OURS_S < 30.0)] += 1.0
    rows = estimates_of(OURS_S, euler)
    rows["phase"][OURS_S < 10.0] = Phase.ALIGNING
    rows = rows[(OURS_S < 20.0) | (OURS_S > 30.0)]
    found = compare(rows, *reference_of(THEIRS_S, flown(THEIRS_S)), False)
    expected = ((THEIRS_S > 10.01) & (THEIRS_S < 20.0)) | (THEIRS_S > 30.01)
    assert abs(found.compared - expected.sum()) <= 2
    assert found.compared + found.out_of_reach == len(THEIRS_S)
    assert found.roll.max < 1e-4
    assert found.heading is None


def test_sessions_with_a_clock_that_restarts_are_compared_in_pairs():
    one, two = flown(OURS_S), flown(OURS_S) + 0.5
    t_ours = np.concatenate([OURS_S, OURS_S])
    rows = np.concatenate([estimates_of(OURS_S, one), estimates_of(OURS_S, two)])
    rows["time_ns"] = np.round(t_ours * S)
    first = reference_of(THEIRS_S, flown(THEIRS_S))
    second = reference_of(THEIRS_S, flown(THEIRS_S) + 0.5)
    time_ns = np.concatenate([first[0], second[0]])
    q = np.concatenate([first[1], second[1]])
    found = compare(rows, time_ns, q, False)
    assert found.compared == 2 * len(THEIRS_S)
    assert found.roll.max < 1e-5


def test_a_session_without_reference_does_not_shift_the_pairs():
    rows = estimates_of(OURS_S, flown(OURS_S))
    brief = rows[:3].copy()
    brief["time_ns"] += 500 * S
    found = compare(np.concatenate([brief, rows]), *reference_of(THEIRS_S, flown(THEIRS_S)), False)
    assert found.compared == len(THEIRS_S)


def test_steady_flight_is_straight_level_in_the_air_and_lasts():
    t_s = np.arange(0.0, 60.0, 0.02)
    roll, yaw = 0.02 * np.sin(2.0 * np.pi * t_s), np.zeros(len(t_s))
    turning = (t_s >= 10.0) & (t_s < 14.0)
    yaw[turning] = 0.5 * (t_s[turning] - 10.0)
    yaw[t_s >= 14.0] = 2.0
    roll[(t_s >= 20.0) & (t_s < 30.0)] = np.radians(40.0)
    level_for_a_second = (t_s >= 31.0) & (t_s < 32.0)
    roll[(t_s >= 30.0) & (t_s < 33.0) & ~level_for_a_second] = np.radians(40.0)
    on_the_ground = t_s >= 45.0
    roll[on_the_ground] = 0.0
    euler = np.stack([roll, 0.0 * roll, yaw], axis=-1)
    time_ns, attitude = reference_of(t_s, euler)
    found = motion(estimates_of(t_s, euler), time_ns)
    mask, duration_s = steady_flight(time_ns, attitude, *found)
    assert mask[(t_s > 1.0) & (t_s < 8.5)].all()
    assert not mask[(t_s > 10.0) & (t_s < 14.0)].any()
    assert not mask[(t_s > 20.0) & (t_s < 33.0)].any()
    assert not mask[t_s > 46.0].any()
    # 0 to 9.4, 14.6 to 19, 34 to 46 s: a second is looked at to either side.
    assert duration_s == pytest.approx(26.0, abs=2.0)


def test_the_rate_around_an_instant_is_that_of_a_second_to_either_side():
    stamps = np.arange(0, 10 * S, S // 100)
    t_s = stamps / S
    rate = np.stack([0.1 + 0.05 * np.sin(2.0 * np.pi * t_s), 0.0 * t_s, 0.0 * t_s], axis=-1)
    turn, wobble = rate_around(stamps, rate, np.array([5 * S]))
    assert turn[0] == pytest.approx(0.1, abs=1e-3)
    assert wobble[0] == pytest.approx(0.05 / np.sqrt(2.0), rel=0.01)


def test_statistics_of_known_numbers():
    found = statistics(np.array([1.0, -3.0]))
    assert (found.count, found.mean, found.sigma, found.max) == (2, -1.0, 2.0, 3.0)
    assert found.rms == pytest.approx(np.sqrt(5.0))


def test_heading_drift_is_found():
    t_s = OURS_S
    euler = flown(t_s) + np.stack([0 * t_s, 0 * t_s, 0.002 * t_s], axis=-1)
    found = compare(estimates_of(t_s, euler), *reference_of(THEIRS_S, flown(THEIRS_S)), True)
    assert found.heading.drift_rad_s == pytest.approx(0.002, rel=0.01)


def test_no_reference_instants_and_no_estimates_give_empty_statistics():
    none = np.zeros(0, np.int64), np.zeros((0, 4))
    rows = estimates_of(OURS_S, flown(OURS_S))
    assert compare(rows, *none, True).roll.count == 0
    found = compare(rows[:1], *reference_of(THEIRS_S, flown(THEIRS_S)), True)
    assert (found.compared, found.out_of_reach) == (0, len(THEIRS_S))
    np.testing.assert_array_equal(euler_columns(none[1]).shape, (0, 3))
