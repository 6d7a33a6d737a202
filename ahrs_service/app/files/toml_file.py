"""TOML and JSON files as frozen dataclasses: one reader, one check, one writer.

Every error has one form: `file: field = value: what to do`, a line for each.
"""

import functools
import json
import os
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import TypeAdapter, ValidationError

from ahrs_service.app.files.field_names import fields_at
from ahrs_service.errors import ConfigError, RecordingError

_T = TypeVar("_T")
_LONGEST_LINE: Final = 90
_LONGEST_VALUE: Final = 100


def read(path: Path) -> dict[str, Any]:
    """Read a TOML file; ConfigError gives the reason where it cannot be read."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give a readable TOML file") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None
    return parse(text, str(path))


def parse(text: str, origin: str) -> dict[str, Any]:
    """Read the text of a TOML file; ConfigError names `origin`."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{origin}: not valid TOML: {error}") from None


def parse_json(text: bytes, origin: str) -> dict[str, Any]:
    """Read a table that a recording carries as JSON; ConfigError names `origin`."""
    try:
        document = json.loads(text)
    except ValueError as error:
        raise ConfigError(f"{origin}: no JSON ({error})") from None
    if not isinstance(document, dict):
        raise ConfigError(f"{origin}: {_shown(document)} is no table of fields")
    return document


def read_as(path: Path, kind: type[_T]) -> _T:
    """Read a TOML file as a dataclass; ConfigError names the file, the field and the value."""
    return validate(read(path), kind, str(path))


def validate(document: Mapping[str, Any], kind: type[_T], origin: str) -> _T:
    """Return a dataclass of nested dictionaries; ConfigError names `origin`, field and value."""
    any_kind: Any = kind
    try:
        checked: _T = _adapter(any_kind).validate_python(document)
    except ValidationError as error:
        lines = (_line(problem, kind, origin) for problem in error.errors())
        raise ConfigError("\n".join(lines)) from None
    return checked


# Building one takes longer than reading most files.
@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _line(problem: Any, kind: type[Any], origin: str) -> str:
    """Render one problem of pydantic's: `origin: field = value: what to do`."""
    location = problem["loc"]
    field = ".".join(str(part) for part in location)
    where = f"{origin}: {field}" if field else origin
    if problem["type"] == "unexpected_keyword_argument":
        known = ", ".join(fields_at(kind, location[:-1]))
        return f"{where}: no such field; known are {known}"
    if problem["type"] == "missing":
        return f"{where}: is missing; give it"
    if problem["type"] == "value_error":
        return f"{where}: {problem['ctx']['error']}"
    value = f"{where} = {_shown(problem['input'])}"
    if problem["type"] == "dataclass_type" and field:
        return f"{value}: write a table, [{field}]"
    return f"{value}: {problem['msg']}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def write(path: Path, document: Mapping[str, Any], heading: str = "") -> None:
    """Write a document, `heading` first as comments; ConfigError where it cannot be written."""
    comments = "".join(f"# {line}\n" for line in heading.splitlines())
    write_whole(path, (comments + text_of(document)).encode())


def write_whole(path: Path, content: bytes) -> None:
    """Replace the content of `path` by `content`; ConfigError where that fails.

    It is written next to `path`, synced to the disk and then renamed: no reader
    ever finds half a file.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            # A temporary file is private to its owner; a calibration is read by the daemon's user.
            Path(name).chmod(0o644)
            os.replace(name, path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror or error}; give a writable path"
        ) from None


def _sync_folder(folder: Path) -> None:
    """Sync the new name to the disk too."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def text_of(document: Mapping[str, Any]) -> str:
    """Return nested tables of numbers, texts and lists as TOML; None is left out.

    Numbers are written with all their digits: a round trip is exact.
    """
    return "\n".join(_lines(document, ())).lstrip("\n") + "\n"


def _lines(table: Mapping[str, Any], place: tuple[str, ...]) -> Iterator[str]:
    """Yield the lines of a table: its values first, as TOML demands, then its tables."""
    inner = {key: value for key, value in table.items() if _is_table(value)}
    for key, value in table.items():
        if key not in inner and value is not None:
            yield f"{_key(key)} = {_value(value, rows=True)}"
    for key, value in inner.items():
        below = (*place, _key(key))
        name = ".".join(below)
        if isinstance(value, Mapping):
            yield from ("", f"[{name}]", *_lines(value, below))
            continue
        for one in value:
            yield from ("", f"[[{name}]]", *_lines(one, below))


def _is_table(value: Any) -> bool:
    if isinstance(value, Mapping):
        return True
    return isinstance(value, list | tuple) and len(value) > 0 and isinstance(value[0], Mapping)


def _value(value: Any, rows: bool = False) -> str:
    """Write a value of TOML; with `rows` long lists have one item per line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list | tuple):
        items = [_value(item) for item in value]
        line = f"[{', '.join(items)}]"
        if rows and len(line) > _LONGEST_LINE and isinstance(value[0], list | tuple | str):
            return "[\n" + "".join(f"    {item},\n" for item in items) + "]"
        return line
    return repr(value)


def _text(text: str) -> str:
    """Write a basic string; TOML's escapes are JSON's, but for the delete character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(key: str) -> str:
    is_bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if is_bare else _text(key)


def read_json_table(path: Path, fields: tuple[str, ...], what: str) -> dict[str, Any]:
    """Read a JSON file with `fields`; RecordingError says what is wrong with it."""
    try:
        table = parse_json(path.read_bytes(), str(path))
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}; check the path of {what}") from None
    except ConfigError as error:
        raise RecordingError(f"{error}; give {what}") from None
    missing = [field for field in fields if field not in table]
    if missing:
        raise RecordingError(f"{path}: {', '.join(missing)}: is missing; give {what}")
    return table
