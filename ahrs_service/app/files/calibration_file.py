"""Calibrations as TOML files, one per unit: read with pydantic, written whole or not at all.

A round trip is exact: numbers are written with all their digits. What a file leaves out is zero.
"""

import dataclasses
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from ahrs_service.app.files import toml_file
from ahrs_service.app.files.config_file import ConfigError
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.sensor.provenance import Provenance, SourceRecording, Uncertainty, Verdict

SUFFIX: Final = ".toml"

_ADAPTER: Final = TypeAdapter(Calibration)
_CLASSES: Final = {
    "gyro": TriadCalibration,
    "accel": TriadCalibration,
    "provenance": Provenance,
    "recordings": SourceRecording,
    "verdict": Verdict,
    "uncertainty": Uncertainty,
    **dict.fromkeys(("a", "b", "c", "matrix_drift", "bias_sigma", "scale_sigma"), Curve),
}
_LONGEST_VALUE: Final = 100


def load(path: str | Path) -> Calibration:
    """Read a calibration; ConfigError names the file, the field, the value and what to do."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give a readable calibration file") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None
    return from_toml(text, str(path))


def from_toml(text: str, origin: str) -> Calibration:
    """Read the text of a calibration file; ConfigError names `origin`."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{origin}: not valid TOML: {error}") from None
    return _from_document(document, origin)


def from_json(text: bytes, origin: str) -> Calibration:
    """Read what `to_json` wrote; ConfigError names `origin`."""
    try:
        document = json.loads(text)
    except ValueError as error:
        raise ConfigError(f"{origin}: recorded calibration is no JSON ({error})") from None
    return _from_document(document, origin)


def to_json(calibration: Calibration) -> bytes:
    """Return a calibration as JSON, as recordings carry it."""
    return json.dumps(_changed(calibration), separators=(",", ":")).encode()


def to_toml(calibration: Calibration) -> str:
    """Return the text of a calibration's file; what is zero is left out."""
    return toml_file.text_of(_changed(calibration))


def save(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration so that no reader ever finds half a file; ConfigError if it cannot be."""
    toml_file.write_whole(Path(path), to_toml(calibration).encode())


def _from_document(document: Any, origin: str) -> Calibration:
    try:
        return _ADAPTER.validate_python(document)
    except ValidationError as error:
        raise ConfigError(_explain(error, origin)) from None


def _explain(error: ValidationError, origin: str) -> str:
    lines = []
    for problem in error.errors():
        location = problem["loc"]
        field = ".".join(str(part) for part in location)
        where = f"{origin}: {field}" if field else origin
        value = repr(problem["input"])
        if len(value) > _LONGEST_VALUE:
            value = f"{value[:_LONGEST_VALUE]}..."
        if problem["type"] == "unexpected_keyword_argument":
            lines.append(f"{where}: no such field; known are {_known(location[:-1])}")
        elif problem["type"] == "value_error":
            lines.append(f"{where}: {problem['ctx']['error']}")
        elif problem["type"] == "missing":
            lines.append(f"{where}: is missing; give it")
        else:
            lines.append(f"{where} = {value}: {problem['msg']}")
    return "\n".join(lines)


def _known(location: tuple[int | str, ...]) -> str:
    """List the fields of the table at `location`."""
    names = [part for part in location if isinstance(part, str)]
    owner = _CLASSES.get(names[-1], Calibration) if names else Calibration
    return ", ".join(field.name for field in dataclasses.fields(owner))


def _changed(value: Any) -> Any:
    """Return dataclasses as tables that leave out what is as by default."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, tuple):
        return [_changed(item) for item in value]
    if not dataclasses.is_dataclass(value):
        return value
    table = {}
    for field in dataclasses.fields(value):
        own = getattr(value, field.name)
        if own is not None and own != _default(field):
            table[field.name] = _changed(own)
    return table


def _default(field: "dataclasses.Field[Any]") -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default
