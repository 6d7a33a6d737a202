"""The composition of a blind set: kinds, levels and how many of each."""

import math
from typing import Any, Final

import numpy as np

from ahrs_service.blind.making.case import CONTROLS, NULLS, Request
from ahrs_service.blind.making.hidden_catalogue import HIDEABLE
from ahrs_service.blind.making.outside_physics import OUTSIDE

SECONDS: Final = {"bench": 400, "flight": 240, "copter": 200}
"""Usual length of a recording of each kind [s]."""

SHARES: Final = {
    "null": 0.35,
    "single": 0.37,
    "concealed": 0.06,
    "pair": 0.08,
    "alike": 0.04,
    "outside": 0.10,
}
"""Composition of a set: at least 30 % have no effect."""

_LEVELS: Final = (1, 2, 3, 0)
"""Three depths set by the oracle's gain, and (0) a data sheet's magnitude."""

_PAIRS: Final = (
    ("bench", ("accel_thermal_bias", "gyro_scale_factor")),
    ("bench", ("gyro_thermal_lag", "accel_misalignment")),
    ("bench", ("accel_lever_arm", "gyro_thermal_bias")),
    ("bench", ("imu_time_offset", "accel_thermal_hysteresis")),
    ("bench", ("gyro_misalignment", "accel_scale_nonlinearity")),
    ("flight", ("accel_vibration_rectification", "gyro_scale_factor")),
    ("flight", ("imu_mounting_rotation", "gyro_current_coupling")),
    ("copter", ("imu_time_offset", "accel_current_coupling")),
    ("copter", ("gyro_g_sensitivity", "accel_scale_factor")),
    ("copter", ("accel_lever_arm", "gyro_vibration_rectification")),
)
"""Two effects whose signals differ, as (kind of recording, effects)."""

_ALIKE: Final = (
    ("flight", "gyro_thermal_rate"),
    ("copter", "accel_thermal_rate"),
    ("copter", "gyro_thermal_rate"),
    ("flight", "accel_thermal_rate"),
)
"""In a flight the board warms as 1 - exp(-t / tau): its slope, a bias with it and a warm-up that
decays with the same tau are one curve."""

_KNOWN: Final = {
    "bench": "thermal_bias",
    "flight": "current_coupling",
    "copter": "current_coupling",
}
"""The known effect above a concealed one, by kind of recording."""

_NEVER_CONCEALED: Final = ("earth_rate", "saturation", "low_pass", "vibration_rectification")
"""Of a fixed size, or largest where the known effect is largest."""

Draft = tuple[str, dict[str, Any]]


def plan(count: int, seed: int, seconds: int | None = None) -> list[Request]:
    """Return the requests of a set of `count` recordings, in a random order.

    `seconds` [s] gives all the same length. Names reveal nothing: case_001 and so on.
    """
    rng = np.random.default_rng(seed)
    drafts = [
        draft for what, number in _shared_out(count).items() for draft in _MAKERS[what](rng, number)
    ]
    order, seeds = rng.permutation(count), rng.integers(1, 2**31, count)
    requests = []
    for n, (kind, rest) in enumerate(drafts[i] for i in order):
        length = seconds or SECONDS[kind]
        requests.append(Request(f"case_{n + 1:03d}", kind, int(seeds[n]), length, **rest))
    return requests


def controls(count: int, seed: int) -> list[Request]:
    """Return `count` plain nulls with unrelated covariates, one kind of control after the other."""
    rng = np.random.default_rng((seed, 4))
    seeds = rng.integers(1, 2**31, count)
    kinds = tuple(SECONDS)
    return [
        Request(
            f"control_{n + 1:03d}",
            kinds[n // len(CONTROLS) % len(kinds)],
            int(seeds[n]),
            SECONDS[kinds[n // len(CONTROLS) % len(kinds)]],
            control=CONTROLS[n % len(CONTROLS)],
        )
        for n in range(count)
    ]


def _shared_out(count: int) -> dict[str, int]:
    """Distribute `count` by largest remainder; nulls are rounded up."""
    exact = {what: share * count for what, share in SHARES.items()}
    numbers = {what: math.floor(value) for what, value in exact.items()}
    numbers["null"] = math.ceil(exact["null"])
    by_rest = sorted(exact, key=lambda what: numbers[what] - exact[what])
    for what in by_rest[: count - sum(numbers.values())]:
        numbers[what] += 1
    return numbers


def _nulls(rng: np.random.Generator, number: int) -> list[Draft]:
    kinds = list(SECONDS)
    drafts = [(kinds[n % 3], NULLS[n // 3 % len(NULLS)]) for n in range(number)]
    flown = ("reference glitches", "jittered reference", "strong vibration")
    return [
        (
            str(rng.choice(("flight", "copter"))) if kind == "bench" and null in flown else kind,
            {"null": null},
        )
        for kind, null in drafts
    ]


def _singles(rng: np.random.Generator, number: int) -> list[Draft]:
    """All effects and levels in rotation, each in a kind of recording that excites it."""
    names = rng.permutation(list(HIDEABLE))
    shift = int(rng.integers(len(_LEVELS)))
    drafts = []
    for n in range(number):
        name = str(names[n % len(names)])
        level = _LEVELS[(n + n // len(names) + shift) % len(_LEVELS)]
        kind = str(rng.choice(HIDEABLE[name][1]))
        drafts.append((kind, {"effects": (name,), "level": level}))
    return drafts


def _concealed(rng: np.random.Generator, number: int) -> list[Draft]:
    """An effect of level 3 below a known one, ten times larger, of the same sensor."""
    drafts = []
    for n in range(number):
        kind = tuple(SECONDS)[n % 3]
        sensor = str(rng.choice(("gyro", "accel")))
        known = f"{sensor}_{_KNOWN[kind]}"
        fitting = [
            name
            for name, (_, kinds) in HIDEABLE.items()
            if name.startswith(sensor)
            and kind in kinds
            and name != known
            and not name.endswith(_NEVER_CONCEALED)
        ]
        name = str(rng.choice(fitting))
        drafts.append((kind, {"effects": (name,), "known": known, "level": 3}))
    return drafts


def _pairs(rng: np.random.Generator, number: int) -> list[Draft]:
    first = int(rng.integers(len(_PAIRS)))
    drafts = []
    for n in range(number):
        kind, effects = _PAIRS[(first + n) % len(_PAIRS)]
        drafts.append((kind, {"effects": effects, "level": (1, 0, 2)[n % 3]}))
    return drafts


def _alike(rng: np.random.Generator, number: int) -> list[Draft]:
    first = int(rng.integers(len(_ALIKE)))
    drafts = []
    for n in range(number):
        kind, name = _ALIKE[(first + n) % len(_ALIKE)]
        drafts.append((kind, {"effects": (name,), "level": 1, "alike": True}))
    return drafts


def _outside(rng: np.random.Generator, number: int) -> list[Draft]:
    names = rng.permutation(list(OUTSIDE))
    drafts = []
    for n in range(number):
        name = str(names[n % len(names)])
        kind = str(rng.choice(OUTSIDE[name][1]))
        drafts.append((kind, {"effects": (f"outside:{name}",), "level": (1, 1, 2)[n % 3]}))
    return drafts


_MAKERS: Final = {
    "null": _nulls,
    "single": _singles,
    "concealed": _concealed,
    "pair": _pairs,
    "alike": _alike,
    "outside": _outside,
}
