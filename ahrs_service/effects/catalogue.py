"""The effects that are known, by id."""

from typing import Final

from ahrs_service.effects.base import Effect
from ahrs_service.effects.current_coupling import CurrentCoupling
from ahrs_service.effects.earth_rate import EarthRate
from ahrs_service.effects.g_sensitivity import GSensitivity
from ahrs_service.effects.lever_arm import LeverArm
from ahrs_service.effects.low_pass import LowPass
from ahrs_service.effects.misalignment import Misalignment
from ahrs_service.effects.mounting_rotation import MountingRotation
from ahrs_service.effects.saturation import Saturation
from ahrs_service.effects.scale_factor import ScaleFactor
from ahrs_service.effects.scale_nonlinearity import ScaleNonlinearity
from ahrs_service.effects.thermal_bias import ThermalBias
from ahrs_service.effects.thermal_hysteresis import ThermalHysteresis
from ahrs_service.effects.thermal_lag import ThermalLag
from ahrs_service.effects.thermal_rate import ThermalRate
from ahrs_service.effects.thermal_scale import ThermalScale
from ahrs_service.effects.timing import ClockDrift, TimeOffset
from ahrs_service.effects.vibration_rectification import VibrationRectification
from ahrs_service.effects.warm_up import WarmUp

_OF_EITHER_TRIAD: Final[tuple[type[Effect], ...]] = (
    ScaleFactor,
    Misalignment,
    ScaleNonlinearity,
    LowPass,
    Saturation,
    ThermalBias,
    ThermalScale,
    ThermalLag,
    ThermalRate,
    ThermalHysteresis,
    WarmUp,
    VibrationRectification,
    CurrentCoupling,
)

_ALL: Final[tuple[Effect, ...]] = (
    TimeOffset("imu"),
    ClockDrift("imu"),
    MountingRotation("imu"),
    *(kind("gyro") for kind in _OF_EITHER_TRIAD),
    *(kind("accel") for kind in _OF_EITHER_TRIAD),
    GSensitivity("gyro"),
    EarthRate("gyro"),
    LeverArm("accel"),
)

EFFECTS: Final[dict[str, Effect]] = {effect.id: effect for effect in _ALL}


def effect_of(identifier: str) -> Effect:
    """Return the effect of an id; ValueError names those there are."""
    if identifier not in EFFECTS:
        raise ValueError(f"{identifier} is no known effect; there are {', '.join(EFFECTS)}")
    return EFFECTS[identifier]
