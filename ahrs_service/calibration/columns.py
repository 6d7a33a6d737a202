"""What every procedure begins with: one IMU's columns as it sent them, and what is wrong there."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats

AXES: Final = ("x", "y", "z")

_UNITS: Final = ((1000.0, "mG"), (1.0, "g"), (1e5 / STANDARD_GRAVITY_M_S2, "cm/s^2 or mm/s^2"))
"""What 1 g reads in each; the last is 10197, 4 % above the mm/s^2 (9807), a choice."""
_UNIT_TOLERANCE: Final = 0.2
"""A fifth: no sensor worth calibrating is so far off; mG from g differ by a thousand."""
_FLAT_TOP: Final = 3
"""A choice: an extreme so often on end is the end of a range, of noise of many steps."""
_FLAT_TOP_JUMP: Final = 10.0
"""A choice: usual steps that lead to the end of a range where noise is coarse."""
_FINE: Final = 30.0
"""A choice: steps of resolution in the usual change that make noise one of many steps."""


@dataclass(frozen=True, slots=True)
class ImuColumns:
    """The output of one IMU, not compensated: the columns of a recording or of a live session.

    `time_s` [N] [s], rising; rate [N, 3] [rad/s], specific force [N, 3] [m/s^2] (about 9.8 up at
    rest), temperature [N] [degC] of the IMU itself, NaN where not known.
    """

    time_s: Floats
    gyro_rad_s: Floats
    accel_m_s2: Floats
    temperature_degc: Floats

    @property
    def interval_s(self) -> float:
        """Usual time between samples [s], NaN for fewer than two."""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else np.nan

    def part(self, first: int, last: int) -> "ImuColumns":
        """Return the samples `first` up to `last`, not with it."""
        place = slice(first, last)
        return ImuColumns(
            self.time_s[place],
            self.gyro_rad_s[place],
            self.accel_m_s2[place],
            self.temperature_degc[place],
        )


def check_force_unit(force_m_s2: Floats) -> None:
    """Raise CalibrationError where the force [K, 3] of still poses is not in m/s^2.

    The norm at rest is gravity within a fifth for any sensor that is worth calibrating.
    """
    if not len(force_m_s2):
        return
    norm = float(np.median(np.linalg.norm(force_m_s2, axis=1)))
    if abs(norm / STANDARD_GRAVITY_M_S2 - 1.0) <= _UNIT_TOLERANCE:
        return
    for one_g, unit in _UNITS:
        if abs(norm / one_g - 1.0) <= _UNIT_TOLERANCE:
            raise CalibrationError(
                f"the specific force at rest is {norm:.4g}: this is in {unit}; convert it to m/s^2 "
                f"(multiply by {STANDARD_GRAVITY_M_S2 / one_g:.6g})"
            )
    raise CalibrationError(
        f"the specific force at rest is {norm:.4g} m/s^2 instead of about 9.8: choose another IMU "
        "message (--imu), or check the unit and the range that the accelerometer is set to"
    )


def check_stream_unit(columns: ImuColumns) -> None:
    """Raise CalibrationError where the force is in another unit, before anything was seen still.

    In motion the norm is no gravity, but not half or twice of it for most of the time.
    """
    norm = np.linalg.norm(columns.accel_m_s2, axis=1)
    if not 0.5 < float(np.median(norm)) / STANDARD_GRAVITY_M_S2 < 2.0:
        check_force_unit(columns.accel_m_s2)


def check_temperature(temperature_degc: Floats, least_span_k: float = 0.0) -> None:
    """Raise CalibrationError where temperatures [N] are missing or span less than is needed."""
    known = temperature_degc[np.isfinite(temperature_degc)]
    if len(known) < max(1, len(temperature_degc) // 2):
        raise CalibrationError(
            "the IMU's own temperature is missing: record SCALED_IMU or RAW_IMU of an autopilot "
            "that fills in its temperature (a barometer's is another place's)"
        )
    span = float(np.ptp(known))
    if least_span_k and span < least_span_k:
        raise CalibrationError(
            f"the temperature is constant, {span:.1f} degC of span around "
            f"{np.median(known):.0f} degC: cool the unit, and record while it warms up by "
            f"{least_span_k:.0f} degC or more"
        )


def flat_tops(values: Floats) -> npt.NDArray[np.bool_]:
    """Return which of `values` [N, 3] are at an end of their axis's range.

    There the same extreme value comes three times or more on end, which noise does not do where it
    spans many steps of the sensor's resolution (thirty). Where it does not, a jump of ten times
    the usual step must lead there: a coarse but quiet sensor lacks it. Samples sent twice, the same
    on all axes, count once.
    """
    if len(values) < 2:
        return np.zeros(values.shape, np.bool_)
    is_new = np.concatenate([[True], (np.diff(values, axis=0) != 0.0).any(axis=1)])
    fresh = values[is_new]
    flat = np.stack([_flat_top(column) for column in fresh.T], axis=1)
    return flat[np.cumsum(is_new) - 1]


def _flat_top(column: Floats) -> npt.NDArray[np.bool_]:
    flat = np.zeros(len(column), np.bool_)
    steps = np.abs(np.diff(column))
    if not steps.any():
        return flat
    usual = float(np.median(steps[steps > 0.0]))
    fine = float(np.min(np.diff(np.unique(column)))) * _FINE < usual
    for extreme in (column.max(), column.min()):
        edges = np.diff(np.concatenate([[0], column == extreme, [0]]).astype(np.int8))
        at = np.flatnonzero(edges)
        for first, last in zip(at[::2], at[1::2], strict=True):
            into = steps[first - 1] if first > 0 else 0.0
            out_of = steps[last - 1] if last < len(column) else 0.0
            jump = fine or max(into, out_of) > _FLAT_TOP_JUMP * usual
            if last - first >= _FLAT_TOP and jump:
                flat[first:last] = True
    return flat


def check_saturation(columns: ImuColumns) -> None:
    """Raise CalibrationError where gyros or accelerometers ran into the end of their range."""
    for name, values, unit in (
        ("gyro", columns.gyro_rad_s, "rad/s"),
        ("accelerometer", columns.accel_m_s2, "m/s^2"),
    ):
        for axis in np.flatnonzero(flat_tops(values).any(axis=0)):
            limit = float(np.abs(values[:, axis]).max())
            raise CalibrationError(
                f"{name} {AXES[axis]} is saturated at {limit:.4g} {unit}: turn and put down the "
                "unit more slowly, or set the sensor to a wider range, and record again"
            )
