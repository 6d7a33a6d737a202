"""Inputs of the effects on an IMU at a few instants, all unknown except those a test gives."""

from typing import Any

import numpy as np

from ahrs_service.effects.base import Addition, Columns
from ahrs_service.effects.catalogue import effect_of


def columns(count: int = 1, **given: Any) -> Columns:
    """Columns of `count` instants: NaN except `given`, to expose the use of a wrong covariate.

    Scalars hold at every instant. The attitude is level, to the north, unless given.
    """
    shapes = {
        "rate_rad_s": (count, 3),
        "force_m_s2": (count, 3),
        "angular_acceleration_rad_s2": (count, 3),
        "ned_from_body": (count, 4),
        "scatter": (count, 6),
    }
    names = [name for name in Columns.__dataclass_fields__ if name != "scatter"]
    values: dict[str, Any] = {name: np.full(shapes.get(name, count), np.nan) for name in names}
    values["time_s"] = np.arange(count, dtype=np.float64)
    values["rate_rad_s"] = np.zeros((count, 3))
    values["force_m_s2"] = np.zeros((count, 3))
    values["ned_from_body"] = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    for name, value in given.items():
        values[name] = np.broadcast_to(value, shapes.get(name, (count,))).astype(np.float64)
    return Columns(**values)


def added(identifier: str, acting: Columns, **parameters: Any) -> Addition:
    """What the effect adds to the ideal reading with these parameters, the others neutral."""
    effect = effect_of(identifier)
    return effect.add(acting, effect.checked(parameters))


def on_own_triad(identifier: str, acting: Columns, **parameters: Any) -> Any:
    """The addition [N, 3] of an effect that must leave the other triad alone."""
    addition = added(identifier, acting, **parameters)
    own, other = addition.gyro, addition.accel
    if identifier.startswith("accel"):
        own, other = other, own
    assert other is None
    return own
