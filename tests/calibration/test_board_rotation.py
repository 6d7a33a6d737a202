import re

import numpy as np
import pytest

from ahrs_service.calibration.autopilots.board_rotation import board_rotation, body_from_sensor
from ahrs_service.links.mavlink.codec import dialect

NAMES = {
    number: entry.name.removeprefix("MAV_SENSOR_ROTATION_")
    for number, entry in dialect.enums["MAV_SENSOR_ORIENTATION"].items()
    if number < 100
}


def about(axis, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"ROLL": (1, 2), "PITCH": (2, 0), "YAW": (0, 1)}[axis]
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = c
    turn[i, j], turn[j, i] = -s, s
    return turn


@pytest.mark.parametrize("number", sorted(NAMES))
def test_each_rotation_is_what_its_name_says(number):
    """MAVLink's names give whole degrees: 38 is in truth pitch 68.8, yaw 293.3."""
    expected = np.eye(3)
    for axis, degrees in re.findall(r"(ROLL|PITCH|YAW)_(\d+)", NAMES[number]):
        expected = about(axis, float(degrees)) @ expected
    atol = 0.02 if number == 38 else 1e-12
    np.testing.assert_allclose(body_from_sensor(number), expected, atol=atol)


def test_the_odd_one_as_px4_writes_it():
    """src/lib/conversion/rotation.h, ROTATION_ROLL_90_PITCH_68_YAW_293."""
    np.testing.assert_allclose(
        body_from_sensor(38),
        [
            [0.14303897, 0.36877649, -0.91844638],
            [-0.33213278, -0.85628942, -0.39554550],
            [-0.93232380, 0.36162457, 0.0],
        ],
        atol=1e-7,
    )


def test_the_parameters_of_both_autopilots():
    np.testing.assert_array_equal(board_rotation({}), np.eye(3))
    np.testing.assert_array_equal(board_rotation({"AHRS_ORIENTATION": 16.0}), body_from_sensor(16))
    turned = board_rotation({"SENS_BOARD_ROT": 4, "SENS_BOARD_X_OFF": 2.0, "SENS_BOARD_Z_OFF": 1.0})
    expected = about("YAW", 1.0) @ about("ROLL", 2.0) @ about("YAW", 180.0)
    np.testing.assert_allclose(turned, expected, atol=1e-12)
    outside = board_rotation({"SENS_BOARD_ROT": 4, "CAL_ACC0_ROT": -1, "CAL_ACC1_ROT": 2}, 2)
    np.testing.assert_array_equal(outside, body_from_sensor(2))
    inside = board_rotation({"SENS_BOARD_ROT": 4, "CAL_ACC0_ROT": -1, "CAL_ACC1_ROT": 2})
    np.testing.assert_array_equal(inside, body_from_sensor(4))


@pytest.mark.parametrize("number", [-1, 44, 100, 101])
def test_no_fixed_rotation(number):
    with pytest.raises(ValueError, match=f"orientation {number} is none"):
        body_from_sensor(number)
