"""TOML files as frozen dataclasses: read strictly by pydantic, written whole or not at all."""

import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from ahrs_service.app.config_file import ConfigError, read_toml
from links.errors import LinkError

_T = TypeVar("_T")


def read_as(path: Path, kind: type[_T]) -> _T:
    """Read a TOML file as a dataclass; ConfigError names the file, the field and the value."""
    return validate(read_toml(path), kind, str(path))


def validate(document: Mapping[str, Any], kind: type[_T], origin: str) -> _T:
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


def write(path: Path, document: Mapping[str, Any], heading: str = "") -> None:
    """Write a document of numbers, texts, lists and tables; `heading` stands first as comments.

    The file is replaced in one step, so that a reader finds the old one or the new one. LinkError
    where it cannot be written.
    """
    comments = "".join(f"# {line}\n" for line in heading.splitlines())
    text = comments + "\n".join(_lines(document, ())) + "\n"
    write_atomically(path, text.encode())


def write_atomically(path: Path, content: bytes) -> None:
    """Put `content` in the place of what `path` holds, in one step; LinkError where it cannot."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            # mkstemp's files are private; what the user asked for is as readable as any other.
            Path(name).chmod(0o644)
            Path(name).replace(path)
        except OSError:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        reason = error.strerror or str(error)
        raise LinkError(f"{path}: {reason}; give a file in a folder that can be written") from None


def _lines(table: Mapping[str, Any], place: tuple[str, ...]) -> Iterator[str]:
    """Yield the lines of a table: its own values first, as TOML demands, then its tables."""
    inner = {key: value for key, value in table.items() if _is_table(value)}
    for key, value in table.items():
        if key not in inner and value is not None:
            yield f"{key} = {_value(value)}"
    for key, value in inner.items():
        name = ".".join((*place, key))
        if isinstance(value, Mapping):
            yield from ("", f"[{name}]", *_lines(value, (*place, key)))
            continue
        for one in value:
            yield from ("", f"[[{name}]]", *_lines(one, (*place, key)))


def _is_table(value: Any) -> bool:
    if isinstance(value, Mapping):
        return True
    return isinstance(value, list | tuple) and len(value) > 0 and isinstance(value[0], Mapping)


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(one) for one in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    # A basic string of TOML is a string of JSON.
    return json.dumps(value, ensure_ascii=False)
