"""The accelerometer as a measure of the vertical: judged by the gates, then taken."""

import math
from typing import Final

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import gating, mekf
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Flag, Floats, Gate, Phase, Record

GRAVITY_FIELDS: Final = [
    ("force_ned_m_s2", "f8", 3),
    ("gate_metrics", "f8", 4),
    ("tilt_innovation_rad", "f8", 2),
    ("gate", "i8"),
]
"""Fields of the pipeline's state that this module keeps."""

ACCEL_CORRELATION_S: Final = 1.0
"""Manoeuvre accelerations last about this long: closer samples are not independent [s]."""
LONGEST_AVERAGE_S: Final = 0.5
"""However long a gap was, the sample after it is one sample [s]."""
DOUBT_RAD_RTS: Final = 0.05
"""How fast the tilt variance grows while only the innovation speaks against it [rad/sqrt(s)]."""

_ALIGNING = int(Phase.ALIGNING)
_RUNNING = int(Phase.RUNNING)
_STALE = int(Gate.STALE)
_SATURATION = int(Gate.SATURATION)
_ACCEL_MISSING = int(Flag.ACCEL_MISSING)
_SATURATED = int(Flag.SATURATED)


@kernel
def _norm(v: Floats) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@inlined_kernel
def judge(settings: Record, state: Record, airframe: int, dt_s: float, flags: int) -> None:
    """Judge the averaged force by the gates; reasons, metrics and innovation go into the state."""
    metrics, tilt, p = state["gate_metrics"], state["tilt_innovation_rad"], state["covariance"]
    metrics[0] = abs(_norm(state["force_ned_m_s2"]) - STANDARD_GRAVITY_M_S2)
    metrics[1] = _norm(state["smooth_rate_rad_s"])
    metrics[2] = _norm(state["angular_acceleration_rad_s2"])
    mekf.tilt_from_force(state["force_ned_m_s2"], tilt)
    spread2 = mekf.tilt_variance(p) + _gravity_variance(settings, airframe)
    metrics[3] = math.sqrt((tilt[0] * tilt[0] + tilt[1] * tilt[1]) / spread2)
    reasons = gating.motion_reasons(
        metrics,
        settings["gate_norm_m_s2"],
        settings["gate_rate_rad_s"],
        settings["gate_angular_acceleration_rad_s2"],
    )
    if flags & _SATURATED:
        reasons |= _SATURATION
    if flags & _ACCEL_MISSING:
        reasons |= _STALE
    if reasons == 0:
        reasons = gating.innovation_reason(metrics[3], settings["gate_innovation_sigma"])
        if reasons != 0 and state["phase"] == _RUNNING:
            # Steady motion that contradicts the attitude: sooner or later the attitude is wrong.
            p[0, 0] += DOUBT_RAD_RTS**2 * dt_s
            p[1, 1] += DOUBT_RAD_RTS**2 * dt_s
    state["gate"] = reasons


@kernel
def _gravity_variance(settings: Record, airframe: int) -> float:
    return float((settings["accel_noise_m_s2"][airframe] / STANDARD_GRAVITY_M_S2) ** 2)


@kernel
def correct(settings: Record, state: Record, airframe: int, flags: int) -> None:
    """Take the averaged force for the vertical while the gates are open, or while aligning."""
    aligning = state["phase"] == _ALIGNING and flags & (_SATURATED | _ACCEL_MISSING) == 0
    if state["gate"] != 0 and not aligning:
        return
    variance = _gravity_variance(settings, airframe)
    if aligning:
        variance += (state["gate_metrics"][0] / STANDARD_GRAVITY_M_S2) ** 2
    variance *= ACCEL_CORRELATION_S / min(state["turn_s"], LONGEST_AVERAGE_S)
    for axis in range(2):
        mekf.correct_tilt(state, axis, variance)
