"""One blind case: the request, the recording made, and its truth in the format of truth files."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import numpy as np

from ahrs_service.blind.making.hiding import (
    Part,
    hide,
    hide_above,
    level_near,
    silence,
    total,
)
from ahrs_service.blind.making.motion import Path, table_path
from ahrs_service.blind.making.physics import Scene, Signals
from ahrs_service.blind.making.recording_noise import (
    NoiseLaw,
    Wander,
    draw_law,
    draw_shake,
    following,
)
from ahrs_service.blind.making.surroundings import Surroundings, airborne, chamber
from ahrs_service.blind.making.vehicles import fixed_wing, multirotor
from ahrs_service.records import Floats

RATES_HZ: Final = {"bench": 100, "flight": 200, "copter": 200}
"""A choice [Hz]: in flight the vibration (50 to 90 Hz) is below Nyquist; a table has none."""
NULLS: Final = (
    "plain",
    "reference glitches",
    "jittered reference",
    "wander that follows temperature",
    "strong vibration",
    "strong wander",
)
"""Recordings without any effect: a plain one, and ones that could be mistaken for an effect."""

CONTROLS: Final = ("another flight", "time reversed", "temperature flipped")
"""Covariates of a negative control: unrelated to the sensor."""


@dataclass(frozen=True, slots=True)
class Request:
    """What to make: effect ids to hide (of `OUTSIDE` as `outside:airspeed`), level, seed.

    `level` 1..3 sets the oracle's gain for each effect, 0 leaves a data sheet's magnitude; `known`
    is one more effect, ten times larger than the first; `null` is one of `NULLS`; `alike` says
    that the recording cannot separate the effect from others: a class is the right answer;
    `control` is one of `CONTROLS`.
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
    control: str | None = None


@dataclass(frozen=True, slots=True)
class Case:
    """A finished case: readings [N, 3], scene, noise and truth.

    `hidden` is the shape of all effects together for the oracle; `reported` the environment as
    the messages report it.
    """

    request: Request
    scene: Scene
    law: NoiseLaw
    gyro_rad_s: Floats
    accel_m_s2: Floats
    hidden: Signals
    reported: Surroundings
    truth: dict[str, Any] = field(repr=False)


def make(request: Request) -> Case:
    """Make the case; the same seed gives the same case byte for byte.

    Raises:
        ValueError: an effect is not known, or no size of it gives the level here.

    """
    rng = np.random.default_rng(request.seed)
    scene = _scene(rng, request)
    shake = float(np.sqrt(np.mean(scene.around.vibration_m_s2**2)))
    law = draw_law(rng, request.kind == "bench", shake)
    if request.null == "strong wander":
        law = _wandering(law)
    parts = [hide(rng, name, scene, law, request.level) for name in request.effects]
    if request.known is not None:
        parts.append(hide_above(rng, request.known, scene, law, parts[0]))
    count = len(scene.time_s)
    gyro, accel = _read(rng, request, scene, law, total([p.added for p in parts], count))
    for part in parts:
        if part.limit is not None:
            cut = gyro if part.clipped == "gyro" else accel
            np.clip(cut, -part.limit, part.limit, out=cut)
    hidden = total([p.shape for p in parts], count)
    reported = _reported(scene, request)
    return Case(request, scene, law, gyro, accel, hidden, reported, _truth(request, parts))


def _truth(request: Request, parts: list[Part]) -> dict[str, Any]:
    level = request.level
    if level and parts:
        level = level_near(parts[0].entry["oracle_nats"])
    truth = {
        "kind": request.kind,
        "level": level,
        "seed": request.seed,
        "seconds": request.seconds,
        "imu_rate_hz": RATES_HZ[request.kind],
        "effects": [part.entry for part in parts] or _nothing(request),
    }
    return truth | ({"inseparable": True} if request.alike else {}) | {"request": asdict(request)}


def request_of(truth: dict[str, Any]) -> Request | None:
    """Return the request that made a truth; None if it was not made here."""
    if "request" not in truth:
        return None
    return Request(**truth["request"] | {"effects": tuple(truth["request"]["effects"])})


def _nothing(request: Request) -> list[dict[str, Any]]:
    note = request.control or request.null
    if note == "plain":
        return []
    rms = {"gyro": [0.0, 0.0, 0.0], "accel": [0.0, 0.0, 0.0]}
    return [{"effect": "none", "params": {"note": note}, "signal_rms": rms}]


def _scene(rng: np.random.Generator, request: Request) -> Scene:
    rate = RATES_HZ[request.kind]
    time = np.arange(request.seconds * rate) / rate
    path: Path
    if request.kind == "bench":
        path = table_path(rng, request.seconds)
        around, shake = chamber(rng, time, request.seconds), silence(len(time))
        return Scene(request.kind, rate, time, path, path.at(time), around, shake)
    flight = (fixed_wing if request.kind == "flight" else multirotor)(rng, request.seconds)
    path, motion = flight.path, flight.path.at(time)
    sags = "outside:voltage" in request.effects or rng.random() < 0.3
    around = airborne(rng, time, -motion.position_ned_m[:, 2], flight, sags)
    if request.null == "strong vibration":
        around = replace(around, vibration_m_s2=2.5 * around.vibration_m_s2)
    shake = draw_shake(rng, around.vibration_m_s2)
    return Scene(request.kind, rate, time, path, motion, around, shake)


def _reported(scene: Scene, request: Request) -> Surroundings:
    """Return the environment that the messages report: the true one except in a control."""
    around = scene.around
    if request.control == "another flight":
        other = np.random.default_rng((request.seed, 2))
        return _scene(other, replace(request, control=None)).around
    if request.control == "time reversed":
        columns = {name: getattr(around, name)[::-1] for name in around.__slots__}
        return Surroundings(**columns)
    if request.control == "temperature flipped":
        flipped = 2.0 * around.imu_degc.mean() - around.imu_degc
        return replace(around, imu_degc=flipped, imu_degc_s=-around.imu_degc_s)
    return around


def _wandering(law: NoiseLaw) -> NoiseLaw:
    """The same unit with a larger wander than `draw_law` gives."""
    gyro, accel = Wander(4e-4, law.gyro_wander.time_s), Wander(6e-3, law.accel_wander.time_s)
    return replace(law, gyro_wander=gyro, accel_wander=accel)


def _read(
    rng: np.random.Generator, request: Request, scene: Scene, law: NoiseLaw, added: Signals
) -> Signals:
    """Readings of gyro and accelerometer [N, 3]: motion, effects, vibration, bias and noise."""
    count, step = len(scene.time_s), 1.0 / scene.rate_hz
    readings = []
    for n, (sensor, density, wander, bias) in enumerate(
        (
            ("gyro", law.gyro_density, law.gyro_wander, law.gyro_bias),
            ("accel", law.accel_density, law.accel_wander, law.accel_bias),
        )
    ):
        if request.null == "wander that follows temperature":
            drift = following(rng, wander, scene.around.imu_degc, step)
        else:
            drift = wander.draw(rng, count, step)
        white = rng.normal(0.0, density * np.sqrt(0.5 * scene.rate_hz), (count, 3))
        ideal = scene.reading(sensor) + added[n] + scene.shake[n]
        readings.append(ideal + bias + drift + white)
    return readings[0], readings[1]
