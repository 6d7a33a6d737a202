"""Twins as TOML: the sensor's calibration and noise, and the physical effects that act on it.

    source = "diagnose flight.tlog, 2026-01-01"

    [calibration.accel]                 # as in configs/calibrations; without it the sensor is ideal
    bias = [0.05, -0.02, 0.10]

    [accel_noise]                       # density, walk, wander, wander_s: sensor/noise.py
    density = 2e-3

    [[effects]]                         # ids, parameters and units: ahrs_service/effects
    id = "accel_vibration_rectification"
    per_vibration_variance = [0.03, -0.04, -0.05]
    [effects.units]                     # may be left out; what is given must be right
    per_vibration_variance = "s^2/m"
    [effects.sigma]                     # 1-sigma of a fit; for people, not used
    per_vibration_variance = [0.004, 0.004, 0.005]

An unknown name, a wrong unit or an impossible value is an error that names it.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from ahrs_service.app.files import toml_file
from ahrs_service.effects.base import Effect, Values
from ahrs_service.effects.catalogue import effect_of
from ahrs_service.errors import ConfigError
from ahrs_service.sensor.noise import TriadNoise
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.simulation.environment import Propeller
from ahrs_service.simulation.imu import Imu

_KEYS: Final = ("id", "units", "sigma")


@dataclasses.dataclass(frozen=True, slots=True)
class _Document:
    """The file as read; the effects are checked by the catalogue."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}
    source: str = ""
    calibration: Calibration = dataclasses.field(default_factory=Calibration.ideal)
    gyro_noise: TriadNoise = dataclasses.field(default_factory=TriadNoise)
    accel_noise: TriadNoise = dataclasses.field(default_factory=TriadNoise)
    propeller: Propeller | None = None
    effects: list[dict[str, Any]] = dataclasses.field(default_factory=list)


def read(path: Path) -> Imu:
    """Read a twin; ConfigError names the file, the field, the value and what to do."""
    document = toml_file.read_as(path, _Document)
    effects = tuple(
        _effect(table, f"{path}: effects.{number}") for number, table in enumerate(document.effects)
    )
    return Imu(
        document.calibration,
        document.gyro_noise,
        document.accel_noise,
        document.propeller,
        effects,
    )


def _effect(table: dict[str, Any], origin: str) -> tuple[Effect, Values]:
    identifier = table.get("id")
    if not isinstance(identifier, str):
        raise ConfigError(f"{origin}.id: is missing; give an effect of the catalogue")
    try:
        effect = effect_of(identifier)
        values = effect.checked({k: v for k, v in table.items() if k not in _KEYS})
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{origin}: {error}") from None
    for parameter in effect.parameters:
        value, (low, high) = values[parameter.name], parameter.bounds
        good = np.isfinite(value) & (value >= low) & (value <= high)
        if not (good | np.isclose(value, parameter.neutral, rtol=0.0, equal_nan=True)).all():
            allowed = f"{low:g} to {high:g} " if np.isfinite(low) else "finite numbers in "
            raise ConfigError(
                f"{origin}: {identifier}.{parameter.name} = {value.tolist()}: "
                f"give {allowed}{parameter.unit}"
            )
    _check_units(effect, table, origin)
    return effect, values


def _check_units(effect: Effect, table: Mapping[str, Any], origin: str) -> None:
    units, known = table.get("units", {}), {p.name: p.unit for p in effect.parameters}
    for part in ("units", "sigma"):
        names = table.get(part, {})
        if not isinstance(names, dict) or set(names) - set(known):
            raise ConfigError(
                f"{origin}.{part} = {names}: give a table with some of {', '.join(known)}"
            )
    for name, unit in units.items():
        if unit != known[name]:
            raise ConfigError(
                f"{origin}.units.{name} = {unit!r}: {name} is in {known[name]!r}; "
                "convert the value and correct the unit"
            )


def write(
    path: Path, twin: Imu, source: str, sigmas: Mapping[str, Mapping[str, Any]] | None = None
) -> None:
    """Write a twin atomically; `sigmas` are 1-sigma by effect id and parameter.

    ConfigError where it cannot be written.
    """
    document: dict[str, Any] = {"source": source}
    for field in ("calibration", "gyro_noise", "accel_noise", "propeller"):
        part = getattr(twin, field)
        if part is not None:
            document[field] = _without_defaults(part)
    document["effects"] = [
        _table(effect, values, (sigmas or {}).get(effect.id, {})) for effect, values in twin.effects
    ]
    toml_file.write(path, document, "Twin of a sensor: ahrs-service simulate --twin FILE")


def _table(effect: Effect, values: Values, sigma: Mapping[str, Any]) -> dict[str, Any]:
    table: dict[str, Any] = {"id": effect.id}
    table |= {p.name: values[p.name].tolist() for p in effect.parameters}
    table["units"] = {p.name: p.unit for p in effect.parameters}
    if sigma:
        table["sigma"] = dict(sigma)
    return table


def _without_defaults(part: Any) -> dict[str, Any]:
    """Return a dataclass as nested tables of the values that differ from its defaults."""
    table: dict[str, Any] = {}
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        default = field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        if value == default:
            continue
        table[field.name] = _without_defaults(value) if dataclasses.is_dataclass(value) else value
    return table


def with_effects(twin: Imu, found: Iterable[tuple[Effect, Values]]) -> Imu:
    """Return the twin with the effects found added to its own.

    For an effect that it already had, linear parameters are summed, the others replaced.
    """
    merged = {effect.id: (effect, values) for effect, values in twin.effects}
    for effect, values in found:
        had = merged[effect.id][1] if effect.id in merged else {}
        linear = {p.name for p in effect.parameters if p.step and p.name in had}
        summed = {name: had[name] + values[name] for name in linear}
        merged[effect.id] = (effect, {**values, **summed})
    return dataclasses.replace(twin, effects=tuple(merged.values()))
