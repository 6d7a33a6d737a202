"""Encoding of a parameter's value in PARAM_SET and PARAM_VALUE, as a 32-bit float field.

ArduPilot casts: the integer 5 is sent as 5.0. PX4 sends the bytes of the integer in place of
those of the float. Source: mavlink.io, Parameter Protocol, "Parameter encoding"; ArduPilot
libraries/GCS_MAVLink/GCS_Param.cpp (cast_to_float); PX4 src/modules/mavlink/mavlink_parameters.cpp.
"""

import struct
from typing import Any, Final

import numpy as np

from ahrs_service.errors import ParamError
from ahrs_service.links.logs.param_files import REAL32, ParamValue
from ahrs_service.links.mavlink.codec import dialect

ARDUPILOT: Final = int(dialect.MAV_AUTOPILOT_ARDUPILOTMEGA)
PX4: Final = int(dialect.MAV_AUTOPILOT_PX4)

_FLOAT: Final = struct.Struct("<f")
_INTEGERS: Final = {
    1: ("u1", "<Bxxx"),
    2: ("i1", "<bxxx"),
    3: ("u2", "<Hxx"),
    4: ("i2", "<hxx"),
    5: ("u4", "<I"),
    6: ("i4", "<i"),
}
"""By MAV_PARAM_TYPE: the numpy type and the position of its bytes in the float."""


def rounded(value: ParamValue) -> ParamValue:
    """Return the value as stored in its type: the nearest 32-bit float, or the integer."""
    if value.type == REAL32:
        return ParamValue(float(np.float32(value.value)), REAL32)
    return value


def encode(name: str, value: ParamValue, autopilot: int) -> float:
    """Return the value for the message's float field; ParamError if the type cannot hold it."""
    if value.type == REAL32:
        return rounded(value).value
    if value.type not in _INTEGERS:
        raise ParamError(f"{name}: MAV_PARAM_TYPE {value.type} does not fit in a PARAM_SET")
    kind, layout = _INTEGERS[value.type]
    bounds = np.iinfo(kind)
    if value.value != int(value.value) or not bounds.min <= value.value <= bounds.max:
        raise ParamError(
            f"{name} = {value.value:g}: give a whole number in {bounds.min}..{bounds.max}"
        )
    if autopilot != PX4:
        return float(np.float32(value.value))
    return float(_FLOAT.unpack(struct.pack(layout, int(value.value)))[0])


def decode(field: float, kind: int, autopilot: int) -> ParamValue:
    """Return the value of the float field of a PARAM_VALUE of MAV_PARAM_TYPE `kind`."""
    if kind not in _INTEGERS:
        return ParamValue(float(field), REAL32)
    if autopilot != PX4:
        return ParamValue(float(round(field)) if np.isfinite(field) else float(field), kind)
    return ParamValue(float(struct.unpack(_INTEGERS[kind][1], _FLOAT.pack(field))[0]), kind)


def param_name(param_id: Any) -> str:
    """Return the name in a message's field, as text, bytes or numpy's bytes."""
    raw = param_id.encode("latin-1", "replace") if isinstance(param_id, str) else bytes(param_id)
    return raw.split(b"\0")[0].decode("ascii", "replace")
