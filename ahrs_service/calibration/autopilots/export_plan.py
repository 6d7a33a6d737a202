"""What a calibration becomes on an autopilot: parameters, what they lose, and remarks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ahrs_service.calibration.autopilots.compensation_model import Triad
from ahrs_service.calibration.autopilots.loss import Loss
from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats

Values = dict[str, float | int]
"""Parameters by name: a float is a 32-bit one, an int an integer parameter."""


@dataclass(frozen=True, slots=True)
class Export:
    """The parameters of one IMU, in force together.

    `losses` against our model per triad; `switches` are the names that turn the compensation on,
    to be off while the others change; `remarks` are sentences for the user.
    """

    values: Values
    losses: dict[Triad, Loss]
    switches: tuple[str, ...]
    remarks: tuple[str, ...] = ()


def number(value: float) -> float:
    """Return the nearest 32-bit float, as autopilots keep their parameters."""
    return float(np.float32(value))


def vector(parameters: Mapping[str, float], names: Sequence[str]) -> Floats:
    """Return the values of `names`; ValueError names one that is missing or no number."""
    for name in names:
        if name not in parameters:
            raise InvalidValueError(
                f"{name} is missing: give all calibration parameters of the autopilot"
            )
        if not np.isfinite(parameters[name]):
            raise InvalidValueError(f"{name} = {parameters[name]}: is no number")
    return np.array([parameters[name] for name in names], np.float64)
