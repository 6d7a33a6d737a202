"""When the unit is still: against the simulated plan, and by hand-made streams."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.poses import (
    directions,
    find_poses,
    groups_of,
    rest_bias,
    sphere_coverage,
    windows_of,
)
from tests.calibration.conftest import poses_of


def still(seconds=20.0, rate_hz=100.0, seed=1, gyro_sigma=1e-3, accel_sigma=2e-2, up=(0, 0, -9.8)):
    rng = np.random.default_rng(seed)
    count = round(seconds * rate_hz)
    return ImuColumns(
        np.arange(count) / rate_hz,
        rng.normal(0.0, gyro_sigma, (count, 3)),
        np.array(up) + rng.normal(0.0, accel_sigma, (count, 3)),
        np.full(count, 30.0),
    )


@pytest.mark.parametrize("name", ["six-position", "multi-pose"])
@pytest.mark.parametrize("rate_hz", [25.0, 200.0])
def test_every_pose_of_the_plan_is_found_and_nothing_else(bench, name, rate_hz):
    columns, flight = bench(name, 150.0, rate_hz=rate_hz)
    poses = find_poses(columns)
    ends = np.cumsum([phase.seconds for phase in flight.phases])
    begins = ends - [phase.seconds for phase in flight.phases]
    holds = [
        (a, b)
        for a, b, phase in zip(begins, ends, flight.phases, strict=True)
        if phase.name == "at rest"
    ]
    assert len(poses) == len(holds)
    for pose, (begin, end) in zip(poses, holds, strict=True):
        assert begin < pose["start_s"] < pose["stop_s"] < end
        assert pose["stop_s"] - pose["start_s"] > 0.5 * (end - begin)
        inside = (flight.rows["time_s"] > begin + 0.3) & (flight.rows["time_s"] < end - 0.3)
        truth = flight.rows["force_m_s2"][inside].mean(axis=0)
        assert directions(pose["accel_m_s2"][None])[0] @ truth > 9.8 * math.cos(0.02)


def test_the_standard_errors_are_those_of_the_means():
    """Over many pieces of one sensor's rest, means scatter by their reported sigma."""
    means, errors = [], []
    for seed in range(60):
        (pose,) = find_poses(still(6.0, seed=seed))
        means.append(pose["accel_m_s2"] - [0, 0, -9.8])
        errors.append(pose["accel_error_m_s2"])
    # 180 values: their mean square over the promised one is 1 within four sigmas.
    ratio = np.mean((np.array(means) / np.array(errors)) ** 2)
    assert 1.0 - 4.0 * math.sqrt(2 / 180) < ratio < 1.0 + 4.0 * math.sqrt(2 / 180)


def test_a_hand_that_trembles_is_not_still():
    columns = still(20.0)
    t = columns.time_s
    tremor = math.radians(2.0) * np.sin(2 * np.pi * 9.0 * t)[:, None] * [1.0, 0.7, 0.4]
    held = replace(columns, gyro_rad_s=columns.gyro_rad_s + tremor)
    assert len(find_poses(held)) == 0
    half = np.where((t < 10.0)[:, None], tremor, 0.0)
    (pose,) = find_poses(replace(columns, gyro_rad_s=columns.gyro_rad_s + half))
    assert pose["start_s"] >= 10.0


def test_a_slow_steady_turn_is_not_still():
    """Its scatter equals that at rest; only the rate of the other poses differs."""
    columns = still(30.0)
    t = columns.time_s
    turning = (t > 12.0) & (t < 18.0)
    gyro = columns.gyro_rad_s + np.where(turning[:, None], [0.0, 0.0, math.radians(5.0)], 0.0)
    poses = find_poses(replace(columns, gyro_rad_s=gyro))
    assert len(poses) == 2
    assert poses["stop_s"][0] <= 12.0
    assert poses["start_s"][1] >= 18.0


def test_a_step_between_two_windows_parts_two_poses():
    columns = still(10.0)
    accel = columns.accel_m_s2.copy()
    accel[500:] += [0.5, 0.0, 0.0]
    poses = find_poses(replace(columns, accel_m_s2=accel))
    assert len(poses) == 2
    assert poses["stop_s"][0] < 5.0 <= poses["start_s"][1]


def test_a_gap_is_no_pose():
    columns = still(10.0)
    keep = np.ones(1000, bool)
    keep[420:480] = False
    cut = ImuColumns(*(getattr(columns, name)[keep] for name in columns.__slots__))
    poses = find_poses(cut)
    assert len(poses) == 2
    assert all(pose["stop_s"] <= 4.2 or pose["start_s"] >= 4.8 for pose in poses)


def test_values_rounded_by_the_link_are_still():
    """1 mG and 1 mrad/s of RAW_IMU can be coarser than the noise: a floor of a step remains."""
    columns = still(10.0, gyro_sigma=2e-4, accel_sigma=1e-3)
    rounded = replace(
        columns,
        gyro_rad_s=np.trunc(columns.gyro_rad_s / 1e-3) * 1e-3,
        accel_m_s2=np.trunc(columns.accel_m_s2 / 9.80665e-3) * 9.80665e-3,
    )
    (pose,) = find_poses(rounded)
    assert pose["stop_s"] - pose["start_s"] > 8.0


def test_less_than_a_window_has_no_pose():
    for seconds in (0.0, 0.01, 0.2):
        assert len(find_poses(still(seconds))) == 0
    assert not windows_of(still(0.0)).is_still.any()


def test_six_faces_cover_what_geometry_says():
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    # Six caps of 45 deg that touch but do not overlap.
    assert sphere_coverage(faces) == pytest.approx(6 * (1 - math.cos(math.pi / 4)) / 2, abs=0.003)
    assert sphere_coverage(faces[:1]) == pytest.approx((1 - math.cos(math.pi / 4)) / 2, abs=0.003)
    assert sphere_coverage(np.zeros((0, 3))) == 0.0


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1, 1)] * 3), min_size=1, max_size=20))
def test_like_directions_share_a_number(vectors):
    v = np.array(vectors)
    v = v[np.linalg.norm(v, axis=1) > 0.1]
    if not len(v):
        return
    up = directions(v)
    numbers = groups_of(np.concatenate([up, up]))
    assert (numbers[: len(up)] == numbers[len(up) :]).all()
    assert set(numbers) == set(range(numbers.max() + 1))


def test_the_bias_at_rest_is_the_mean_over_time(bench):
    columns, flight = bench("multi-pose", 150.0)
    bias, variance = rest_bias(find_poses(columns))
    truth = np.array(flight.calibration.gyro.bias)
    assert (np.abs(bias - truth) < 4.0 * np.sqrt(variance)).all()
    assert (np.sqrt(variance) < 1e-4).all()


def test_a_bias_that_wanders_is_known_as_far_as_it_wandered():
    rng = np.random.default_rng(4)
    noise, wander, errors = 1e-5, 3e-4, []
    for wandering in (False, True):
        squares = []
        for _ in range(200):
            walk = rng.normal(0.0, wander, (20, 3)) if wandering else 0.0
            poses = poses_of(np.tile([0.0, 0.0, -9.8], (20, 1)))
            poses["gyro_rad_s"] = walk + rng.normal(0.0, noise, (20, 3))
            poses["gyro_error_rad_s"] = noise
            bias, variance = rest_bias(poses)
            # Of the next session: another draw of the wander, or the mean in question.
            later = rng.normal(0.0, wander, 3) if wandering else np.zeros(3)
            squares.append((bias - later) ** 2 / variance)
        errors.append(np.mean(squares))
    white, wandering = errors
    assert white == pytest.approx(1.0, abs=0.25)
    assert wandering == pytest.approx(20 / 19 * (1 + 1 / 20), abs=0.25)
