"""The plan of a flight: phases with constant commands, made into smooth command curves."""

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Annotated, ClassVar, Final

import numpy as np
from annotated_types import Ge, Gt, Le

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats
from ahrs_service.sensor.noise import gauss_markov
from ahrs_service.simulation.spline import UniformSpline

STEP_S: Final = 0.1
CRUISE_M_S: Final = 18.0
SHORTEST_S: Final = 40.0
"""Time that a whole flight needs [s]; the plan of a shorter one is this long."""

_SETTLE_S: Final = 1.2
_WIND_S: Final = 5.0
_CIRCUIT_S: Final = 300.0
_PARKED_ROLL: Final = math.radians(-1.0)
_PARKED_PITCH: Final = math.radians(3.0)
_CRUISE_ATTACK: Final = math.radians(4.0)
_LARGEST_ATTACK: Final = math.radians(12.0)


_Angle = Annotated[float, Ge(-70.0), Le(70.0)]


class Channel(IntEnum):
    """The command curves, by column."""

    ROLL = 0
    PITCH = 1
    SPEED = 2
    ATTACK = 3
    AIRBORNE = 4
    BUMPS = 5
    WIND = 6
    THROTTLE = 7


@dataclass(frozen=True, slots=True)
class Phase:
    """One part of a flight, with what is commanded in it.

    `roll_deg`, `climb_deg` (path angle) and `throttle` hold; `speed_m_s` is reached at its end;
    `wave_deg` is the amplitude of up-and-down waves of the path; the altitude gained before is
    given back where `is_closing`; `is_elastic` phases take up the length of the flight.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}
    name: str
    seconds: Annotated[float, Gt(0.0), Le(86_400.0)]
    roll_deg: _Angle = 0.0
    climb_deg: _Angle = 0.0
    speed_m_s: Annotated[float, Ge(0.0), Le(100.0)] = CRUISE_M_S
    throttle: Annotated[float, Ge(0.0), Le(1.0)] = 0.6
    wave_deg: _Angle = 0.0
    is_airborne: bool = True
    is_closing: bool = False
    is_elastic: bool = True


_PARKED: Final = Phase("warm-up", 7.0, speed_m_s=0.0, throttle=0.15, is_airborne=False)
_TAKE_OFF: Final = Phase("take-off run", 6.0, throttle=1.0, is_airborne=False, is_elastic=False)
_CLIMB: Final = Phase("climb", 5.0, climb_deg=8.0, throttle=0.9)
_CIRCUIT: Final = (
    Phase("climbing turn", 9.0, roll_deg=30.0, climb_deg=6.0, throttle=0.85),
    Phase("level", 3.0),
    Phase("circling", 10.0, roll_deg=-40.0, throttle=0.7),
    Phase("pitch manoeuvres", 6.0, wave_deg=16.0, throttle=0.65),
    Phase("descending turn", 7.0, roll_deg=25.0, speed_m_s=16.0, throttle=0.3, is_closing=True),
)
_SEED_CIRCUIT: Final = (
    Phase("level", 50.0),
    Phase("coordinated turn", 25.0, roll_deg=25.0, throttle=0.65),
    Phase("level", 50.0),
    Phase("circling", 60.0, roll_deg=-30.0, throttle=0.65),
    Phase("level", 40.0),
    Phase("pitch manoeuvres", 30.0, wave_deg=12.0, throttle=0.65),
    Phase("level", 30.0),
    Phase("coordinated turn", 15.0, roll_deg=-35.0, throttle=0.7),
)
_LANDING: Final = Phase(
    "landing", 6.0, speed_m_s=0.0, throttle=0.1, is_airborne=False, is_elastic=False
)
_STOPPED: Final = replace(_PARKED, name="stopped", seconds=1.0, is_elastic=False)


def rest_phases(seconds: float) -> tuple[Phase, ...]:
    """Return a plan of `seconds` [s] at rest on the ground."""
    return (replace(_PARKED, seconds=seconds),)


def flight_phases(seconds: float) -> tuple[Phase, ...]:
    """Return a whole flight of `seconds` [s] (at least 40), longer ones with more circuits."""
    circuits = max(1, round(seconds / _CIRCUIT_S))
    return _stretched(
        (_PARKED, _TAKE_OFF, _CLIMB, *_CIRCUIT * circuits, _LANDING, _STOPPED), seconds
    )


def circling_phases(seconds: float) -> tuple[Phase, ...]:
    """Return a flight that circles for most of its `seconds` [s]: the hard case of attitude."""
    circling = replace(_CIRCUIT[2], seconds=60.0, roll_deg=-30.0)
    return _stretched(
        (_PARKED, _TAKE_OFF, _CLIMB, circling, _CIRCUIT[4], _LANDING, _STOPPED), seconds
    )


def seed_flight_phases(seconds: float) -> tuple[Phase, ...]:
    """Return a flight of `seconds` [s] of the seed's manoeuvres (Liu et al., sec. 5).

    Take-off run, level flight, coordinated turns, circling, pitch manoeuvres, landing; the text
    gives no times: two thirds are level, a circuit of all manoeuvres takes about five minutes.
    """
    circuits = max(1, round(seconds / _CIRCUIT_S))
    climb = replace(_CLIMB, seconds=15.0)
    down = replace(_CIRCUIT[4], seconds=30.0)
    parked = replace(_PARKED, seconds=20.0)
    return _stretched(
        (parked, _TAKE_OFF, climb, *_SEED_CIRCUIT * circuits, down, _LANDING, _STOPPED), seconds
    )


def scripted_phases(phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    """Return a plan of phases as long as they say, the altitude of the closing ones given back."""
    return _stretched(phases, sum(phase.seconds for phase in phases), least_s=0.0)


def _stretched(
    phases: tuple[Phase, ...], seconds: float, least_s: float = SHORTEST_S
) -> tuple[Phase, ...]:
    """Stretch the elastic phases to `seconds` and set the path angle of the closing ones."""
    seconds = max(seconds, least_s)
    elastic = sum(phase.seconds for phase in phases if phase.is_elastic)
    fixed = sum(phase.seconds for phase in phases if not phase.is_elastic)
    altitude_m, plan = 0.0, []
    for phase in phases:
        share = (seconds - fixed) / elastic if phase.is_elastic and elastic > 0.0 else 1.0
        way_m = CRUISE_M_S * phase.seconds * share
        climb_deg = phase.climb_deg
        if phase.is_closing:
            climb_deg = -math.degrees(math.asin(altitude_m / way_m))
        altitude_m += way_m * math.sin(math.radians(climb_deg))
        plan.append(replace(phase, seconds=phase.seconds * share, climb_deg=climb_deg))
    return tuple(plan)


def command_curves(
    phases: tuple[Phase, ...], turbulence: float, rng: np.random.Generator
) -> UniformSpline:
    """Return the command curves [Channel] of a plan.

    `turbulence` scales random attitude and speed disturbances in the air; 1 is a breezy day.
    """
    roll, climb, speed, air, throttle = _steps(phases)
    air_now = _smooth(air, _SETTLE_S)
    roll, climb, speed, throttle = (
        _smooth(column, _SETTLE_S) for column in (roll, climb, speed, throttle)
    )
    gusts = gauss_markov(rng, (len(air), 4), turbulence, 0.7, 1.0 / STEP_S) * air_now[:, None]
    roll = roll + math.radians(1.5) * gusts[:, 0] + (1.0 - air_now) * _PARKED_ROLL
    climb = climb + math.radians(0.7) * gusts[:, 1]
    speed = speed + 0.3 * gusts[:, 2]
    # What the gusts and the rounded corners did to the altitude is spread over the flight.
    way_m = np.sum(speed * air_now) * STEP_S
    gained_m = np.sum(speed * air_now * np.sin(climb)) * STEP_S
    climb = climb - gained_m / max(way_m, 1.0)
    pitch, attack = _pitch_and_attack(roll, climb, speed, air_now)
    attack = attack + math.radians(0.4) * gusts[:, 3]
    bumps = (1.0 - air_now) * speed / CRUISE_M_S
    wind = _smooth(air, _WIND_S)
    columns = (roll, pitch, speed, attack, air_now, bumps, wind, throttle)
    return UniformSpline(np.stack(columns, axis=1), STEP_S)


def _steps(phases: tuple[Phase, ...]) -> tuple[Floats, ...]:
    """Return roll, climb [rad], speed [m/s], airborne and throttle, one point every STEP_S."""
    ends = np.cumsum([phase.seconds for phase in phases])
    time_s = np.arange(math.ceil(ends[-1] / STEP_S - 1e-9) + 1) * STEP_S
    which = np.minimum(np.searchsorted(ends, time_s, side="right"), len(phases) - 1)
    begins = np.concatenate([[0.0], ends[:-1]])
    speeds = [phases[0].speed_m_s, *(phase.speed_m_s for phase in phases)]
    climb = np.radians([phase.climb_deg for phase in phases])[which]
    for k, phase in enumerate(phases):
        waves = max(2, round(phase.seconds / 4.0))
        share = (time_s[which == k] - begins[k]) / phase.seconds
        climb[which == k] += math.radians(phase.wave_deg) * np.sin(2.0 * np.pi * waves * share)
    return (
        np.radians([phase.roll_deg for phase in phases])[which],
        climb,
        np.interp(time_s, [0.0, *ends], speeds),
        np.array([float(phase.is_airborne) for phase in phases])[which],
        np.array([phase.throttle for phase in phases])[which],
    )


def _smooth(column: Floats, width_s: float) -> Floats:
    """Average twice over `width_s`, so that a step becomes a ramp with round corners."""
    half = round(width_s / STEP_S / 2.0)
    box = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    for _ in range(2):
        column = np.convolve(np.pad(column, half, mode="edge"), box, mode="valid")
    return column


def _pitch_and_attack(
    roll: Floats, climb: Floats, speed: Floats, air: Floats
) -> tuple[Floats, Floats]:
    """Return pitch and angle of attack [rad] that fly the path angle `climb` [rad].

    Lift grows with attack and speed squared and carries g / cos(roll). The path angle is
    sin(climb) = cos(attack) sin(pitch) - sin(attack) cos(roll) cos(pitch), solved for pitch.
    On the ground the pitch is that of the parked aircraft and the path is level.
    """
    load = STANDARD_GRAVITY_M_S2 / np.cos(roll)
    lift = STANDARD_GRAVITY_M_S2 * (np.maximum(speed, 1.0) / CRUISE_M_S) ** 2
    attack = np.minimum(_CRUISE_ATTACK * load / lift, _LARGEST_ATTACK)
    across, along = np.sin(attack) * np.cos(roll), np.cos(attack)
    flown = np.arctan2(across, along) + np.arcsin(np.sin(climb) / np.hypot(across, along))
    pitch = air * flown + (1.0 - air) * _PARKED_PITCH
    return pitch, air * attack + (1.0 - air) * pitch
