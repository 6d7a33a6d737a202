"""Random flights of a fixed wing and of a multirotor, with their throttle and airspeed."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.blind.making.motion import KNOT_S, VehiclePath, knots, smooth, wobble
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats

_REST_S: Final = 9.0  # A choice: rest before take-off [s]
_CLIMB_M_S: Final = 1.5  # A choice: the fastest climb or descent [m/s]


@dataclass(frozen=True, slots=True)
class Flight:
    """A path, with throttle [K] 0..1 and airspeed [K] [m/s] at its knots [K] [s]."""

    path: VehiclePath
    knots_s: Floats
    throttle: Floats
    airspeed_m_s: Floats


def fixed_wing(rng: np.random.Generator, seconds: float) -> Flight:
    """Draw a flight: take-off, then straights, turns, weaves, climbs and changes of speed."""
    times = knots(seconds)
    count = len(times)
    roll, climb, speed = np.zeros(count), np.zeros(count), np.full(count, 18.0)
    at = _REST_S + 12.0
    while at < seconds:
        length = rng.uniform(10.0, 24.0)
        here = (times >= at) & (times < at + length)
        what = rng.choice(
            ("straight", "turn", "weave", "climb", "speed"), p=(0.15, 0.3, 0.2, 0.2, 0.15)
        )
        if what == "turn":
            roll[here] = rng.uniform(0.3, 0.8) * rng.choice((-1.0, 1.0))
        elif what == "weave":
            roll[here] = rng.uniform(0.2, 0.5) * np.sin(
                2.0 * np.pi * (times[here] - at) / rng.uniform(6.0, 10.0)
            )
        elif what == "climb":
            climb[here] = rng.uniform(0.5, _CLIMB_M_S) * rng.choice((-1.0, 1.0))
        elif what == "speed":
            speed[here] = rng.uniform(14.0, 22.0)
        at += length + rng.uniform(2.0, 6.0)
    airborne = smooth((times > _REST_S + 2.5).astype(float), 1.2)
    speed = smooth(speed, 2.0) * airborne
    roll, climb = smooth(roll, 0.7), smooth(climb, 1.0)
    turn = airborne * STANDARD_GRAVITY_M_S2 * np.tan(roll) / np.maximum(speed, 5.0)
    course = rng.uniform(-np.pi, np.pi) + np.cumsum(turn) * KNOT_S
    lift = climb / np.maximum(speed, 5.0)
    gust = [airborne * wobble(rng, count, 0.35, rms) for rms in (0.02, 0.008, 0.006)]
    columns = np.stack(
        [
            roll + gust[0],
            airborne * (0.035 + lift) + gust[1],
            course + gust[2],
            speed * np.cos(course),
            speed * np.sin(course),
            airborne * (-climb + wobble(rng, count, 1.0, 0.12)),
        ],
        axis=1,
    )
    throttle = 0.5 + 0.08 * climb + 0.02 * (speed - 18.0) + wobble(rng, count, 0.3, 0.012)
    return Flight(VehiclePath.through(columns), times, np.clip(airborne * throttle, 0, 1), speed)


def multirotor(rng: np.random.Generator, seconds: float) -> Flight:
    """Draw an agile flight of a multirotor that is never at rest after take-off."""
    times = knots(seconds)
    count = len(times)
    airborne = smooth((times > _REST_S + 2.0).astype(float), 0.6)
    calm = rng.uniform(0.5, 1.2)
    yaw_rate = airborne * wobble(rng, count, 2.5, 0.54 * calm)
    velocity = [airborne * wobble(rng, count, 1.7, rms * calm) for rms in (2.9, 3.3, 0.75)]
    columns = np.stack(
        [
            airborne * wobble(rng, count, 0.35, 0.15 * calm),
            airborne * wobble(rng, count, 0.45, 0.16 * calm),
            np.cumsum(yaw_rate) * KNOT_S,
            *velocity,
        ],
        axis=1,
    )
    throttle = np.clip(0.5 + wobble(rng, count, 0.8, 0.055), 0.3, 0.8) * airborne
    airspeed = np.linalg.norm(columns[:, 3:5], axis=1)
    return Flight(VehiclePath.through(columns), times, throttle, airspeed)
