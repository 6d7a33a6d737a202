"""TOML files as frozen dataclasses, read strictly by pydantic."""

from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from ahrs_service.app.config_file import ConfigError, read_toml

_T = TypeVar("_T")


def read_as(path: Path, kind: type[_T]) -> _T:
    """Read a TOML file as a dataclass; ConfigError names the file, the field and the value."""
    return validate(read_toml(path), kind, str(path))


def validate(document: dict[str, Any], kind: type[_T], origin: str) -> _T:
    """Return a dataclass of nested dictionaries; ConfigError names `origin`, field and value."""
    try:
        return TypeAdapter(kind).validate_python(document)
    except ValidationError as error:
        lines = (_line(problem) for problem in error.errors())
        raise ConfigError("\n".join(f"{origin}: {line}" for line in lines)) from None


def _line(problem: Any) -> str:
    field = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "unexpected_keyword_argument":
        return f"{field}: no such field; remove it or correct its name"
    if problem["type"] == "missing":
        return f"{field} is missing; add it"
    return f"{field} = {problem['input']!r}: {problem['msg']}"
