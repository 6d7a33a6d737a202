"""What no sensor can have measured, and what it has clipped, before the filter sees it."""

from typing import Final

from ahrs_service.fusion import timebase
from ahrs_service.kernel import inlined_kernel
from ahrs_service.records import Flag, Floats, Record

_NOT_FINITE = int(Flag.NOT_FINITE)
_ACCEL_MISSING = int(Flag.ACCEL_MISSING)
_SPIKE = int(Flag.SPIKE)
_SATURATED = int(Flag.SATURATED)

IMPOSSIBLE_RATE_RAD_S: Final = 1000.0
IMPOSSIBLE_FORCE_M_S2: Final = 1e4
"""No sensor measures this; NaN and infinity are not below it either."""
SPIKE_RATE_RAD_S: Final = 10.0
"""No airframe changes its rate by this much between two samples [rad/s]."""

PLAUSIBILITY_FIELDS: Final = [("spikes", "i8"), ("spike_time_ns", "i8")]
"""Fields of the pipeline's state that this module keeps."""


@inlined_kernel
def check(settings: Record, state: Record, sample: Record, gyro: Floats, accel: Floats) -> int:
    """Find clipped, missing and impossible values; a single impossible rate is held back."""
    flags = 0
    gyro_finite = accel_finite = True
    clipped = False
    jump2 = 0.0
    for i in range(3):
        gyro_finite = gyro_finite and abs(gyro[i]) < IMPOSSIBLE_RATE_RAD_S
        accel_finite = accel_finite and abs(accel[i]) < IMPOSSIBLE_FORCE_M_S2
        clipped = clipped or abs(sample["gyro_rad_s"][i]) >= settings["gyro_range_rad_s"]
        clipped = clipped or abs(sample["accel_m_s2"][i]) >= settings["accel_range_m_s2"]
        jump2 += (gyro[i] - state["rate_rad_s"][i] - state["gyro_bias_rad_s"][i]) ** 2
    if not gyro_finite:
        return _NOT_FINITE
    if clipped:
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
