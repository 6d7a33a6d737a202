"""Heading from the magnetic field: level the field by the tilt, take its azimuth.

Without a usable magnetometer the heading starts at 0 and runs free, with a sigma that grows.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.fusion.mekf import apply_correction, correct_state
from ahrs_service.fusion.strapdown import ERROR_STATES
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record
from ahrs_service.rotation import from_rotation_vector, matrix, multiply, normalise

HEADING_FIELDS: Final = [("field_ut", "f8"), ("heading_source", "i8")]
"""Fields of the pipeline's state: norm of the field at alignment [uT], 1 where mag is in use."""

FIELD_MIN_UT: Final = 20.0
FIELD_MAX_UT: Final = 70.0
"""The Earth's field at the surface lies between 22 and 67 uT (IGRF-14)."""
FIELD_TOLERANCE: Final = 0.2
"""Share by which the norm may differ from that at alignment before it counts as disturbed."""
HEADING_SIGMA_RAD: Final = 0.2
"""Of one azimuth of a fielded magnetometer: 10 deg hard-iron rest and some tilt error [rad]."""
CORRELATION_S: Final = 1.0


@kernel
def _azimuth_error(dcm: Floats, mag: Floats, declination_rad: float) -> float:
    """Error angle about down [rad] that explains the field [3] in body axes."""
    north = dcm[0, 0] * mag[0] + dcm[0, 1] * mag[1] + dcm[0, 2] * mag[2]
    east = dcm[1, 0] * mag[0] + dcm[1, 1] * mag[1] + dcm[1, 2] * mag[2]
    error = declination_rad - math.atan2(east, north)
    return math.atan2(math.sin(error), math.cos(error))


@kernel
def _norm(mag: Floats) -> float:
    return math.sqrt(mag[0] * mag[0] + mag[1] * mag[1] + mag[2] * mag[2])


@kernel
def first_heading(settings: Record, state: Record, mag: Floats) -> None:
    """Turn the aligned attitude to the field's azimuth, if there is a plausible field."""
    norm = _norm(mag)
    state["heading_source"] = 0
    if settings["use_magnetometer"] == 0 or not FIELD_MIN_UT < norm < FIELD_MAX_UT:
        return
    error = _azimuth_error(state["dcm"], mag, settings["declination_rad"])
    turn = from_rotation_vector(0.0, 0.0, error)
    multiply(turn, state["ned_from_body"], state["ned_from_body"])
    normalise(state["ned_from_body"])
    matrix(state["ned_from_body"], state["dcm"])
    state["field_ut"] = norm
    state["heading_source"] = 1
    state["covariance"][2, 2] = HEADING_SIGMA_RAD**2


@kernel
def correct(settings: Record, state: Record, mag: Floats, dt_s: float) -> None:
    """Correct the heading by one field reading [3] [uT], NaN where there is none."""
    norm = _norm(mag)
    if math.isnan(norm) or settings["use_magnetometer"] == 0:
        return
    if state["heading_source"] == 0:
        if state["phase"] == 1:
            first_heading(settings, state, mag)
        return
    if abs(norm - state["field_ut"]) > FIELD_TOLERANCE * state["field_ut"]:
        return
    correction = np.zeros(ERROR_STATES)
    error = _azimuth_error(state["dcm"], mag, settings["declination_rad"])
    variance = HEADING_SIGMA_RAD**2 * max(1.0, CORRELATION_S / dt_s)
    correct_state(state["covariance"], correction, 2, error, variance)
    # A magnetic error must not tilt the horizon through the cross terms.
    correction[0] = correction[1] = 0.0
    apply_correction(
        state["ned_from_body"],
        state["gyro_bias_rad_s"],
        state["velocity_ned_m_s"],
        state["force_ned_m_s2"],
        correction,
    )
    for i in range(3):
        state["turn_impulse_m_s"][i] += correction[6 + i]
    matrix(state["ned_from_body"], state["dcm"])
