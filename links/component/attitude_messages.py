"""Our estimate as MAVLink messages, each at its own rate by the samples' own time."""

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.records import Record
from ahrs_service.rotation import to_euler
from ahrs_service.settings import PublishSettings

_MS_PER_WRAP: Final = 1 << 32
_LARGEST: Final = float(np.finfo(np.float32).max)
_NAMES: Final = (b"AhrsGate", b"AhrsResid", b"AhrsSigma")


class Cadence:
    """Decides by data time when a message is due: a replay decides as the live service did.

    The grid of due times starts at the first estimate. Where time goes back, or a gap was longer
    than a second, it starts anew.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = max(1, round(1e9 / rate_hz)) if rate_hz > 0.0 else 0
        self._next_ns: int | None = None

    def due(self, time_ns: int) -> bool:
        """Return whether the estimate of this time [ns] is to be sent."""
        period_ns = self._period_ns
        if not period_ns:
            return False
        late_ns = period_ns if self._next_ns is None else time_ns - self._next_ns
        if self._next_ns is None or not -2 * period_ns < late_ns < 1_000_000_000:
            self._next_ns = time_ns + period_ns
            return True
        # Half a millisecond of stamp jitter must not cost a whole period.
        if late_ns < -500_000:
            return False
        self._next_ns += period_ns * (1 + max(0, late_ns) // period_ns)
        return True


class Publisher:
    """Makes the messages of one estimate that are due."""

    def __init__(self, settings: PublishSettings) -> None:
        self.settings = settings
        self._attitude = Cadence(settings.attitude_rate_hz)
        self._quaternion = Cadence(settings.attitude_quaternion_rate_hz)
        self._named = Cadence(settings.named_value_rate_hz)
        self._euler = np.empty(3)

    def messages(self, estimate: Record) -> list[Any]:
        """Return what is due of this estimate, mostly nothing or one ATTITUDE."""
        time_ns = int(estimate["time_ns"])
        made = []
        if self._attitude.due(time_ns):
            made.append(self.attitude(estimate))
        if self._quaternion.due(time_ns):
            made.append(attitude_quaternion(estimate))
        if self._named.due(time_ns):
            made += named_values(estimate)
        return made

    def attitude(self, estimate: Record) -> Any:
        """Return ATTITUDE of one estimate."""
        to_euler(estimate["ned_from_body"], self._euler)
        return dialect.MAVLink_attitude_message(
            boot_ms(estimate), *self._euler.tolist(), *_float32(estimate["rate_rad_s"].tolist())
        )


def _float32(values: Iterable[float]) -> list[float]:
    """Return values that fit 32 bits: a forged IMU reading must not stop the packing."""
    return [max(min(value, _LARGEST), -_LARGEST) for value in values]


def boot_ms(estimate: Record) -> int:
    """Return the estimate's time as the 32-bit milliseconds of MAVLink."""
    return int(estimate["time_ns"]) // 1_000_000 % _MS_PER_WRAP


def attitude_quaternion(estimate: Record) -> Any:
    """Return ATTITUDE_QUATERNION of one estimate."""
    return dialect.MAVLink_attitude_quaternion_message(
        boot_ms(estimate),
        *estimate["ned_from_body"].tolist(),
        *_float32(estimate["rate_rad_s"].tolist()),
    )


def named_values(estimate: Record) -> list[Any]:
    """Return what ArduPilot can log of us: gate reasons, residual [m/s^2], tilt sigma [rad]."""
    time_ms = boot_ms(estimate)
    values = (
        float(estimate["gate"]),
        math.hypot(*estimate["residual_m_s2"].tolist()),
        max(estimate["attitude_sigma_rad"][:2].tolist()),
    )
    return [
        dialect.MAVLink_named_value_float_message(time_ms, name, value)
        for name, value in zip(_NAMES, _float32(values), strict=True)
    ]
