"""Time stamps that differ from the time of sampling."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline

from ahrs_service.effects.base import Addition, Columns, Effect, Parameter, Triad, Values
from ahrs_service.records import Floats


def late(columns: Columns, delay_s: Floats) -> tuple[Floats, Floats]:
    """Return u(t - delay) - u(t) of both triads, by cubic splines; held beyond the ends."""
    time_s = columns.time_s
    taken_s = np.clip(time_s - delay_s, time_s[0], time_s[-1])
    gyro, accel = (_moved(time_s, taken_s, u) for u in (columns.rate_rad_s, columns.force_m_s2))
    return gyro, accel


def _moved(time_s: Floats, taken_s: Floats, u: Floats) -> Floats:
    moved = CubicSpline(time_s, u)(taken_s) - u
    moved[taken_s == time_s] = 0.0
    return np.asarray(moved)


@dataclass(frozen=True)
class LateStamps(Effect):
    """u(t - delay) - u(t): every sample is stamped `delay_s` late."""

    triads: ClassVar[tuple[Triad, ...]] = ("imu",)
    alters_motion: ClassVar[bool] = True
    is_timing: ClassVar[bool] = True

    @abstractmethod
    def delay_s(self, time_s: Floats, values: Values) -> Floats:
        """Return how late the stamps `time_s` [N] are [N] [s]."""

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the difference of late and true readings."""
        return Addition(*late(columns, self.delay_s(columns.time_s, values)))


@dataclass(frozen=True)
class TimeOffset(LateStamps):
    """u(t - offset) - u(t)."""

    name: ClassVar[str] = "time_offset"
    title: ClassVar[str] = "samples stamped late"
    equation: ClassVar[str] = "u(t - offset) - u(t), both triads"
    excited_by: ClassVar[str] = "hard, short manoeuvres"
    taken_for: ClassVar[tuple[str, ...]] = ("gyro_low_pass", "accel_low_pass", "clock_drift")
    separated_by: ClassVar[str] = "shake the vehicle by hand at 1 to 5 Hz at both ends of a log"
    not_live: ClassVar[str] = (
        "the step takes stamps as they come; shift the stamps, or the timing of the link"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: GNSS lag of 120 to 220 ms (ArduPilot issues 2850, 5405)."""
        source = "ArduPilot issues 2850 and 5405"
        return (Parameter("offset_s", "s", (), 0.25, source, step=1e-3),)

    def delay_s(self, time_s: Floats, values: Values) -> Floats:
        """Return the offset at every stamp."""
        return np.full(len(time_s), values["offset_s"])


@dataclass(frozen=True)
class ClockDrift(LateStamps):
    """u(t - ppm (t - t0)) - u(t)."""

    name: ClassVar[str] = "clock_drift"
    title: ClassVar[str] = "clock of the IMU running at another rate"
    equation: ClassVar[str] = "u(t - 1e-6 ppm (t - t0)) - u(t), both triads"
    excited_by: ClassVar[str] = "hard manoeuvres at both ends of a long log"
    taken_for: ClassVar[tuple[str, ...]] = ("time_offset",)
    separated_by: ClassVar[str] = "shake the vehicle by hand at the beginning and the end of a log"
    not_live: ClassVar[str] = "the step takes stamps as they come; correct the clock of the sender"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: 1 % of an internal RC oscillator with margin."""
        source = "MPU-6000 data sheet: internal oscillator"
        return (Parameter("ppm", "1e-6", (), 20000.0, source, step=1.0),)

    def delay_s(self, time_s: Floats, values: Values) -> Floats:
        """Return what the clock has lost since the first stamp."""
        return np.asarray(1e-6 * values["ppm"] * (time_s - time_s[0]))
