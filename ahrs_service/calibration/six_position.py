"""Accelerometer from six positions: each axis up and down in turn, gravity is the reference.

The poses give N = K A + B with A = g times the axis that is up (Liu et al., eq. (1)); with one pose
for each face this is the closed form K_i = (N_i+ - N_i-) / 2g, B = mean of all. What the faces of
the box lack of right angles goes into K and shows in its standard errors.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.calibration.columns import AXES, check_force_unit
from ahrs_service.calibration.poses import directions, span_of, sphere_coverage
from ahrs_service.calibration.triad import TriadFit, check_matrix, check_sigma, fit_triad, rms
from ahrs_service.calibration.verdict import TriadVerdict
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Integers, Rows

FACES: Final = tuple(f"{sign}{axis}" for axis in AXES for sign in ("+", "-"))
"""Which axis of the unit is up, and which end of it: the specific force points up."""

LARGEST_TILT_RAD: Final = math.radians(15.0)
"""Half of what would make a face doubtful: a box on its edge is 45 deg off."""

_UNITS: Final = np.stack([sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0)])


def faces_of(force_m_s2: Floats) -> tuple[Integers, Floats]:
    """Return for each pose [K] the face that is up, an index of FACES, and how far off [rad].

    `force_m_s2` [K, 3] of still poses, as the sensor gives it.
    """
    cosines = directions(force_m_s2) @ _UNITS.T
    faces = np.argmax(cosines, axis=1)
    return faces, np.arccos(np.clip(np.take_along_axis(cosines, faces[:, None], 1)[:, 0], -1, 1))


def fit_accelerometer(poses: Rows, gravity_m_s2: float = STANDARD_GRAVITY_M_S2) -> TriadFit:
    """Return K and B of the accelerometer from poses [K] POSE_DTYPE on all six faces.

    Poses further than 15 deg from any face are for turning, and left out. CalibrationError where a
    face is missing, naming it.
    """
    force = poses["accel_m_s2"]
    check_force_unit(force)
    faces, tilt = faces_of(force) if len(poses) else (np.zeros(0, np.int64), np.zeros(0))
    near = tilt < LARGEST_TILT_RAD
    missing = [face for k, face in enumerate(FACES) if not np.any(faces[near] == k)]
    if missing:
        raise CalibrationError(
            f"{len(poses)} still poses, none of them with {', '.join(missing)} up: put the unit on "
            "each of its six faces, each for two seconds or longer, against something solid"
        )
    fit = _fit(force[near], gravity_m_s2 * _UNITS[faces[near]])
    check_matrix(
        "accelerometer", fit, "one of its axes is swapped, or a pose was not on a face; check them"
    )
    check_sigma("accelerometer", fit, LARGEST_TILT_RAD * gravity_m_s2, "m/s^2")
    return fit


def judge_accelerometer(
    poses: Rows, fit: TriadFit, gravity_m_s2: float = STANDARD_GRAVITY_M_S2
) -> TriadVerdict:
    """Return the figures of the fit; each face is held out in turn and predicted by the others."""
    force = poses["accel_m_s2"]
    faces, tilt = faces_of(force)
    near = tilt < LARGEST_TILT_RAD
    force, faces = force[near], faces[near]
    truth = gravity_m_s2 * _UNITS[faces]
    held_out = np.zeros_like(force)
    for face in range(len(FACES)):
        out = faces == face
        held_out[out] = _fit(force[~out], truth[~out]).compensate(force[out])
    return TriadVerdict(
        triad="accel",
        unit="m/s^2",
        count=len(force),
        rms_before=rms(force - truth),
        rms_after=rms(fit.compensate(force) - truth),
        span_degc=span_of(poses),
        coverage=sphere_coverage(directions(force)),
        condition=fit.condition,
        standard_errors=fit.standard_errors(),
        held_out_before=float(np.sqrt(np.mean((force - truth) ** 2))),
        held_out_after=float(np.sqrt(np.mean((held_out - truth) ** 2))),
    )


def _fit(force: Floats, truth: Floats) -> TriadFit:
    return fit_triad(np.concatenate([truth, np.ones((len(truth), 1))], axis=1), force)
