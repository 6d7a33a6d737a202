"""Which effects can be hidden, and which kinds of recording excite each."""

from typing import Final

from ahrs_service.blind.making import motion_physics as motion
from ahrs_service.blind.making import thermal_physics as thermal
from ahrs_service.blind.making.physics import Draw

_ANY: Final = ("bench", "flight", "copter")
_FLYING: Final = ("flight", "copter")
_BENCH: Final = ("bench",)

_OF_EACH_SENSOR: Final = {
    "thermal_bias": (thermal.thermal_bias, _BENCH),
    "thermal_scale": (thermal.thermal_scale, _BENCH),
    "thermal_lag": (thermal.thermal_lag, _BENCH),
    "thermal_rate": (thermal.thermal_rate, _BENCH),
    "thermal_hysteresis": (thermal.thermal_hysteresis, _BENCH),
    "warm_up": (thermal.warm_up, _BENCH),
    "scale_factor": (motion.scale_factor, _ANY),
    "scale_nonlinearity": (motion.scale_nonlinearity, _ANY),
    "misalignment": (motion.misalignment, _ANY),
    "vibration_rectification": (thermal.vibration_rectification, _FLYING),
    "low_pass": (motion.low_pass, _FLYING),
    "saturation": (motion.saturation, _ANY),
    "current_coupling": (thermal.current_coupling, _FLYING),
}

_OF_THE_UNIT: Final[dict[str, tuple[Draw, tuple[str, ...]]]] = {
    "imu_mounting_rotation": (motion.mounting_rotation, _ANY),
    "imu_time_offset": (motion.time_offset, _ANY),
    "imu_clock_drift": (motion.clock_drift, _ANY),
    "gyro_g_sensitivity": (motion.g_sensitivity, _ANY),
    "accel_lever_arm": (motion.lever_arm, _ANY),
    "gyro_earth_rate": (motion.earth_rate, _BENCH),
}

HIDEABLE: Final[dict[str, tuple[Draw, tuple[str, ...]]]] = _OF_THE_UNIT | {
    f"{sensor}_{name}": (make(sensor), kinds)
    for sensor in ("gyro", "accel")
    for name, (make, kinds) in _OF_EACH_SENSOR.items()
}
"""Effect id to (how to draw it, kinds of recording that excite it)."""
