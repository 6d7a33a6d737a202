"""What no sensor can have measured, and what it has clipped or left as it was."""

from typing import Final

from ahrs_service.fusion import timebase
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Flag, Floats, Record

_NOT_FINITE = int(Flag.NOT_FINITE)
_ACCEL_MISSING = int(Flag.ACCEL_MISSING)
_SPIKE = int(Flag.SPIKE)
_SATURATED = int(Flag.SATURATED)

IMPOSSIBLE_RATE_RAD_S: Final = 1000.0
"""14 times the 4000 deg/s of the widest MEMS range [rad/s]."""
IMPOSSIBLE_FORCE_M_S2: Final = 1e4
"""No sensor measures this; NaN and infinity are not below it either."""
SPIKE_RATE_RAD_S: Final = 10.0
"""No airframe changes its rate by this much between two samples [rad/s]."""

STUCK_SAMPLES: Final = 10
"""An axis that reads the very same number so often while another one moves is stuck: at rest coarse
readings of BROAD do so up to 11 times, in turns up to 4."""
TURNING_RAD_S: Final = 0.2
"""A choice: 11 deg/s, above the 0.15 rad/s that a turn-on bias reaches (alignment) [rad/s]."""

PLAUSIBILITY_FIELDS: Final = [
    ("spikes", "i8"),
    ("spike_time_ns", "i8"),
    ("raw_before_rad_s", "f8", 3),
    ("repeats", "i8", 3),
    ("gyro_is_unobserved", "i8", 3),
    ("unobserved_s", "f8", 3),
]
"""Fields of the pipeline's state that this module keeps; the last: how often each axis of the gyro
showed the number before again, whether it clips or is stuck, and for how long it was [s]."""


@inlined_kernel
def _find_unobserved(state: Record, raw: Floats, range_rad_s: float) -> bool:
    """Find axes of the gyro that clip, or stood still while the vehicle rotated; whether any is."""
    before, repeats, blind = (
        state["raw_before_rad_s"],
        state["repeats"],
        state["gyro_is_unobserved"],
    )
    moved = raw[0] != before[0] or raw[1] != before[1] or raw[2] != before[2]
    rotates = raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] > TURNING_RAD_S**2
    found = False
    for i in range(3):
        if raw[i] != before[i]:
            repeats[i] = 0
        elif moved:
            repeats[i] += 1
        before[i] = raw[i]
        # Exactly 0 is an axis of a simulation with no rotation about it.
        stuck = rotates and repeats[i] >= STUCK_SAMPLES and raw[i] != 0.0
        blind[i] = 1 if stuck or abs(raw[i]) >= range_rad_s else 0
        if blind[i] == 0:
            state["unobserved_s"][i] = 0.0
        found = found or blind[i] != 0
    return found


@kernel
def count_blind(state: Record, axis: int, dt_s: float) -> float:
    """Count how long an axis is not known; return by how much the square of that grew [s^2]."""
    before_s = state["unobserved_s"][axis]
    state["unobserved_s"][axis] = before_s + dt_s
    return float(dt_s * (2.0 * before_s + dt_s))


@inlined_kernel
def check(settings: Record, state: Record, sample: Record, gyro: Floats, accel: Floats) -> int:
    """Find clipped, stuck, missing and impossible values; a single impossible rate is held back."""
    flags = 0
    gyro_finite = accel_finite = True
    clipped = False
    jump2 = 0.0
    for i in range(3):
        gyro_finite = gyro_finite and abs(gyro[i]) < IMPOSSIBLE_RATE_RAD_S
        accel_finite = accel_finite and abs(accel[i]) < IMPOSSIBLE_FORCE_M_S2
        clipped = clipped or abs(sample["accel_m_s2"][i]) >= settings["accel_range_m_s2"]
        jump2 += (gyro[i] - state["rate_rad_s"][i] - state["gyro_bias_rad_s"][i]) ** 2
    if not gyro_finite:
        return _NOT_FINITE
    if _find_unobserved(state, sample["gyro_rad_s"], settings["gyro_range_rad_s"]) or clipped:
        flags |= _SATURATED
    if not accel_finite:
        flags |= _ACCEL_MISSING
    known = state["samples"] > 1 and state["interval_s"] < timebase.LOW_RATE_INTERVAL_S
    # The same sample again confirms nothing.
    confirmed = state["spikes"] != 0 and sample["time_ns"] != state["spike_time_ns"]
    if known and jump2 > SPIKE_RATE_RAD_S**2 and not confirmed:
        state["spikes"] = 1
        state["spike_time_ns"] = sample["time_ns"]
        return flags | _SPIKE
    state["spikes"] = 0
    return flags
