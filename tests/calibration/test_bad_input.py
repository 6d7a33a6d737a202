"""Unusable input of a calibration is refused with a sentence that says what to do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.calibration import known_rotations, multi_pose, pose_rotations, six_position
from ahrs_service.calibration.columns import (
    check_force_unit,
    check_saturation,
    check_temperature,
    flat_tops,
)
from ahrs_service.calibration.poses import check_clipped_poses, find_poses
from ahrs_service.calibration.triad import ideal
from ahrs_service.errors import CalibrationError
from tests.calibration.conftest import poses_of

G = 9.80665
FACES = np.concatenate([np.eye(3), -np.eye(3)])


def spread(count):
    up = np.random.default_rng(1).normal(size=(count, 3))
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def test_a_missing_face_is_named():
    with pytest.raises(CalibrationError, match=r"none of them with -y up: put the unit on each"):
        six_position.fit_accelerometer(poses_of(G * FACES[[0, 1, 2, 3, 5]]))
    with pytest.raises(CalibrationError, match=r"0 still poses, none of them with \+x, -x, \+y"):
        six_position.fit_accelerometer(poses_of(np.zeros((0, 3))))


def test_a_pose_between_faces_is_no_face():
    tilted = FACES.copy()
    tilted[4] = [0.0, -math.cos(0.4), -math.sin(0.4)]
    with pytest.raises(CalibrationError, match="none of them with -y up"):
        six_position.fit_accelerometer(poses_of(G * tilted))


def test_too_few_directions_are_counted():
    with pytest.raises(CalibrationError, match="11 still poses in 11 different directions"):
        multi_pose.fit_accelerometer(poses_of(G * spread(11)))
    again = np.concatenate([FACES, FACES, FACES])
    with pytest.raises(CalibrationError, match="18 still poses in 6 different directions"):
        multi_pose.fit_accelerometer(poses_of(G * again))
    with pytest.raises(CalibrationError, match="0 still poses in 0 different directions"):
        multi_pose.fit_accelerometer(poses_of(np.zeros((0, 3))))


@pytest.mark.parametrize(
    ("one_g", "unit", "factor"),
    [(1000.0, "mG", "0.00980665"), (1.0, "in g", "9.80665"), (980.665, "mG", "0.00980665")],
)
@pytest.mark.parametrize("fit", [six_position.fit_accelerometer, multi_pose.fit_accelerometer])
def test_another_unit_is_reported(fit, one_g, unit, factor):
    up = FACES if fit is six_position.fit_accelerometer else spread(15)
    with pytest.raises(CalibrationError, match=unit) as caught:
        fit(poses_of(one_g * up))
    assert f"multiply by {factor}" in str(caught.value)


def test_a_force_that_is_no_gravity_is_reported():
    with pytest.raises(CalibrationError, match=r"4.9 m/s\^2 instead of about 9.8"):
        check_force_unit(4.9 * FACES)
    check_force_unit(G * FACES * 1.1)


def test_temperature_missing_or_constant():
    with pytest.raises(CalibrationError, match="own temperature is missing: record SCALED_IMU"):
        check_temperature(np.full(100, np.nan))
    with pytest.raises(CalibrationError, match="own temperature is missing"):
        check_temperature(np.zeros(0))
    with pytest.raises(CalibrationError, match="temperature is constant"):
        check_temperature(np.full(100, 41.0), 10.0)
    with pytest.raises(CalibrationError, match="cool the unit"):
        check_temperature(np.linspace(20.0, 28.0, 50), 10.0)
    check_temperature(np.linspace(20.0, 31.0, 50), 10.0)


def test_a_gyro_at_its_end_is_saturated(bench):
    columns, _ = bench("six-position", 100.0)
    check_saturation(columns)
    clipped = replace(columns, gyro_rad_s=np.clip(columns.gyro_rad_s, -1.0, 1.0))
    with pytest.raises(CalibrationError, match="gyro x is saturated at 1 rad/s: turn and put down"):
        check_saturation(clipped)


def test_turns_at_the_end_of_the_range_are_left_out(bench):
    columns, _ = bench("six-position", 100.0)
    gyro = columns.gyro_rad_s.copy()
    gyro[:, 0] = np.clip(gyro[:, 0], -1.0, 1.0)
    clipped = replace(columns, gyro_rad_s=gyro)
    turns = known_rotations.find_rotations(clipped, find_poses(clipped), ideal(), 360.0)
    assert len(turns.truth) == 4
    assert len(turns.left_out) == 2
    assert "ran into the end of its range, so it does not count: turn more" in turns.left_out[0]


def test_an_accelerometer_at_its_end_is_saturated(bench):
    columns, _ = bench("six-position", 100.0)
    check_clipped_poses(columns, find_poses(columns))
    force = columns.accel_m_s2.copy()
    force[:, 1] = np.clip(force[:, 1], -9.5, 9.5)
    clipped = replace(columns, accel_m_s2=force)
    with pytest.raises(CalibrationError, match="accelerometer y does not move at all in 4 of 13"):
        check_clipped_poses(clipped, find_poses(clipped))


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 1e-3, 1e-2]),
    st.floats(1e-4, 1e-1),
)
def test_noise_and_rounding_are_no_saturation(seed, step, sigma):
    values = np.random.default_rng(seed).normal(0.0, sigma, (300, 3))
    if step:
        values = np.round(values / step) * step
    assert not flat_tops(values).any()
    # A link that sends each sample four times changes nothing.
    assert not flat_tops(np.repeat(values, 4, axis=0)).any()


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_a_clipped_swing_is_saturated_where_it_is_clipped(seed, times):
    t = np.arange(4000) / 100.0
    swing = np.stack([3.0 * np.sin(2.0 * t), np.cos(2.0 * t), 0.0 * t], axis=1)
    swing += np.random.default_rng(seed).normal(0.0, 1e-3, swing.shape)
    clipped = np.clip(swing, -2.0, 2.0)
    flat = flat_tops(np.repeat(clipped, times, axis=0))
    truth = np.repeat(np.abs(swing) >= 2.0, times, axis=0)
    assert not (flat & ~truth).any()
    # Noise lets single samples through at both ends of each clipped stretch.
    assert (flat & truth).sum() > 0.95 * truth.sum()


def test_a_turn_about_another_axis_than_the_vertical_is_reported(bench):
    columns, _ = bench("six-position", 100.0)
    swapped = replace(columns, gyro_rad_s=columns.gyro_rad_s[:, [2, 1, 0]])
    poses = find_poses(swapped)
    with pytest.raises(CalibrationError, match="z was vertical by the accelerometer, but the gyro"):
        known_rotations.find_rotations(swapped, poses, ideal(), 360.0)


def test_a_turn_that_is_no_multiple_is_reported(bench):
    columns, _ = bench("six-position", 100.0)
    poses = find_poses(columns)
    turns = known_rotations.find_rotations(columns, poses, ideal(), 250.0)
    assert len(turns.truth) == 0
    assert len(turns.left_out) == 6
    assert "deg, which is no multiple of 250 deg, so it does not count" in turns.left_out[0]


def test_turns_about_one_axis_are_not_enough():
    about_z = 2 * math.pi * np.array([[0, 0, 1.0], [0, 0, -1.0]] * 3)
    with pytest.raises(CalibrationError, match="each of the unit's three axes vertical in turn"):
        known_rotations.fit_gyro(poses_of(G * FACES), known_rotations.Turns(about_z, about_z))


@pytest.mark.parametrize("order", [[1, 0, 2], [2, 1, 0], [1, 2, 0]])
def test_swapped_gyro_axes_are_reported_without_a_table(bench, order):
    columns, _ = bench("multi-pose", 130.0)
    swapped = replace(columns, gyro_rad_s=columns.gyro_rad_s[:, order])
    poses = find_poses(swapped)
    names = ", ".join("xyz"[k] for k in np.argsort(order))
    with pytest.raises(CalibrationError, match=f"whose x, y, z are {names} of the gyro"):
        pose_rotations.fit_gyro(swapped, poses, multi_pose.fit_accelerometer(poses))


def test_a_mirrored_gyro_axis_is_reported_without_a_table(bench):
    columns, _ = bench("multi-pose", 130.0)
    mirrored = replace(columns, gyro_rad_s=columns.gyro_rad_s * [1.0, -1.0, 1.0])
    poses = find_poses(mirrored)
    with pytest.raises(CalibrationError, match="whose x, y, z are x, -y, z of the gyro"):
        pose_rotations.fit_gyro(mirrored, poses, multi_pose.fit_accelerometer(poses))


def test_a_dead_axis_is_reported():
    force = G * spread(60)
    force[:, 2] = np.random.default_rng(2).normal(0.0, 1e-3, 60)
    with pytest.raises(CalibrationError, match=r"^(accelerometer|the fit does not settle)"):
        multi_pose.fit_accelerometer(poses_of(force))


def test_poses_too_near_to_each_other_for_the_gyros_are_reported(bench):
    columns, _ = bench("multi-pose", 130.0)
    poses = find_poses(columns)
    accel = multi_pose.fit_accelerometer(poses)
    with pytest.raises(CalibrationError, match="2 turns of 20 degrees or more between still poses"):
        pose_rotations.fit_gyro(columns, poses[:3], accel)
