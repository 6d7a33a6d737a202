"""The service's parameters over the PARAM protocol: gate limits and publish rates."""

import dataclasses
import itertools
import math
from collections import deque
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ahrs_service.errors import InvalidValueError
from ahrs_service.links.logs.parameter_values import param_name
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.settings import Settings

_REAL32: Final = int(dialect.MAV_PARAM_TYPE_REAL32)
_PER_TICK: Final = 5
_EVENTS: Final = 64


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its place in the settings, and its bounds in the settings' unit."""

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
"""By name (at most 16 characters)."""
_NAMES: Final = tuple(PARAMETERS)


def read(settings: Settings, name: str) -> float:
    """Return the value of a parameter."""
    parameter = PARAMETERS[name]
    return float(getattr(getattr(settings, parameter.section), parameter.key))


def change(settings: Settings, name: str, value: float) -> Settings:
    """Return settings with one parameter changed; ValueError names it, the value and the bounds."""
    parameter = PARAMETERS.get(name)
    if parameter is None:
        raise InvalidValueError(f"no parameter {name!r}; known are {', '.join(_NAMES)}")
    if not (math.isfinite(value) and parameter.low <= value <= parameter.high):
        raise InvalidValueError(
            f"{name} = {value:g} is not in {parameter.low:g}..{parameter.high:g}"
        )
    section = dataclasses.replace(
        getattr(settings, parameter.section), **{parameter.key: float(value)}
    )
    return dataclasses.replace(settings, **{parameter.section: section})


class ParameterServer:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; `settings` are in force."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.events: deque[tuple[str, str]] = deque(maxlen=_EVENTS)
        # Each name waits once, in order: no flood of requests makes this longer than the list.
        self._to_send: dict[str, None] = {}

    def on_message(self, message: Any) -> str:
        """Take one request that is meant for us; return why it was refused, if it was."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            self._to_send.update(dict.fromkeys(_NAMES))
        elif kind == "PARAM_REQUEST_READ":
            self._read(message)
        elif kind == "PARAM_SET":
            return self._set(param_name(message.param_id), float(message.param_value))
        return ""

    def _read(self, message: Any) -> None:
        """Answer by index, or by name where the index is -1."""
        index = message.param_index
        if 0 <= index < len(_NAMES):
            self._to_send[_NAMES[index]] = None
        elif index == -1:
            self._answer(param_name(message.param_id))

    def _set(self, name: str, value: float) -> str:
        """Change a value or refuse it; either way the answer is the value in force."""
        value, refusal = _shortest(value), ""
        try:
            changed = change(self.settings, name, value)
        except ValueError as error:
            refusal = f"PARAM_SET refused: {error}"
            self.events.append(("warning", refusal))
        else:
            if changed != self.settings:
                self.settings = changed
                self.events.append(("info", f"{name} set to {value:g}"))
        self._answer(name)
        return refusal

    def _answer(self, name: str) -> None:
        if name in PARAMETERS:
            self._to_send[name] = None

    def tick(self) -> list[Any]:
        """Return the next few answers, so a list does not flood a slow link."""
        names = list(itertools.islice(self._to_send, _PER_TICK))
        for name in names:
            del self._to_send[name]
        return [self._value(name) for name in names]

    def _value(self, name: str) -> Any:
        return dialect.MAVLink_param_value_message(
            name.encode(), read(self.settings, name), _REAL32, len(_NAMES), _NAMES.index(name)
        )


def _shortest(value: float) -> float:
    """Return the shortest decimal that travels as this 32-bit float: 0.35, not 0.3499999."""
    return float(str(np.float32(value)))
