"""What the service says about itself: one state, reported when it changes."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from ahrs_service.records import Flag, Phase, Record

IMU_SILENCE_S: Final = 0.5
"""Without a sample for this long, or for three usual intervals, there is no IMU [s]."""
LONGEST_INTERVAL_S: Final = 2.0
"""Samples further apart than this are no stream [s]."""
FLAG_HOLD_S: Final = 2.0
"""A fault stays in the state for this long after it was last seen [s]."""

_TOLD: Final = {
    Flag.GAP: "gap in the IMU data",
    Flag.CLOCK_JUMP: "the autopilot's clock jumped",
    Flag.REALIGNED: "aligning anew",
    Flag.ACCEL_MISSING: "accelerometer values are missing",
    Flag.NOT_FINITE: "IMU values are not finite",
    Flag.SATURATED: "IMU out of its range",
    Flag.SPIKE: "gyro spike held back",
    Flag.SOURCE_CHANGED: "IMU message changed",
    Flag.IMU_CHANGED: "another IMU is in use",
    Flag.TEMPERATURE_STALE: "IMU temperature stale or frozen",
    Flag.TEMPERATURE_OUT_OF_RANGE: "IMU temperature outside the calibrated range",
    Flag.UNCOMPENSATED: "not compensated: calibration of another IMU, or no temperature",
    Flag.LOW_RATE: "IMU below 20 Hz: rotation between samples is lost",
}


class Health(Enum):
    """The state of the service."""

    NO_VEHICLE = "no vehicle heard"
    NO_IMU = "no IMU data"
    ALIGNING = "aligning"
    GOOD = "good"
    DEGRADED = "degraded"


@dataclass(slots=True)
class HealthMonitor:
    """Follows estimates and silence; `update` returns a sentence when the state changed."""

    state: Health = Health.NO_VEHICLE
    reasons: tuple[str, ...] = ()
    _last_sample_s: float = -1e9
    _interval_s: float = 0.0
    _phase: int = 0
    _seen_s: dict[Flag, float] = field(default_factory=dict)

    def sample(self, estimate: Record, now_s: float) -> None:
        """Note one estimate; the hot path, so only the rare flags cost."""
        step_s = now_s - self._last_sample_s
        if self._interval_s:
            # One long gap moves the usual interval little.
            step_s = min(step_s, 3.0 * self._interval_s)
            self._interval_s += 0.1 * (step_s - self._interval_s)
        elif step_s < LONGEST_INTERVAL_S:
            self._interval_s = step_s
        self._last_sample_s = now_s
        self._phase = int(estimate["phase"])
        flags = int(estimate["flags"])
        if self._phase != Phase.RUNNING:
            # Before the first attitude the best message is still being found.
            flags &= ~Flag.SOURCE_CHANGED.value
        if flags:
            for flag in _TOLD:
                if flags & flag.value:
                    self._seen_s[flag] = now_s

    def update(self, vehicle_heard: bool, now_s: float) -> str:
        """Return what changed since the last call, or an empty string."""
        reasons = tuple(
            text
            for flag, text in _TOLD.items()
            if now_s - self._seen_s.get(flag, -1e9) < FLAG_HOLD_S
        )
        state = self._judge(vehicle_heard, now_s, reasons)
        if state is self.state and reasons == self.reasons:
            return ""
        self.state, self.reasons = state, reasons
        return "; ".join((state.value, *reasons))

    def _judge(self, vehicle_heard: bool, now_s: float, reasons: tuple[str, ...]) -> Health:
        if not vehicle_heard:
            return Health.NO_VEHICLE
        if now_s - self._last_sample_s > max(IMU_SILENCE_S, 3.0 * self._interval_s):
            return Health.NO_IMU
        if self._phase != Phase.RUNNING:
            return Health.ALIGNING
        return Health.DEGRADED if reasons else Health.GOOD
