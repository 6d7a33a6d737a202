"""How messages become readings: one table of rules, for single messages and for columns."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.links.mavlink.gps_velocity import velocity_of_raw_int
from ahrs_service.links.mavlink.vehicle_trim import trim_of_parameter
from ahrs_service.records import ImuSource, Kind

_MG: Final = 1e-3 * STANDARD_GRAVITY_M_S2
_UT_PER_GAUSS: Final = 100.0


@dataclass(frozen=True, slots=True)
class Part:
    """Message fields that fill one field of a reading: value * scale.

    `bits` of `fields_updated` must all be set, else NaN; with `zero_is_none` all-zero is NaN.
    """

    into: str
    fields: tuple[str, ...]
    scale: float = 1.0
    bits: int = 0
    zero_is_none: bool = False


@dataclass(frozen=True, slots=True)
class Conversion:
    """Message fields that one function converts to one field of a reading; None is no reading."""

    into: str
    fields: tuple[str, ...]
    values: Callable[..., tuple[float, ...] | None]


@dataclass(frozen=True, slots=True)
class Rule:
    """How one message becomes a reading: by its parts, or by a conversion.

    `sources` by the message's `id` (a higher id gives no reading), `time` field and [ns] per unit.
    """

    kind: Kind
    parts: tuple[Part, ...] = ()
    conversion: Conversion | None = None
    time: tuple[str, int] | None = None
    sources: tuple[ImuSource, ...] = (ImuSource.NONE,)
    has_id: bool = False
    has_updated: bool = False
    is_heartbeat: bool = False


ACCEL = ("xacc", "yacc", "zacc")
GYRO = ("xgyro", "ygyro", "zgyro")
_MAG = ("xmag", "ymag", "zmag")

_HIGHRES_PARTS: Final = (
    Part("gyro_rad_s", GYRO, bits=0x38),
    Part("accel_m_s2", ACCEL, bits=0x07),
    Part("mag_ut", _MAG, _UT_PER_GAUSS, bits=0x1C0, zero_is_none=True),
    Part("temperature_degc", ("temperature",), bits=0x1000, zero_is_none=True),
)
_INT16_PARTS: Final = (
    Part("gyro_rad_s", GYRO, 1e-3),
    Part("accel_m_s2", ACCEL, _MG),
    Part("mag_ut", _MAG, 1e-3 * _UT_PER_GAUSS, zero_is_none=True),
    Part("temperature_degc", ("temperature",), 1e-2, zero_is_none=True),
)


def _scaled(source: ImuSource) -> Rule:
    return Rule(Kind.IMU, _INT16_PARTS, time=("time_boot_ms", 1_000_000), sources=(source,))


RULES: Final[dict[str, Rule]] = {
    "HEARTBEAT": Rule(Kind.HEARTBEAT, is_heartbeat=True),
    "HIGHRES_IMU": Rule(
        Kind.IMU,
        _HIGHRES_PARTS,
        time=("time_usec", 1000),
        sources=(ImuSource.HIGHRES_IMU, ImuSource.HIGHRES_IMU_1, ImuSource.HIGHRES_IMU_2),
        has_id=True,
        has_updated=True,
    ),
    "RAW_IMU": Rule(
        Kind.IMU, _INT16_PARTS, time=("time_usec", 1000), sources=(ImuSource.RAW_IMU,), has_id=True
    ),
    "SCALED_IMU": _scaled(ImuSource.SCALED_IMU),
    "SCALED_IMU2": _scaled(ImuSource.SCALED_IMU2),
    "SCALED_IMU3": _scaled(ImuSource.SCALED_IMU3),
    "VFR_HUD": Rule(Kind.AIRSPEED, (Part("airspeed_m_s", ("airspeed",)),)),
    "LOCAL_POSITION_NED": Rule(
        Kind.VELOCITY,
        (Part("velocity_ned_m_s", ("vx", "vy", "vz")),),
        time=("time_boot_ms", 1_000_000),
    ),
    "GLOBAL_POSITION_INT": Rule(
        Kind.GLOBAL_VELOCITY,
        (Part("velocity_ned_m_s", ("vx", "vy", "vz"), 1e-2, zero_is_none=True),),
        time=("time_boot_ms", 1_000_000),
    ),
    "GPS_RAW_INT": Rule(
        Kind.GPS,
        conversion=Conversion("velocity_ned_m_s", ("fix_type", "vel", "cog"), velocity_of_raw_int),
        time=("time_usec", 1000),
    ),
    "PARAM_VALUE": Rule(
        Kind.TRIM,
        conversion=Conversion("trim_rad", ("param_id", "param_value"), trim_of_parameter),
    ),
}
"""Messages that carry readings, by name.

RAW_IMU is read in mG, mrad/s, mgauss, as ArduPilot sends it; `TlogLog.recording` notes where its
size indicates raw counts. A message whose accel and gyro are all exactly zero is from an IMU
that does not exist and gives no reading; nor does one with neither updated. HIGHRES_IMU with
`fields_updated` 0 comes from senders that do not fill it: all its fields count as updated.
GLOBAL_POSITION_INT is all zero while the autopilot has no velocity. PARAM_VALUE gives the trim.
Source: mavlink.io, common message set.
"""
