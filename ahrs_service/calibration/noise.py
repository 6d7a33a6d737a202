"""How far the gate's quantities scatter in steady motion: the S() of its thresholds.

The gate compares abs(norm(f) - g0), norm(w) and norm(dw/dt), of which noise and vibration must not
lock it shut (Liu et al., sec. 4). The deviations are taken from the very values that the gate
compared, as the estimates carry them, so averaging and units are those of the gate.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.calibration.poses import Booleans
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats, Phase, Rows
from ahrs_service.rotation import euler_columns

_BLOCK_S: Final = 5.0  # A choice: long beside vibration, short beside manoeuvres
_STEADY_RAD: Final = math.radians(6.0)
"""A choice: how far roll, pitch and heading may swing in steady motion."""
_LEAST_S: Final = 10.0  # A choice: two blocks
_LEAST_IN_BLOCK: Final = 4  # A choice: with fewer estimates a mean slope and a swing tell nothing
_KNOCK: Final = 10.0
"""A choice: a peak so many times that of the usual block is a knock or a landing."""
_QUANTITIES: Final = ("gate_norm_m_s2", "gate_rate_rad_s", "gate_angular_acceleration_rad_s2")


@dataclass(frozen=True, slots=True)
class GateNoise:
    """S() of the three gates and how long the steady motion was [s] that they come from.

    The names are those of settings.GateBudget.
    """

    norm_sigma_m_s2: float
    rate_sigma_rad_s: float
    angular_acceleration_sigma_rad_s2: float
    steady_s: float


def steady_motion(estimates: Rows) -> Booleans:
    """Return which estimates [N] ESTIMATE_DTYPE are of steady motion.

    Blocks of five seconds while running, in which roll and pitch stay within 6 deg of their
    means and heading, free of its mean slope, too; of them not those in which a quantity of the
    gate reaches further than ten times what it does in the usual block: a knock, a landing.
    """
    time_s = (estimates["time_ns"] - estimates["time_ns"][0]) * 1e-9
    cuts = (np.flatnonzero(np.diff(np.floor(time_s / _BLOCK_S))) + 1).tolist()
    angles = euler_columns(estimates["ned_from_body"])
    blocks = [
        slice(first, last)
        for first, last in zip([0, *cuts], [*cuts, len(estimates)], strict=True)
        if last - first >= _LEAST_IN_BLOCK
        and (estimates["phase"][first:last] == Phase.RUNNING).all()
        and _swing(time_s[first:last], angles[first:last]) < _STEADY_RAD
    ]
    steady = np.zeros(len(estimates), np.bool_)
    values = np.stack([estimates[name] for name in _QUANTITIES], axis=1)
    peaks = np.array([values[block].max(axis=0) for block in blocks]).reshape(-1, 3)
    for block, peak in zip(blocks, peaks, strict=True):
        steady[block] = not (peak > _KNOCK * np.median(peaks, axis=0)).any()
    return steady


def _swing(time_s: Floats, angles: Floats) -> float:
    """Return how far roll, pitch and heading [n, 3] go from mean, mean and mean slope [rad]."""
    swing = np.unwrap(angles, axis=0)
    swing = swing - swing.mean(axis=0)
    swing[:, 2] -= np.polyval(np.polyfit(time_s, swing[:, 2], 1), time_s)
    return float(np.abs(swing).max())


def gate_noise(estimates: Rows, chosen: Booleans | None = None) -> GateNoise:
    """Return S() over the `chosen` estimates, or those of steady motion.

    CalibrationError where they are less than ten seconds in all.
    """
    if not len(estimates):
        raise CalibrationError("the recording holds no estimates: it has no IMU of a vehicle")
    steady = steady_motion(estimates) if chosen is None else chosen
    values = [estimates[name] for name in _QUANTITIES]
    steady = steady & np.isfinite(values).all(axis=0)
    interval_s = float(np.median(np.diff(estimates["time_ns"]))) * 1e-9 if len(steady) > 1 else 0.0
    seconds = float(steady.sum()) * interval_s
    if seconds < _LEAST_S:
        raise CalibrationError(
            f"{seconds:.0f} s of steady motion in the recording: give one with {_LEAST_S:.0f} s or "
            "more of level flight or rest, or say which part is steady with --from and --to"
        )
    norm, rate, acceleration = (float(np.std(value[steady])) for value in values)
    return GateNoise(norm, rate, acceleration, seconds)
