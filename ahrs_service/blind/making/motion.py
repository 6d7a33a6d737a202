"""True motion of a blind recording, exact at any instant.

Two kinds: a table that turns about one body axis at a time in closed form, and vehicles whose
attitude and velocity are quintic splines. Both can be evaluated at any time: a late sample is
the motion at another instant, not an interpolation.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats
from ahrs_service.rotation import (
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)

KNOT_S: Final = 0.1
"""Spacing of the splines' knots [s]: the shortest manoeuvre lasts 0.5 s."""

_GRAVITY_NED: Final = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
"""Gravity [3] [m/s^2] in axes north, east, down."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion at N instants: `ned_from_body` [N, 4], the others [N, 3], SI, body axes or NED."""

    ned_from_body: Floats
    rate_rad_s: Floats
    force_m_s2: Floats
    velocity_ned_m_s: Floats
    position_ned_m: Floats


class Path(Protocol):
    """A motion that can be evaluated at any time."""

    def at(self, time_s: Floats) -> Motion:
        """Return the motion at times [N] since the start [s]."""
        ...


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn of the table: `angle` by the time since `start_s` [s], about body `axis` [3]."""

    start_s: float
    seconds: float
    axis: Floats
    angle: Callable[[Floats], tuple[Floats, Floats]]


@dataclass(frozen=True, slots=True)
class TablePath:
    """Rests and turns of a two-axis table with an encoder; the sensor is on the axes."""

    turns: tuple[Turn, ...]

    def at(self, time_s: Floats) -> Motion:
        """Return the motion at times [N] since the start [s]: at rest outside of the turns."""
        attitude = np.empty((len(time_s), 4))
        rate = np.zeros((len(time_s), 3))
        held = np.array([1.0, 0.0, 0.0, 0.0])
        attitude[:] = held
        for turn in self.turns:
            begin = np.searchsorted(time_s, turn.start_s)
            angle, speed = turn.angle(np.clip(time_s[begin:] - turn.start_s, 0.0, turn.seconds))
            attitude[begin:] = _about(held, turn.axis, angle)
            rate[begin:] = speed[:, None] * turn.axis
            held = _about(held, turn.axis, turn.angle(np.array([turn.seconds]))[0])[0]
        zeros = np.zeros_like(rate)
        force = rotate_columns(inverse_columns(attitude), zeros - _GRAVITY_NED)
        return Motion(attitude, rate, force, zeros, zeros)


def _about(held: Floats, axis: Floats, angle: Floats) -> Floats:
    """Attitude [N, 4] `held` [4], rotated about the body axis by angles [N] [rad]."""
    half = 0.5 * angle[:, None]
    rotation = np.concatenate([np.cos(half), np.sin(half) * axis], axis=1)
    return multiply_columns(np.broadcast_to(held, rotation.shape), rotation)


def _step(x: Floats) -> tuple[Floats, Floats]:
    """Rise from 0 to 1 as x - sin(2 pi x) / (2 pi), with its slope."""
    return x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi), 1.0 - np.cos(2.0 * np.pi * x)


def _sweep(total_rad: float, seconds: float) -> Callable[[Floats], tuple[Floats, Floats]]:
    def angle(since_s: Floats) -> tuple[Floats, Floats]:
        value, slope = _step(since_s / seconds)
        return total_rad * value, total_rad * slope / seconds

    return angle


def _swing(
    amplitude_rad: float, turn_rad_s: float, seconds: float
) -> Callable[[Floats], tuple[Floats, Floats]]:
    ramp_s = min(0.3 * seconds, 2.0)

    def angle(since_s: Floats) -> tuple[Floats, Floats]:
        edge = np.clip(np.minimum(since_s, seconds - since_s) / ramp_s, 0.0, 1.0)
        size, slope = _step(edge)
        slope = np.where(since_s < 0.5 * seconds, slope, -slope) / ramp_s
        sine, cosine = np.sin(turn_rad_s * since_s), np.cos(turn_rad_s * since_s)
        return (
            amplitude_rad * size * sine,
            amplitude_rad * (slope * sine + size * turn_rad_s * cosine),
        )

    return angle


def table_path(rng: np.random.Generator, seconds: float) -> TablePath:
    """Draw rests of 2..10 s, turns of 45 to 180 deg, and oscillations of up to 2.3 rad/s."""
    turns: list[Turn] = []
    start = rng.uniform(4.0, 8.0)
    tilt = rng.normal(0.0, 0.02, 3)
    while True:
        axis = np.eye(3)[rng.choice(3, p=(0.5, 0.25, 0.25))] + tilt
        axis /= np.linalg.norm(axis)
        peak = rng.uniform(0.6, 2.3) * rng.choice((-1.0, 1.0))
        if rng.random() < 0.55:
            total = np.radians(rng.choice((45.0, 90.0, 135.0, 180.0))) * np.sign(peak)
            length = 2.0 * total / peak
            angle = _sweep(float(total), float(length))
        else:
            amplitude = np.radians(rng.uniform(15.0, 80.0))
            turn = abs(peak) / amplitude
            length = 2.0 * np.pi / turn * rng.integers(2, 7)
            length = min(max(length, 4.0), 30.0)
            angle = _swing(float(amplitude), float(turn), float(length))
        if start + length > seconds - 2.0:
            return TablePath(tuple(turns))
        turns.append(Turn(start, float(length), axis, angle))
        start += length + rng.uniform(2.0, 10.0)


@dataclass(frozen=True, slots=True)
class VehiclePath:
    """Roll, pitch, yaw and north, east, down velocity as quintic splines [6 columns]."""

    curves: BSpline
    slopes: BSpline
    areas: BSpline

    @classmethod
    def through(cls, columns: Floats) -> "VehiclePath":
        """Return the path through columns [K, 6] (roll, pitch, yaw, velocity) at the knots."""
        times = KNOT_S * np.arange(len(columns)) - PAD_S
        curves = make_interp_spline(times, columns, k=5)
        return cls(curves, curves.derivative(), curves.antiderivative())

    def at(self, time_s: Floats) -> Motion:
        """Return the motion at times [N] since the start [s]."""
        value, slope = self.curves(time_s), self.slopes(time_s)
        roll, pitch = value[:, 0], value[:, 1]
        roll_rate, pitch_rate, turn = slope[:, 0], slope[:, 1], slope[:, 2]
        rate = np.stack(
            [
                roll_rate - turn * np.sin(pitch),
                pitch_rate * np.cos(roll) + turn * np.cos(pitch) * np.sin(roll),
                -pitch_rate * np.sin(roll) + turn * np.cos(pitch) * np.cos(roll),
            ],
            axis=1,
        )
        attitude = quaternion_columns(value[:, :3])
        force = rotate_columns(inverse_columns(attitude), slope[:, 3:] - _GRAVITY_NED)
        place = self.areas(time_s)[:, 3:] - self.areas(0.0)[3:]
        return Motion(attitude, rate, force, value[:, 3:], place)


PAD_S: Final = 1.0
"""The splines extend beyond both ends of the recording by this [s], for late samples."""


def knots(seconds: float) -> Floats:
    """Times of the knots [s], beyond both ends of a recording of `seconds` [s]."""
    return np.arange(-PAD_S, seconds + PAD_S + 0.5 * KNOT_S, KNOT_S)


def smooth(values: Floats, seconds: float) -> Floats:
    """Commands at the knots [K], smoothed over `seconds` [s]."""
    rounded: Floats = gaussian_filter1d(values, seconds / KNOT_S, axis=0, mode="nearest")
    return rounded


def wobble(rng: np.random.Generator, count: int, correlation_s: float, rms: float) -> Floats:
    """Band-limited noise at `count` knots: Gaussian correlation time [s] and root mean square."""
    raw = smooth(rng.standard_normal(count), correlation_s)
    return raw * (rms / raw.std())
