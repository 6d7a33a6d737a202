"""Draws an effect, scales it to its level and writes its truth."""

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from ahrs_service.blind.making.hidden_catalogue import HIDEABLE
from ahrs_service.blind.making.oracle import LEVEL_NATS, gain, scaled_to
from ahrs_service.blind.making.outside_physics import OUTSIDE
from ahrs_service.blind.making.physics import Draw, Hidden, Scene, Signals
from ahrs_service.blind.making.recording_noise import NoiseLaw

KNOWN_TIMES: Final = 10.0
"""A known effect is this many times larger (rms) than the one concealed below it."""

_PLAIN_SIZES: Final = (0.5, 3.0)
"""Level 0, in data sheet magnitudes: the shared cases have arms of 0.16 m, 1.3e-3 rad/s per K."""

_OUTSIDE_PREFIX: Final = "outside:"


@dataclass(frozen=True, slots=True)
class Part:
    """One hidden effect: `shape` for the oracle, `added` to the readings, and the truth `entry`.

    A filter also filters vibration, which the oracle ignores. Clipping is applied to the final
    reading of one sensor, noise included: `limit` and `clipped`; `added` is zero then.
    """

    shape: Signals
    added: Signals
    entry: dict[str, Any]
    limit: float | None = None
    clipped: str | None = None


def hide(rng: np.random.Generator, name: str, scene: Scene, law: NoiseLaw, level: int) -> Part:
    """Draw an effect and scale it to a level; level 0 leaves it about a data sheet's magnitude.

    An effect that a recording hardly excites is scaled up to the gain of level 2.

    Raises:
        ValueError: no such effect, or no size of it gives the level here.

    """
    hidden = _draw(rng, name, scene)
    quiet = scene if hidden.clipped else replace(scene, shake=silence(len(scene.time_s)))
    size = 1.0 if hidden.is_fixed else float(np.exp(rng.uniform(*np.log(_PLAIN_SIZES))))
    seen = gain(hidden.signals(quiet, size), law, scene.rate_hz)
    if not hidden.is_fixed and (level or seen < LEVEL_NATS[2]):
        size = scaled_to(hidden, quiet, law, LEVEL_NATS[level or 2])
    return _part(hidden, size, scene, quiet, law)


def hide_above(
    rng: np.random.Generator, name: str, scene: Scene, law: NoiseLaw, deep: Part
) -> Part:
    """Draw a known effect of the same sensor, `KNOWN_TIMES` as large as `deep` (std)."""
    hidden = _draw(rng, name, scene)
    size = KNOWN_TIMES * _spread(deep.shape) / _spread(hidden.signals(scene, 1.0))
    part = _part(hidden, size, scene, scene, law)
    return replace(part, entry=part.entry | {"known": True})


def level_near(nats: float) -> int:
    """Return the level nearest to a gain; 0 above twice that of level 1."""
    if nats > 2.0 * LEVEL_NATS[1]:
        return 0
    return min(LEVEL_NATS, key=lambda n: abs(math.log(max(nats, 1e-9) / LEVEL_NATS[n])))


def silence(count: int) -> Signals:
    """Return zero signals."""
    return np.zeros((count, 3)), np.zeros((count, 3))


def total(signals: list[Signals], count: int) -> Signals:
    """Return the sum of signals of `count` samples."""
    gyro, accel = silence(count)
    for one in signals:
        gyro += one[0]
        accel += one[1]
    return gyro, accel


def _draw(rng: np.random.Generator, name: str, scene: Scene) -> Hidden:
    known: dict[str, tuple[Draw, tuple[str, ...]]] = HIDEABLE | {
        _OUTSIDE_PREFIX + what: made for what, made in OUTSIDE.items()
    }
    if name not in known:
        raise ValueError(f"{name}: no such effect to hide; there are {', '.join(known)}")
    return known[name][0](rng, scene.kind, scene)


def _part(hidden: Hidden, size: float, scene: Scene, quiet: Scene, law: NoiseLaw) -> Part:
    shape = hidden.signals(quiet, size)
    params = hidden.params(size)
    entry: dict[str, Any] = {"effect": hidden.effect, "params": params}
    if hidden.implies:
        entry["implies"] = list(hidden.implies)
    entry["signal_rms"] = {
        sensor: np.sqrt(np.mean(values**2, axis=0)).tolist()
        for sensor, values in zip(("gyro", "accel"), shape, strict=True)
    }
    entry["oracle_nats"] = gain(shape, law, scene.rate_hz)
    if hidden.clipped:
        nothing = silence(len(scene.time_s))
        return Part(shape, nothing, entry, params["limit"], hidden.clipped)
    added = shape if quiet is scene else hidden.signals(scene, size)
    return Part(shape, added, entry)


def _spread(signals: Signals) -> float:
    """Root of the summed variance of the one sensor that the effect changes."""
    return max(float(np.sqrt(values.var(axis=0).sum())) for values in signals)
