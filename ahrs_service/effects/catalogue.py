"""The known effects, by id: those of the files in this folder, and those registered."""

from collections.abc import Iterator
from importlib import import_module
from pkgutil import iter_modules
from typing import Final, TypeVar

from ahrs_service import effects
from ahrs_service.effects.base import Effect
from ahrs_service.errors import InvalidValueError

Kind = TypeVar("Kind", bound=Effect)

_FIRST: Final = (
    "timing",
    "mounting_rotation",
    "scale_factor",
    "misalignment",
    "scale_nonlinearity",
    "low_pass",
    "saturation",
    "thermal_bias",
    "thermal_scale",
    "thermal_lag",
    "thermal_rate",
    "thermal_hysteresis",
    "warm_up",
    "vibration_rectification",
    "current_coupling",
    "g_sensitivity",
    "earth_rate",
    "lever_arm",
)
"""Files in the order of their effects; a file that is not named here is found too, and comes last.

The order decides nothing but which random numbers an effect gets in the bootstrap of the search
(diagnosis.search.search_threshold). It is kept, so that a diagnosis stays as it was.
"""

_SAID: Final = ("name", "triads", "title", "equation", "excited_by", "separated_by")


def _kinds() -> Iterator[type[Effect]]:
    """Yield the effects of every file of this package."""
    first = {name: place for place, name in enumerate(_FIRST)}
    files = sorted(module.name for module in iter_modules(effects.__path__))
    for file in sorted(files, key=lambda file: first.get(file, len(first))):
        module = import_module(f"{effects.__name__}.{file}")
        for kind in tuple(vars(module).values()):
            is_effect = isinstance(kind, type) and issubclass(kind, Effect)
            if is_effect and kind.__module__ == module.__name__ and "name" in vars(kind):
                yield kind


def _place(effect: Effect) -> int:
    """Return the place of an effect: of both triads at once, of either, of one triad alone."""
    if effect.triad == "imu":
        return 0
    return 1 + ("gyro", "accel").index(effect.triad) if len(effect.triads) > 1 else 3


EFFECTS: Final[dict[str, Effect]] = {
    effect.id: effect
    for effect in sorted((kind(t) for kind in _kinds() for t in kind.triads), key=_place)
}
"""All effects by id."""


def register(kind: type[Kind]) -> type[Kind]:
    """Make the effects of a class known that is not in this package; use it as a decorator.

    ValueError names what the class does not define, or an id already in use.

        @register
        @dataclass(frozen=True)
        class Magnetostriction(Effect): ...
    """
    unsaid = [name for name in _SAID if not hasattr(kind, name)]
    if unsaid:
        raise InvalidValueError(
            f"{kind.__name__} has no {', '.join(unsaid)}; see effects.base.Effect"
        )
    for effect in (kind(triad) for triad in kind.triads):
        if EFFECTS.get(effect.id, effect) != effect:
            raise InvalidValueError(
                f"{effect.id} is a {type(EFFECTS[effect.id]).__name__}; give another name"
            )
        EFFECTS[effect.id] = effect
    return kind


def forget(kind: type[Effect]) -> None:
    """Undo `register`."""
    for triad in kind.triads:
        del EFFECTS[kind(triad).id]


def effect_of(identifier: str) -> Effect:
    """Return the effect of an id; ValueError names those there are."""
    if identifier not in EFFECTS:
        raise InvalidValueError(f"{identifier} is no known effect; there are {', '.join(EFFECTS)}")
    return EFFECTS[identifier]


def often_taken_for(effect: Effect) -> tuple[str, ...]:
    """Return the ids that an effect is commonly mistaken for.

    `Effect.taken_for` holds ids, or names of the effect's own triad; those of the other triad alone
    are left out.
    """
    ids = (name if name in EFFECTS else f"{effect.triad}_{name}" for name in effect.taken_for)
    known = (EFFECTS[identifier] for identifier in ids if identifier in EFFECTS)
    return tuple(one.id for one in known if effect.acts_on(one.triad) or one.acts_on(effect.triad))
