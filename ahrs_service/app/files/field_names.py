"""The fields that a dataclass has at a location inside it, for messages that list them."""

import dataclasses
import types
from collections.abc import Iterable
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints


def fields_at(kind: Any, location: Iterable[int | str]) -> list[str]:
    """Return the names of the fields of the dataclass at `location` in `kind`.

    A location is that of a validation error: names of fields, numbers in lists. Empty where the
    location is no dataclass.
    """
    places = [kind]
    for part in location:
        places = [inner for place in places for inner in _inside(place, part)]
    for place in places:
        for one in _plain(place):
            if dataclasses.is_dataclass(one):
                return [field.name for field in dataclasses.fields(one)]
    return []


def _inside(place: Any, part: int | str) -> list[Any]:
    """Return the types at `part` of a type: a field's, or the items' of a list."""
    found: list[Any] = []
    for one in _plain(place):
        if dataclasses.is_dataclass(one):
            found += [hint for name, hint in get_type_hints(one).items() if name == part]
        elif isinstance(part, int):
            found += [item for item in get_args(one) if item is not Ellipsis][:1]
    return found


def _plain(place: Any) -> list[Any]:
    """Return the types that an annotation allows."""
    origin = get_origin(place)
    if origin is Annotated:
        return _plain(get_args(place)[0])
    if origin in (Union, types.UnionType):
        return [one for inner in get_args(place) for one in _plain(inner)]
    return [place]
