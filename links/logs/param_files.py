"""Files of an autopilot's parameters, as ground stations write and read them.

Two formats: `NAME,VALUE` of Mission Planner, also separated by spaces as MAVProxy writes it, `#`
starting a comment; and QGroundControl's, tabs between vehicle id, component id, name, value and
MAV_PARAM_TYPE under a header of `#` lines. Source: ArduPilot, "Parameter files"; QGroundControl,
src/FactSystem/ParameterManager.cc, writeParametersToStream.
"""

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from ahrs_service.errors import ParamFileError

Dialect = Literal["mission-planner", "qgroundcontrol"]

REAL32: Final = 9
INT32: Final = 6
_TYPES: Final = range(1, 11)
"""MAV_PARAM_TYPE_UINT8 to MAV_PARAM_TYPE_REAL64."""
_NAME: Final = re.compile(r"[A-Za-z0-9_]{1,16}")
_SEPARATOR: Final = re.compile(r"\s*,\s*|\s+")
_QGC_FIELDS: Final = 5


@dataclass(frozen=True, slots=True)
class ParamValue:
    """The value of one parameter and its MAV_PARAM_TYPE; a 32-bit float unless given."""

    value: float
    type: int = REAL32

    @property
    def text(self) -> str:
        """The shortest decimal that reads back to the same value of this type."""
        if self.type < REAL32:
            return str(int(self.value))
        return str(np.float32(self.value)) if self.type == REAL32 else repr(self.value)


ParamValues = Mapping[str, ParamValue]


def read_param_file(path: str | Path) -> dict[str, ParamValue]:
    """Return the values by name, in the order of the file, from either format.

    ParamFileError names the file, the line and what is wrong with it: no name, no finite number,
    a name with two different values.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ParamFileError(f"{path}: {error.strerror}; give a readable .param file") from None
    except UnicodeDecodeError:
        raise ParamFileError(
            f"{path}: is not text, so it is no .param file; give one saved by a ground station"
        ) from None
    values: dict[str, ParamValue] = {}
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        where = f"{path}, line {number}"
        name, value = _entry(where, content)
        if values.get(name, value) != value:
            raise ParamFileError(
                f"{where}: {name} = {value.text} although it was {values[name].text} above; "
                "keep one of them"
            )
        values[name] = value
    if not values:
        raise ParamFileError(f"{path}: holds no parameter; a line is NAME,VALUE")
    return values


def _entry(where: str, content: str) -> tuple[str, ParamValue]:
    fields = _SEPARATOR.split(content)
    kind = REAL32
    if len(fields) == _QGC_FIELDS:
        _, _, name, text, type_text = fields
        if not (type_text.isdigit() and int(type_text) in _TYPES):
            raise ParamFileError(f"{where}: {type_text!r} is no MAV_PARAM_TYPE; known are 1 to 10")
        kind = int(type_text)
    elif len(fields) == 2:
        name, text = fields
    else:
        raise ParamFileError(
            f"{where}: {content!r} is not understood; a line is NAME,VALUE or, for QGroundControl, "
            "vehicle, component, name, value and type separated by tabs"
        )
    if not _NAME.fullmatch(name):
        raise ParamFileError(
            f"{where}: {name!r} is not a parameter name; it has 1 to 16 letters, digits and _"
        )
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (kind < REAL32 and value != int(value)):
        number = "finite number" if kind >= REAL32 else "whole number"
        raise ParamFileError(f"{where}: {name} = {text!r}: give a {number}")
    return name, ParamValue(value, kind)


def write_param_file(
    path: str | Path,
    values: ParamValues,
    dialect: Dialect,
    comments: tuple[str, ...] = (),
    system: int = 1,
    component: int = 1,
) -> None:
    """Write the values, synced to disk on return; ParamFileError if the file already exists."""
    path = Path(path)
    lines = [f"# {comment}" for comment in comments]
    if dialect == "qgroundcontrol":
        lines += ["#", "# Vehicle-Id Component-Id Name Value Type"]
        lines += [
            f"{system}\t{component}\t{name}\t{value.text}\t{value.type}"
            for name, value in values.items()
        ]
    else:
        lines += [f"{name},{value.text}" for name, value in values.items()]
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        raise ParamFileError(f"{path}: already exists; move it away or give another name") from None
    except OSError as error:
        raise ParamFileError(
            f"{path}: {error.strerror}; give a file in a writable folder"
        ) from None
