"""The accelerometer as a measure of the vertical: judged by the gates, then taken."""

import math
from typing import Final

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import filter_state, gating, mekf
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Flag, Floats, Gate, Phase, Record

GRAVITY_FIELDS: Final = [
    ("gate_metrics", "f8", 4),
    ("tilt_innovation_rad", "f8", 2),
    ("gate", "i8"),
]
"""Fields of the pipeline's state that this module keeps."""

ACCEL_CORRELATION_S: Final = 1.0
"""Manoeuvre accelerations last about this long: closer samples are not independent [s]."""
TURNING_ONE_WAY: Final = 2.0
"""How far a vehicle turns until its centripetal acceleration points another way [rad]."""
LONGEST_AVERAGE_S: Final = 0.5
"""However long a gap was, the sample after it is one sample [s]."""
DOUBT_RAD_RTS: Final = 0.05
"""How fast the tilt variance grows while only the innovation contradicts it [rad/sqrt(s)]."""

_ALIGNING = int(Phase.ALIGNING)
_RUNNING = int(Phase.RUNNING)
_RATE = int(Gate.RATE)
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
            for axis in range(2):
                filter_state.widen(state, axis, DOUBT_RAD_RTS**2 * dt_s)
    state["gate"] = reasons


@kernel
def _gravity_variance(settings: Record, airframe: int) -> float:
    return float((settings["accel_noise_m_s2"][airframe] / STANDARD_GRAVITY_M_S2) ** 2)


@inlined_kernel
def _turning_variance(state: Record) -> float:
    """Variance [rad^2] of what a velocity v that turns along with the vehicle adds, at rate r.

    The gates admit a slow circle: its acceleration v r is small, but points one way for about 1 / r
    to either side, where the variance is that of an acceleration of `ACCEL_CORRELATION_S`.
    """
    velocity, wind, dcm = state["velocity_ned_m_s"], state["wind_ned_m_s"], state["dcm"]
    rate = state["smooth_rate_rad_s"]
    turn = abs(dcm[2, 0] * rate[0] + dcm[2, 1] * rate[1] + dcm[2, 2] * rate[2])
    north, east = velocity[0] - wind[0], velocity[1] - wind[1]
    per_s = TURNING_ONE_WAY / ACCEL_CORRELATION_S
    return float(per_s * turn * (north * north + east * east) / STANDARD_GRAVITY_M_S2**2)


@kernel
def correct(settings: Record, state: Record, airframe: int, flags: int) -> None:
    """Use the averaged force as the vertical while the gates are open, or while aligning.

    What begins with a turn of a vehicle that flies by its speed is in the air, and aligns by that.
    """
    aligning = state["phase"] == _ALIGNING and flags & (_SATURATED | _ACCEL_MISSING) == 0
    speed = settings["forward_speed_m_s"][airframe] if settings["use_velocity"] != 0 else 0.0
    if speed > 0.0 and state["gate"] & _RATE != 0:
        aligning = False
    if state["gate"] != 0 and not aligning:
        return
    variance = _gravity_variance(settings, airframe) + _turning_variance(state)
    if aligning:
        # What the norm shows of an acceleration, and that of a turn at the speed of the class.
        turned = speed * state["gate_metrics"][1]
        shown2 = state["gate_metrics"][0] ** 2 + turned * turned
        variance += shown2 / STANDARD_GRAVITY_M_S2**2
    variance *= ACCEL_CORRELATION_S / min(state["update_s"], LONGEST_AVERAGE_S)
    for axis in range(2):
        mekf.correct_tilt(state, axis, variance)
