"""How far the gate's quantities scatter in steady motion: the S() of its thresholds.

The gate compares abs(norm(f) - g0), norm(w) and norm(dw/dt), of which noise and vibration must not
lock it shut (Liu et al., sec. 4). The deviations are taken from the very values that the gate
compared, as the estimates carry them, so averaging and units are those of the gate.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.calibration.errors import CalibrationError
from ahrs_service.calibration.poses import Booleans
from ahrs_service.records import Phase, Rows
from ahrs_service.rotation import euler_columns

_BLOCK_S: Final = 5.0
_STEADY_RAD: Final = math.radians(3.0)
_LEAST_S: Final = 10.0


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
    """Tell which estimates [N] ESTIMATE_DTYPE are of steady motion.

    Blocks of five seconds while running, in which roll and pitch stay within 3 deg of their
    means and heading, free of its mean slope, too. Nothing is asked of the accelerometer, whose
    scatter is what is looked for.
    """
    time_s = (estimates["time_ns"] - estimates["time_ns"][0]) * 1e-9
    block = np.floor(time_s / _BLOCK_S).astype(np.int64)
    angles = euler_columns(estimates["ned_from_body"])
    steady = np.zeros(len(estimates), np.bool_)
    for first, last in zip(*_edges(block), strict=True):
        place = slice(first, last)
        if (estimates["phase"][place] != Phase.RUNNING).any() or last - first < 8:
            continue
        swing = np.unwrap(angles[place], axis=0)
        swing = swing - swing.mean(axis=0)
        slope = np.polyfit(time_s[place], swing[:, 2], 1)
        swing[:, 2] -= np.polyval(slope, time_s[place])
        steady[place] = np.abs(swing).max() < _STEADY_RAD
    return steady


def _edges(block: Rows) -> tuple[list[int], list[int]]:
    cuts = (np.flatnonzero(np.diff(block)) + 1).tolist()
    return [0, *cuts], [*cuts, len(block)]


def gate_noise(estimates: Rows, chosen: Booleans | None = None) -> GateNoise:
    """Return S() over the `chosen` estimates, or those of steady motion.

    CalibrationError where they are less than ten seconds in all.
    """
    if not len(estimates):
        raise CalibrationError("the recording holds no estimates: it has no IMU of a vehicle")
    steady = steady_motion(estimates) if chosen is None else chosen
    values = [
        estimates[name]
        for name in ("gate_norm_m_s2", "gate_rate_rad_s", "gate_angular_acceleration_rad_s2")
    ]
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
