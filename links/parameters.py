"""The service's parameters over the PARAM protocol: gate limits and publish rates."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final

from ahrs_service.settings import Settings
from links.mavlink_codec import dialect

_REAL32: Final = int(dialect.MAV_PARAM_TYPE_REAL32)
_PER_TICK: Final = 5
_WAITING: Final = 64


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: where it stands in the settings, and its bounds in the settings' unit."""

    section: str
    key: str
    low: float
    high: float


PARAMETERS: Final = {
    "AHRS_GATE_NORM": Parameter("gate", "norm_m_s2", 0.01, 50.0),
    "AHRS_GATE_RATE": Parameter("gate", "rate_rad_s", 0.001, 50.0),
    "AHRS_GATE_ANGAC": Parameter("gate", "angular_acceleration_rad_s2", 0.01, 1000.0),
    "AHRS_GATE_INNOV": Parameter("gate", "innovation_sigma", 0.5, 100.0),
    "AHRS_PUB_ATT": Parameter("publish", "attitude_rate_hz", 0.0, 1000.0),
    "AHRS_PUB_QUAT": Parameter("publish", "attitude_quaternion_rate_hz", 0.0, 1000.0),
    "AHRS_PUB_NAMED": Parameter("publish", "named_value_rate_hz", 0.0, 100.0),
}
"""By name (at most 16 characters); a value travels as a 32-bit float, so 0.35 becomes 0.3499999."""
_NAMES: Final = tuple(PARAMETERS)


def read(settings: Settings, name: str) -> float:
    """Return the value of a parameter."""
    parameter = PARAMETERS[name]
    return float(getattr(getattr(settings, parameter.section), parameter.key))


def change(settings: Settings, name: str, value: float) -> Settings:
    """Return settings with one parameter changed; ValueError names it, the value and the bounds."""
    parameter = PARAMETERS.get(name)
    if parameter is None:
        raise ValueError(f"no parameter {name!r}; known are {', '.join(_NAMES)}")
    if not (math.isfinite(value) and parameter.low <= value <= parameter.high):
        raise ValueError(f"{name} = {value:g} is not in {parameter.low:g}..{parameter.high:g}")
    section = dataclasses.replace(
        getattr(settings, parameter.section), **{parameter.key: float(value)}
    )
    return dataclasses.replace(settings, **{parameter.section: section})


class ParameterServer:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; `settings` are in force."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.events: list[tuple[str, str]] = []
        self._to_send: list[str] = []

    def on_message(self, message: Any) -> None:
        """Take one request that is meant for us."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            self._to_send = list(_NAMES)
        elif kind == "PARAM_REQUEST_READ":
            self._read(message)
        elif kind == "PARAM_SET":
            self._set(_text(message.param_id), float(message.param_value))

    def _read(self, message: Any) -> None:
        index = message.param_index
        name = _NAMES[index] if 0 <= index < len(_NAMES) else _text(message.param_id)
        if name in PARAMETERS:
            self._answer(name)

    def _set(self, name: str, value: float) -> None:
        """Change a value or refuse it; either way the answer is the value in force."""
        try:
            self.settings = change(self.settings, name, value)
            self.events.append(("info", f"{name} set to {value:g}"))
        except ValueError as error:
            self.events.append(("warning", f"PARAM_SET refused: {error}"))
        if name in PARAMETERS:
            self._answer(name)

    def _answer(self, name: str) -> None:
        if len(self._to_send) < _WAITING:
            self._to_send.append(name)

    def tick(self) -> list[Any]:
        """Return the next few answers, so that a list does not flood a slow link."""
        names, self._to_send = self._to_send[:_PER_TICK], self._to_send[_PER_TICK:]
        return [self._value(name) for name in names]

    def _value(self, name: str) -> Any:
        return dialect.MAVLink_param_value_message(
            name.encode(), read(self.settings, name), _REAL32, len(_NAMES), _NAMES.index(name)
        )


def _text(param_id: Any) -> str:
    raw = param_id.encode("latin-1", "replace") if isinstance(param_id, str) else bytes(param_id)
    return raw.split(b"\0")[0].decode("ascii", "replace")
