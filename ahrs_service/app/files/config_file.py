"""Settings in layers, each above the one before: defaults, profile, TOML file, command line.

They are checked by pydantic. Where a layer sets a limit of the gate, by the limit itself or by a
budget, this replaces what the layers below set for that limit.
"""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from ahrs_service import intake
from ahrs_service.app.files import profiles, toml_file
from ahrs_service.errors import ConfigError
from ahrs_service.settings import Settings

_REPLACES: Final[dict[tuple[str, str], tuple[str, ...]]] = {
    ("gate", "norm_m_s2"): ("acceleration_m_s2", "tilt_deg"),
    ("gate", "rate_rad_s"): ("centripetal_m_s2",),
    ("gate", "angular_acceleration_rad_s2"): ("tangential_m_s2",),
    ("gate_budget", "acceleration_m_s2"): ("tilt_deg",),
    ("gate_budget", "tilt_deg"): ("acceleration_m_s2",),
}
"""A setting, and the budgets of layers below that would contradict it."""


def load(
    path: str | Path | None = None, overrides: Iterable[str] = (), profile: str | None = None
) -> Settings:
    """Read settings: the profile's, above them those of `path`, then `section.key=value` overrides.

    Raises ConfigError naming the file or option, the field, the value and what is allowed.

    >>> from ahrs_service import load_settings
    >>> load_settings("service.toml", profile="hand_held").fusion.declination_deg
    4.5
    """
    document: dict[str, Any] = {}
    origins = []
    if profile is not None:
        file, document = _read_profile(profile)
        origins.append(str(file))
    if path is not None:
        _lay_over(document, toml_file.read(Path(path)))
        origins.append(str(path))
    if given := [(override, *_split(override)) for override in overrides]:
        origins.append("the command line")
        _give_way(document, (setting for _, setting, _ in given))
    for override, setting, text in given:
        _set(document, override, setting, text)
    return from_document(document, " and ".join(origins))


def _read_profile(profile: str) -> tuple[Path, dict[str, Any]]:
    """Read a profile and check it alone, for errors that name its file."""
    file = profiles.file_of(profile)
    if file is None:
        raise ConfigError(
            f"--profile {profile}: no such profile; known are {', '.join(profiles.names())}, "
            f"or give a {profiles.SUFFIX} file"
        )
    document = toml_file.read(file)
    from_document(document, str(file))
    return file, document


def _lay_over(document: dict[str, Any], upper: dict[str, Any]) -> None:
    """Replace the keys of `document` by those of `upper`."""
    sections = {name: part for name, part in upper.items() if isinstance(part, dict)}
    _give_way(document, ((name, key) for name, part in sections.items() for key in part))
    for name, part in upper.items():
        document[name] = {**document.get(name, {}), **part} if name in sections else part


def _give_way(document: dict[str, Any], settings: Iterable[tuple[str, str]]) -> None:
    """Remove the budgets that `settings` (section, key) of a layer above replace."""
    budget = document.get("gate_budget")
    if isinstance(budget, dict):
        for setting in settings:
            for key in _REPLACES.get(setting, ()):
                budget.pop(key, None)


def from_document(document: dict[str, Any], origin: str) -> Settings:
    """Build settings from nested dictionaries; ConfigError names `origin`."""
    defaults = dataclasses.asdict(Settings())
    complete = {
        name: {**defaults.get(name, {}), **section} if isinstance(section, dict) else section
        for name, section in document.items()
    }
    settings = toml_file.validate(complete, Settings, origin)
    try:
        intake.parameters(settings.intake)
    except ValueError as error:
        raise ConfigError(f"{origin}: {error}") from None
    return settings


def to_json(settings: Settings) -> bytes:
    """Return the effective settings as JSON, as recordings carry them, without the key."""
    document = dataclasses.asdict(settings)
    document["link"]["signing_key"] = ""
    return json.dumps(document, sort_keys=True, separators=(",", ":")).encode()


def from_json(text: bytes, origin: str) -> Settings:
    """Read what `to_json` wrote; raises ConfigError."""
    return from_document(toml_file.parse_json(text, f"{origin}: recorded settings"), origin)


def _split(override: str) -> tuple[tuple[str, str], str]:
    """Return section, key and the text of the value of one `section.key=value`."""
    name, separator, text = override.partition("=")
    parts = name.strip().split(".")
    if not separator or len(parts) != 2 or not all(parts):
        raise ConfigError(f"--set {override}: write section.key=value, as in gate.norm_m_s2=0.4")
    return (parts[0], parts[1]), text


def _set(document: dict[str, Any], override: str, setting: tuple[str, str], text: str) -> None:
    """Apply one `section.key=value`; the value is read as TOML, else taken as text."""
    try:
        value = toml_file.parse(f"value = {text}", override)["value"]
    except ConfigError:
        value = text
    name, key = setting
    section = document.setdefault(name, {})
    if not isinstance(section, dict):
        raise ConfigError(f"--set {override}: {name} is not a section")
    section[key] = value
