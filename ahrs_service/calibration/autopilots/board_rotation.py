"""Rotation of an autopilot's board against the vehicle: AHRS_ORIENTATION and SENS_BOARD_ROT.

Both count as MAV_SENSOR_ORIENTATION does. A rotation is given by roll, pitch, yaw: about the
vehicle's x axis first, then y, then z. Source: ArduPilot libraries/AP_Math/rotations.h and
tests/test_rotations.cpp (TestEulers); PX4 src/lib/conversion/rotation.h and
src/lib/sensor_calibration/Utilities.cpp (SENS_BOARD_X_OFF and so on rotate the board further) and
Accelerometer.cpp.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats

_EULER_DEG: Final = (
    (0, 0, 0),
    (0, 0, 45),
    (0, 0, 90),
    (0, 0, 135),
    (0, 0, 180),
    (0, 0, 225),
    (0, 0, 270),
    (0, 0, 315),
    (180, 0, 0),
    (180, 0, 45),
    (180, 0, 90),
    (180, 0, 135),
    (0, 180, 0),
    (180, 0, 225),
    (180, 0, 270),
    (180, 0, 315),
    (90, 0, 0),
    (90, 0, 45),
    (90, 0, 90),
    (90, 0, 135),
    (270, 0, 0),
    (270, 0, 45),
    (270, 0, 90),
    (270, 0, 135),
    (0, 90, 0),
    (0, 270, 0),
    (0, 180, 90),
    (0, 180, 270),
    (90, 90, 0),
    (180, 90, 0),
    (270, 90, 0),
    (90, 180, 0),
    (270, 180, 0),
    (90, 270, 0),
    (180, 270, 0),
    (270, 270, 0),
    (90, 180, 90),
    (90, 0, 270),
    (90, 68.8, 293.3),
    (0, 315, 0),
    (90, 315, 0),
    (0, 7, 0),
    (45, 0, 0),
    (315, 0, 0),
)
"""Roll, pitch, yaw [deg] by number; the last three are ArduPilot's alone."""


def body_from_sensor(orientation: int) -> Floats:
    """Return the matrix [3, 3] of a numbered rotation: v_body = matrix @ v_sensor.

    ValueError for a number that means no fixed rotation, as 100 and 101 for custom ones.
    """
    if not 0 <= orientation < len(_EULER_DEG):
        raise InvalidValueError(
            f"orientation {orientation} is none of the fixed rotations 0 to {len(_EULER_DEG) - 1}; "
            "turn the calibration to the sensor's axes yourself and give orientation 0"
        )
    return _matrix(*_EULER_DEG[orientation])


def board_rotation(parameters: Mapping[str, float], imu: int = 1) -> Floats:
    """Return body_from_sensor [3, 3] of an IMU by either autopilot's parameters; else identity.

    PX4 rotates a sensor that is not on its board by CAL_ACCn_ROT, which is -1 for those that are.
    """
    if "AHRS_ORIENTATION" in parameters:
        return body_from_sensor(int(parameters["AHRS_ORIENTATION"]))
    own = int(parameters.get(f"CAL_ACC{imu - 1}_ROT", -1))
    if own >= 0:
        return body_from_sensor(own)
    fine = [parameters.get(f"SENS_BOARD_{axis}_OFF", 0.0) for axis in "XYZ"]
    rotation: Floats = _matrix(*fine) @ body_from_sensor(int(parameters.get("SENS_BOARD_ROT", 0)))
    return rotation


def _matrix(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Floats:
    matrix = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    whole = np.rint(matrix)
    # Rotations by quarters only swap axes: their zeros are exact.
    return np.where(np.abs(matrix - whole) < 1e-12, whole, matrix)
