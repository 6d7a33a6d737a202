"""Settings from a TOML file and from the command line, checked by pydantic."""

import dataclasses
import json
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from ahrs_service import intake
from ahrs_service.settings import Settings

_ADAPTER = TypeAdapter(Settings)


class ConfigError(Exception):
    """A setting that cannot be used; the message names the file, the field and the value."""


def load(path: str | Path | None = None, overrides: Iterable[str] = ()) -> Settings:
    """Read settings from `path` (defaults if None) and apply `section.key=value` overrides.

    Raises ConfigError naming the file or option, the field, the value and what is allowed.
    """
    document: dict[str, Any] = {}
    origin = "the command line"
    if path is not None:
        origin = str(path)
        document = _read_toml(Path(path))
    for override in overrides:
        _set(document, override)
    return from_document(document, origin)


def from_document(document: dict[str, Any], origin: str) -> Settings:
    """Build settings from nested dictionaries; ConfigError names `origin`."""
    defaults = dataclasses.asdict(Settings())
    complete = {
        name: {**defaults.get(name, {}), **section} if isinstance(section, dict) else section
        for name, section in document.items()
    }
    try:
        settings = _ADAPTER.validate_python(complete)
        intake.parameters(settings.intake)
    except ValidationError as error:
        raise ConfigError(_explain(error, origin)) from None
    except ValueError as error:
        raise ConfigError(f"{origin}: {error}") from None
    return settings


def to_json(settings: Settings) -> bytes:
    """Return the effective settings as JSON, as recordings carry them; the key stays out."""
    document = dataclasses.asdict(settings)
    document["link"]["signing_key"] = ""
    return json.dumps(document, sort_keys=True, separators=(",", ":")).encode()


def from_json(text: bytes, origin: str) -> Settings:
    """Read what `to_json` wrote; raises ConfigError."""
    try:
        document = json.loads(text)
    except ValueError as error:
        raise ConfigError(f"{origin}: recorded settings are no JSON ({error})") from None
    if not isinstance(document, dict):
        raise ConfigError(f"{origin}: recorded settings are no table of sections")
    return from_document(document, origin)


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give a readable TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None


def _set(document: dict[str, Any], override: str) -> None:
    """Apply one `section.key=value`; the value is read as TOML, else taken as text."""
    name, separator, text = override.partition("=")
    parts = name.strip().split(".")
    if not separator or len(parts) != 2 or not all(parts):
        raise ConfigError(f"--set {override}: write section.key=value, as in gate.norm_m_s2=0.4")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    section = document.setdefault(parts[0], {})
    if not isinstance(section, dict):
        raise ConfigError(f"--set {override}: {parts[0]} is not a section")
    section[parts[1]] = value


def _explain(error: ValidationError, origin: str) -> str:
    lines = []
    for problem in error.errors():
        field = ".".join(str(part) for part in problem["loc"])
        if problem["type"] == "unexpected_keyword_argument":
            lines.append(f"{origin}: {field}: no such setting; {_known(problem['loc'])}")
        else:
            lines.append(f"{origin}: {field} = {problem['input']!r}: {problem['msg']}")
    return "\n".join(lines)


def _known(location: tuple[int | str, ...]) -> str:
    """List the names allowed beside an unknown one."""
    names = [field.name for field in dataclasses.fields(Settings)]
    if len(location) > 1 and location[0] in names:
        section = getattr(Settings(), str(location[0]))
        names = [field.name for field in dataclasses.fields(section)]
    return "known are " + ", ".join(names)
