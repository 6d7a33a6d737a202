"""The parameters of a simulated autopilot, answered as ArduPilot and PX4 do. Sans I/O.

ArduPilot casts values, leaves a group out of the list while its ENABLE is 0 and yet answers for
its names, and is silent about a name it does not have; PX4 sends integers by their bytes and
reports an unknown name in a STATUSTEXT. Source: ArduPilot libraries/AP_Param/AP_Param.cpp,
libraries/GCS_MAVLink/GCS_Param.cpp; PX4 src/modules/mavlink/mavlink_parameters.cpp.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

from ahrs_service.links.logs.param_files import INT32, REAL32, ParamValue, ParamValues
from ahrs_service.links.logs.parameter_values import (
    ARDUPILOT,
    PX4,
    decode,
    encode,
    param_name,
    rounded,
)
from ahrs_service.links.mavlink.codec import dialect

_INT8: Final = int(dialect.MAV_PARAM_TYPE_INT8)
_NO_INDEX: Final = 65535
_AXES: Final = "XYZ"
_NOT_CALIBRATED_DEGC: Final = -300.0


def ardupilot_ins(imus: int = 2) -> dict[str, ParamValue]:
    """Return ArduPilot's calibration parameters of the first IMUs, as they are when new."""
    values: dict[str, ParamValue] = {}
    for n in range(1, imus + 1):
        number = "" if n == 1 else str(n)
        for axis in _AXES:
            values[f"INS_GYR{number}OFFS_{axis}"] = ParamValue(0.0)
            values[f"INS_ACC{number}SCAL_{axis}"] = ParamValue(1.0)
            values[f"INS_ACC{number}OFFS_{axis}"] = ParamValue(0.0)
        values[f"INS_ACC{n}_CALTEMP"] = ParamValue(_NOT_CALIBRATED_DEGC)
        values[f"INS_GYR{n}_CALTEMP"] = ParamValue(_NOT_CALIBRATED_DEGC)
        values[f"INS_TCAL{n}_ENABLE"] = ParamValue(0.0, _INT8)
        values[f"INS_TCAL{n}_TMIN"] = ParamValue(0.0)
        values[f"INS_TCAL{n}_TMAX"] = ParamValue(70.0)
        for triad in ("ACC", "GYR"):
            for power in (1, 2, 3):
                for axis in _AXES:
                    values[f"INS_TCAL{n}_{triad}{power}_{axis}"] = ParamValue(0.0)
    values["AHRS_ORIENTATION"] = ParamValue(0.0, _INT8)
    return values


def px4_calibration(imus: int = 3, first_id: int = 4259850) -> dict[str, ParamValue]:
    """Return PX4's calibration parameters of the first IMUs, as they are when new."""
    values = {name: ParamValue(0.0, INT32) for name in ("TC_A_ENABLE", "TC_G_ENABLE")}
    values["SENS_BOARD_ROT"] = ParamValue(0.0, INT32)
    for axis in _AXES:
        values[f"SENS_BOARD_{axis}_OFF"] = ParamValue(0.0)
    for n in range(imus):
        device = ParamValue(float(first_id + 65536 * n), INT32)
        for triad in ("ACC", "GYRO"):
            values[f"CAL_{triad}{n}_ID"] = device
            values[f"CAL_{triad}{n}_ROT"] = ParamValue(-1.0, INT32)
            for axis in _AXES:
                values[f"CAL_{triad}{n}_{axis}OFF"] = ParamValue(0.0)
        for axis in _AXES:
            values[f"CAL_ACC{n}_{axis}SCALE"] = ParamValue(1.0)
        for triad in "AG":
            values[f"TC_{triad}{n}_ID"] = ParamValue(0.0, INT32)
            for name, default in (("TMIN", 0.0), ("TMAX", 100.0), ("TREF", 25.0)):
                values[f"TC_{triad}{n}_{name}"] = ParamValue(default)
            for power in range(4):
                for number in range(3):
                    values[f"TC_{triad}{n}_X{power}_{number}"] = ParamValue(0.0)
    return values


class AutopilotParameters:
    """A table of parameters that answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET.

    `values` in force, by name; `limits` (low, high) of those that the autopilot clamps.
    """

    def __init__(
        self,
        values: ParamValues,
        autopilot: int = ARDUPILOT,
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.values = {name: rounded(value) for name, value in values.items()}
        self._autopilot = autopilot
        self._limits = limits or {}

    def on_message(self, message: Any) -> list[Any]:
        """Take one request meant for this autopilot; return the messages that answer it."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self._value(name) for name in self._listed()]
        name = param_name(getattr(message, "param_id", b""))
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            listed = self._listed()
            name = listed[message.param_index] if message.param_index < len(listed) else ""
        if name not in self.values:
            return self._unknown(name)
        if kind == "PARAM_SET":
            self._set(name, float(message.param_value))
        return [self._value(name)]

    def _set(self, name: str, field: float) -> None:
        kind = self.values[name].type
        if kind == REAL32 and not math.isfinite(field):
            return
        value = decode(field, kind, self._autopilot).value
        low, high = self._limits.get(name, (-math.inf, math.inf))
        self.values[name] = rounded(ParamValue(min(max(value, low), high), kind))

    def _listed(self) -> list[str]:
        hidden = tuple(
            name.removesuffix("ENABLE")
            for name, value in self.values.items()
            if name.endswith("_ENABLE") and value.value == 0.0 and self._autopilot == ARDUPILOT
        )
        return [
            name
            for name in self.values
            if name.endswith("_ENABLE") or not name.startswith(hidden or ("\0",))
        ]

    def _value(self, name: str) -> Any:
        listed, value = self._listed(), self.values[name]
        return dialect.MAVLink_param_value_message(
            name.encode(),
            encode(name, value, self._autopilot),
            value.type,
            len(listed),
            listed.index(name) if name in listed else _NO_INDEX,
        )

    def _unknown(self, name: str) -> list[Any]:
        if self._autopilot != PX4 or not name:
            return []
        text = f"[pm] unknown param: {name}".encode()
        return [dialect.MAVLink_statustext_message(dialect.MAV_SEVERITY_INFO, text)]
