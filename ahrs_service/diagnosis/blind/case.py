"""One sealed case: what is asked for, what was made, and its truth as the cases' files have it."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from ahrs_service.diagnosis.blind.catalogue import HIDEABLE
from ahrs_service.diagnosis.blind.motion import Path, table_path
from ahrs_service.diagnosis.blind.noise import NoiseLaw, Wander, draw_law, draw_shake, following
from ahrs_service.diagnosis.blind.oracle import LEVEL_NATS, gain, scaled_to
from ahrs_service.diagnosis.blind.outside_physics import OUTSIDE
from ahrs_service.diagnosis.blind.physics import Hidden, Scene, Signals
from ahrs_service.diagnosis.blind.surroundings import airborne, chamber
from ahrs_service.diagnosis.blind.vehicles import fixed_wing, multirotor
from ahrs_service.records import Floats

RATES_HZ: Final = {"bench": 100, "flight": 200, "copter": 200}
NULLS: Final = (
    "plain",
    "reference glitches",
    "jittered reference",
    "wander that follows temperature",
    "strong vibration",
    "strong wander",
)
"""Recordings without any effect: the plain one and what could pass for one."""

KNOWN_TIMES: Final = 10.0
"""A known effect is this many times larger (rms) than the one concealed beneath it."""


FIXED: Final = frozenset({"gyro_earth_rate", "gyro_low_pass", "accel_low_pass"})
"""Effects that are not scaled: their level is the one that the oracle's gain is near to."""


@dataclass(frozen=True, slots=True)
class Request:
    """What to make: effect ids to hide (of `OUTSIDE` as `outside:airspeed`), level, seed.

    `level` 1..3 sets the oracle's gain of each effect, 0 leaves a data sheet's magnitude; `known`
    is one more effect, ten times larger than the first; `null` is one of `NULLS`.
    """

    name: str
    kind: str
    seed: int
    seconds: int
    level: int = 1
    effects: tuple[str, ...] = ()
    known: str | None = None
    null: str = "plain"
    alike: bool = False
    """The recording cannot tell the effect from others: a class is the right answer."""


@dataclass(frozen=True, slots=True)
class Case:
    """A finished case: columns of the sensor [N, 3], of the scene, noise law and truth."""

    request: Request
    scene: Scene
    law: NoiseLaw
    gyro_rad_s: Floats
    accel_m_s2: Floats
    added: Signals
    truth: dict[str, Any] = field(repr=False)


def make(request: Request) -> Case:
    """Make the case; one seed gives the same case byte for byte.

    Raises:
        ValueError: an effect is not known, or no size of it gives the level here.

    """
    rng = np.random.default_rng(request.seed)
    rate = RATES_HZ[request.kind]
    scene = _scene(rng, request, rate)
    law = draw_law(rng, request.kind == "bench", _rms(scene.around.vibration_m_s2))
    if request.null == "strong wander":
        law = _wandering(law)
    parts = [_hide(rng, name, scene, law, request) for name in request.effects]
    if request.known is not None:
        parts.append(_known(rng, request.known, scene, parts[0][1], law, rate))
    entries = [entry for entry, _ in parts]
    added = _sum(
        [signals for entry, signals in parts if not _is_clip(entry["effect"])], len(scene.time_s)
    )
    gyro, accel = _read(rng, request, scene, law, added, rate)
    for entry in entries:
        if _is_clip(entry["effect"]):
            reading, limit = _clipped(entry, gyro, accel)
            np.clip(reading, -limit, limit, out=reading)
    truth = {
        "kind": request.kind,
        "level": request.level if request.level == 0 else _level(entries, request.level),
        "seed": request.seed,
        "seconds": request.seconds,
        "imu_rate_hz": rate,
        "effects": entries or _nothing(request.null),
    }
    if request.alike:
        truth["inseparable"] = True
    return Case(request, scene, law, gyro, accel, added, truth)


def _clipped(entry: dict[str, Any], gyro: Floats, accel: Floats) -> tuple[Floats, float]:
    """Return the reading that a saturation cuts, noise and bias included, and its limit."""
    return gyro if entry["effect"].startswith("gyro") else accel, entry["params"]["limit"]


def _level(entries: list[dict[str, Any]], asked: int) -> int:
    """Return the level asked, or of an effect that nature sizes the one that its gain is near."""
    if not entries or entries[0]["effect"] not in FIXED:
        return asked
    nats = math.log(max(entries[0]["oracle_nats"], 1e-9))
    near = min(LEVEL_NATS, key=lambda level: abs(nats - math.log(LEVEL_NATS[level])))
    return near if nats < math.log(2.0 * LEVEL_NATS[1]) else 0


def _scene(rng: np.random.Generator, request: Request, rate: int) -> Scene:
    time = np.arange(request.seconds * rate) / rate
    shake = _silence(len(time))
    path: Path
    if request.kind == "bench":
        path = table_path(rng, request.seconds)
        around = chamber(rng, time, request.seconds)
        motion = path.at(time)
    else:
        draw = fixed_wing if request.kind == "flight" else multirotor
        flight = draw(rng, request.seconds)
        path, motion = flight.path, flight.path.at(time)
        sags = "outside:voltage" in request.effects or rng.random() < 0.3
        around = airborne(rng, time, -motion.position_ned_m[:, 2], flight, sags)
        if request.null == "strong vibration":
            around.vibration_m_s2[:] *= 2.5
        shake = draw_shake(rng, around.vibration_m_s2)
    return Scene(request.kind, time, path, motion, around, shake)


def _draw(rng: np.random.Generator, name: str, scene: Scene) -> Hidden:
    if name.startswith("outside:") and name.removeprefix("outside:") in OUTSIDE:
        return OUTSIDE[name.removeprefix("outside:")][0](rng, scene.kind, scene)
    if name not in HIDEABLE:
        raise ValueError(f"{name}: no such effect to hide; there are {', '.join(HIDEABLE)}")
    return HIDEABLE[name][0](rng, scene.kind, scene)


def _hide(
    rng: np.random.Generator, name: str, scene: Scene, law: NoiseLaw, request: Request
) -> tuple[dict[str, Any], Signals]:
    """Draw an effect and scale it; the oracle counts its shape without vibration."""
    hidden, rate = _draw(rng, name, scene), RATES_HZ[request.kind]
    quiet = scene if _is_clip(name) else replace(scene, shake=_silence(len(scene.time_s)))
    if request.level == 0:
        size, shape = 1.0, hidden.signals(quiet, 1.0)
    else:
        size, shape = scaled_to(hidden, quiet, law, rate, LEVEL_NATS[request.level])
    signals = shape if quiet is scene else hidden.signals(scene, size)
    return _entry(hidden, size, shape, gain(shape, law, rate)), signals


def _is_clip(name: str) -> bool:
    return name.endswith("_saturation")


def _silence(count: int) -> Signals:
    return np.zeros((count, 3)), np.zeros((count, 3))


def _known(
    rng: np.random.Generator, name: str, scene: Scene, deep: Signals, law: NoiseLaw, rate: int
) -> tuple[dict[str, Any], Signals]:
    """Hide an effect of the same sensor ten times larger than `deep` about its mean."""
    hidden = _draw(rng, name, scene)
    unit = _spread(hidden.signals(scene, 1.0))
    size = KNOWN_TIMES * _spread(deep) / unit
    signals = hidden.signals(scene, size)
    entry = _entry(hidden, size, signals, gain(signals, law, rate))
    return entry | {"known": True}, signals


def _spread(signals: Signals) -> float:
    """Root of the summed variance of the one sensor that the effect acts on."""
    return max(float(np.sqrt(values.var(axis=0).sum())) for values in signals)


def _entry(hidden: Hidden, size: float, signals: Signals, nats: float) -> dict[str, Any]:
    entry: dict[str, Any] = {"effect": hidden.effect, "params": hidden.params(size)}
    if hidden.implies:
        entry["implies"] = list(hidden.implies)
    rms = {
        sensor: np.sqrt(np.mean(values**2, axis=0)).tolist()
        for sensor, values in zip(("gyro", "accel"), signals, strict=True)
    }
    return entry | {"signal_rms": rms, "oracle_nats": nats}


def _wandering(law: NoiseLaw) -> NoiseLaw:
    """The same unit with a wander above all that is drawn otherwise."""
    gyro, accel = Wander(4e-4, law.gyro_wander.time_s), Wander(6e-3, law.accel_wander.time_s)
    return replace(law, gyro_wander=gyro, accel_wander=accel)


def _read(
    rng: np.random.Generator,
    request: Request,
    scene: Scene,
    law: NoiseLaw,
    added: Signals,
    rate: int,
) -> tuple[Floats, Floats]:
    """Readings of gyro and accelerometer [N, 3]: motion, effects, vibration, bias and noise."""
    readings = []
    for n, (density, wander, bias) in enumerate(
        (
            (law.gyro_density, law.gyro_wander, law.gyro_bias),
            (law.accel_density, law.accel_wander, law.accel_bias),
        )
    ):
        ideal = scene.reading(("gyro", "accel")[n]) + added[n] + scene.shake[n]
        count, step = len(ideal), 1.0 / rate
        if request.null == "wander that follows temperature":
            drift = following(rng, wander, scene.around.imu_degc, step)
        else:
            drift = wander.draw(rng, count, step)
        white = rng.normal(0.0, density * np.sqrt(0.5 * rate), (count, 3))
        readings.append(ideal + bias + drift + white)
    return readings[0], readings[1]


def _nothing(note: str) -> list[dict[str, Any]]:
    if note == "plain":
        return []
    rms = {"gyro": [0.0, 0.0, 0.0], "accel": [0.0, 0.0, 0.0]}
    return [{"effect": "none", "params": {"note": note}, "signal_rms": rms}]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _sum(parts: list[Signals], count: int) -> Signals:
    gyro, accel = _silence(count)
    for signals in parts:
        gyro += signals[0]
        accel += signals[1]
    return gyro, accel
