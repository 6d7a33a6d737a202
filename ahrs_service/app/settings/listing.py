"""Every setting as a row: section, name, type, unit, value, meaning; read from the dataclasses.

The meaning is the text below the setting's field in `ahrs_service.settings`, the unit the brackets
at the end of that text; type and bounds are those that pydantic checks.
"""

import ast
import dataclasses
import inspect
import re
import types
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le

from ahrs_service import settings as settings_module
from ahrs_service.app.files import toml_file
from ahrs_service.settings import AirframeSettings, Settings

AIRFRAMES: Final = tuple(
    field.name for field in dataclasses.fields(Settings) if field.type is AirframeSettings
)
"""Sections that share their fields: one per class of vehicle."""
_UNIT: Final = re.compile(r"\s*\[([^\]]*)\]\.?$")
_WORDS: Final = {float: "number", int: "whole number", bool: "true or false", str: "text"}
_SIGNS: Final = {"gt": ">", "ge": ">=", "le": "<="}


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting: `unit` is "" where it has none, `value` is written as TOML writes it."""

    section: str
    name: str
    kind: str
    unit: str
    value: str
    meaning: str


def listed(settings: Settings) -> list[Setting]:
    """Return a row for each setting of every section, in the order of the dataclasses."""
    return [
        row
        for section in dataclasses.fields(settings)
        for row in _rows(section.name, getattr(settings, section.name))
    ]


def heading(section: str) -> str:
    """Return the first sentence of a section's docstring."""
    part = getattr(Settings(), section)
    return inspect.cleandoc(type(part).__doc__ or "").partition("\n\n")[0]


def _rows(section: str, part: Any) -> list[Setting]:
    hints = get_type_hints(type(part), include_extras=True)
    texts = _texts()[type(part).__name__]
    rows = []
    for field in dataclasses.fields(part):
        unit = _UNIT.search(texts[field.name])
        rows.append(
            Setting(
                section=section,
                name=field.name,
                kind=_kind(hints[field.name]),
                unit=unit[1] if unit else "",
                value=_value(getattr(part, field.name)),
                meaning=_UNIT.sub("", texts[field.name]).rstrip("."),
            )
        )
    return rows


def _texts() -> dict[str, dict[str, str]]:
    """Return, by class and field, the text below each field of `ahrs_service.settings`."""
    found: dict[str, dict[str, str]] = {}
    for node in ast.parse(inspect.getsource(settings_module)).body:
        if not isinstance(node, ast.ClassDef):
            continue
        texts = found.setdefault(node.name, {})
        for before, after in zip(node.body, node.body[1:], strict=False):
            if not (isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name)):
                continue
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                texts[before.target.id] = " ".join(str(after.value.value).split())
    return found


def _value(value: Any) -> str:
    """Write a value as TOML does; "none" for None, which TOML leaves out."""
    if value is None:
        return "none"
    return toml_file.text_of({"value": value}).partition(" = ")[2].strip()


def _kind(hint: Any) -> str:
    """Describe what a type hint allows: "number > 0", "3 numbers", '"mean" or "instant"'."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return f"{_kind(arguments[0])} {_bounds(arguments[1:])}"
    if origin is Literal:
        return _one_of([f'"{choice}"' for choice in arguments])
    if origin is tuple:
        of = _kind(arguments[0])
        return f"{len(arguments)} {of.replace('number', 'numbers', 1)}"
    if origin in (Union, types.UnionType):
        kinds = [_kind(one) for one in arguments if one is not type(None)]
        return _one_of([*kinds, "none"])
    return _WORDS[hint]


def _one_of(choices: list[str]) -> str:
    """Write choices as "a, b or c"."""
    return " or ".join([", ".join(choices[:-1]), choices[-1]])


def _bounds(constraints: tuple[Any, ...]) -> str:
    """Return the bounds of a number: "> 0", or "0 to 255" where there are both."""
    bounds = {
        name: getattr(one, name)
        for one in constraints
        for kind, name in ((Gt, "gt"), (Ge, "ge"), (Le, "le"))
        if isinstance(one, kind)
    }
    if "ge" in bounds and "le" in bounds:
        return f"{bounds['ge']:g} to {bounds['le']:g}"
    return ", ".join(f"{_SIGNS[name]} {value:g}" for name, value in bounds.items())
