"""Calibrations as TOML files, one per unit: read with pydantic, written atomically.

A round trip is exact: numbers are written with all their digits. Omitted values are zero.
"""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from ahrs_service.app.files import toml_file
from ahrs_service.sensor.parameters import Calibration

SUFFIX: Final = ".toml"


def load(path: str | Path) -> Calibration:
    """Read a calibration; ConfigError names the file, the field, the value and what to do.

    >>> from ahrs_service import Estimator, load_calibration
    >>> estimator = Estimator(calibration=load_calibration("unit.toml"))
    >>> estimator.calibration.serial
    'A0042'
    """
    return toml_file.read_as(Path(path), Calibration)


def from_toml(text: str, origin: str) -> Calibration:
    """Read the text of a calibration file; ConfigError names `origin`."""
    return toml_file.validate(toml_file.parse(text, origin), Calibration, origin)


def from_json(text: bytes, origin: str) -> Calibration:
    """Read what `to_json` wrote; ConfigError names `origin`."""
    document = toml_file.parse_json(text, f"{origin}: recorded calibration")
    return toml_file.validate(document, Calibration, origin)


def to_json(calibration: Calibration) -> bytes:
    """Return a calibration as JSON, as recordings carry it."""
    return json.dumps(_changed(calibration), separators=(",", ":")).encode()


def to_toml(calibration: Calibration) -> str:
    """Return the text of a calibration's file; zero values are left out."""
    return toml_file.text_of(_changed(calibration))


def save(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration file atomically; ConfigError if it cannot be written."""
    toml_file.write_whole(Path(path), to_toml(calibration).encode())


def _changed(value: Any) -> Any:
    """Return dataclasses as tables without the default values."""
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
