"""True motion of a flight: attitude, rate, specific force, velocity and position agree exactly.

Given roll, pitch, air speed V, angle of attack and heave h as curves with exact slopes, the air
velocity in body axes is v = (V cos a, 0, V sin a + h), and

    w = body rate of the Euler angles       f = dv/dt + w x v + R^T (dW/dt - g)

with R = ned_from_body and W the wind. In the air the heading rate is the one without lateral
force, f_y = 0: the coordinated turn, with its centripetal acceleration. On the ground the heading
holds. Heading is integrated by Gauss-Legendre quadrature of its rate, to rounding.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats, Rows
from ahrs_service.rotation import inverse_columns, quaternion_columns, rotate_columns
from ahrs_service.simulation.phases import Channel
from ahrs_service.simulation.spline import UniformSpline

TRUTH_DTYPE: Final = np.dtype(
    [
        ("time_s", "f8"),
        ("ned_from_body", "f8", 4),
        ("rate_rad_s", "f8", 3),
        ("force_m_s2", "f8", 3),
        ("velocity_ned_m_s", "f8", 3),
        ("position_ned_m", "f8", 3),
        ("airspeed_m_s", "f8"),
        ("throttle", "f8"),
        ("airborne", "f8"),
    ]
)
"""True motion: time from the start [s], position from the start, `airborne` and throttle 0..1."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_GRAVITY_NED: Final = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])


@dataclass(frozen=True, slots=True)
class Bumps:
    """Roughness of the ground: sums of sines of roll, pitch [rad] and heave [m/s].

    `amplitude`, `frequency_hz` and `phase` are [3, K], for roll, pitch and heave.
    """

    amplitude: Floats
    frequency_hz: Floats
    phase: Floats

    @classmethod
    def draw(cls, rng: np.random.Generator, count: int = 4) -> "Bumps":
        """Draw a rough grass strip: some 3 m/s^2 of heave at take-off speed."""
        size = np.array([math.radians(0.25), math.radians(0.3), 0.05])[:, None]
        return cls(
            amplitude=size * rng.uniform(0.5, 1.5, (3, count)),
            frequency_hz=np.array([1.0, 1.5, 3.0])[:, None] * rng.uniform(0.8, 2.5, (3, count)),
            phase=rng.uniform(0.0, 2.0 * np.pi, (3, count)),
        )

    def evaluate(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return values and slopes [1/s], both [N, 3], at full size."""
        turn = 2.0 * np.pi * self.frequency_hz
        angle = turn * time_s[:, None, None] + self.phase
        value = (self.amplitude * np.sin(angle)).sum(axis=2)
        return value, (self.amplitude * turn * np.cos(angle)).sum(axis=2)


@dataclass(frozen=True, slots=True)
class _Motion:
    """Euler angles and body velocity with their slopes, at given times [N]."""

    roll: Floats
    pitch: Floats
    roll_rate: Floats
    pitch_rate: Floats
    heading_rate: Floats
    velocity: Floats
    acceleration: Floats
    commands: Floats
    slopes: Floats


def _motion(curves: UniformSpline, bumps: Bumps, time_s: Floats) -> _Motion:
    value, slope = curves.evaluate(time_s)
    size, size_slope = value[:, Channel.BUMPS, None], slope[:, Channel.BUMPS, None]
    bump, bump_slope = bumps.evaluate(time_s)
    bump_slope = size * bump_slope + size_slope * bump
    bump = size * bump
    roll, pitch = value[:, Channel.ROLL] + bump[:, 0], value[:, Channel.PITCH] + bump[:, 1]
    roll_rate = slope[:, Channel.ROLL] + bump_slope[:, 0]
    pitch_rate = slope[:, Channel.PITCH] + bump_slope[:, 1]
    speed, speed_slope = value[:, Channel.SPEED], slope[:, Channel.SPEED]
    sin_a, cos_a = np.sin(value[:, Channel.ATTACK]), np.cos(value[:, Channel.ATTACK])
    attack_rate = slope[:, Channel.ATTACK]
    u, w = speed * cos_a, speed * sin_a + bump[:, 2]
    u_slope = speed_slope * cos_a - speed * sin_a * attack_rate
    w_slope = speed_slope * sin_a + speed * cos_a * attack_rate + bump_slope[:, 2]
    # f_y = u r - w p - g sin(roll) cos(pitch) = 0, solved for the heading rate.
    push = STANDARD_GRAVITY_M_S2 * np.sin(roll) * np.cos(pitch)
    push += u * pitch_rate * np.sin(roll) + w * roll_rate
    lever = u * np.cos(pitch) * np.cos(roll) + w * np.sin(pitch)
    airborne = value[:, Channel.AIRBORNE]
    turn = np.divide(airborne * push, lever, out=np.zeros_like(push), where=airborne > 0.0)
    zero = np.zeros_like(u)
    return _Motion(
        roll,
        pitch,
        roll_rate,
        pitch_rate,
        turn,
        np.stack([u, zero, w], axis=1),
        np.stack([u_slope, zero, w_slope], axis=1),
        value,
        slope,
    )


def _headings(curves: UniformSpline, bumps: Bumps, time_s: Floats, start_rad: float) -> Floats:
    """Integrate the heading rate between the times."""
    half = 0.5 * np.diff(time_s)
    middle = time_s[:-1] + half
    gained = np.zeros(len(time_s))
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        rate = _motion(curves, bumps, middle + node * half).heading_rate
        gained[1:] += weight * half * rate
    return start_rad + np.cumsum(gained)


def _body_rates(motion: _Motion) -> Floats:
    """Body rates [N, 3] of the Euler angle rates (Z-Y-X)."""
    roll, pitch, turn = motion.roll, motion.pitch, motion.heading_rate
    return np.stack(
        [
            motion.roll_rate - turn * np.sin(pitch),
            motion.pitch_rate * np.cos(roll) + turn * np.cos(pitch) * np.sin(roll),
            -motion.pitch_rate * np.sin(roll) + turn * np.cos(pitch) * np.cos(roll),
        ],
        axis=1,
    )


def _positions(time_s: Floats, velocity: Floats, acceleration: Floats) -> Floats:
    """Integrate velocity by the trapezoid with its end correction, of fourth order."""
    dt = np.diff(time_s)[:, None]
    steps = 0.5 * dt * (velocity[1:] + velocity[:-1])
    steps += dt * dt / 12.0 * (acceleration[:-1] - acceleration[1:])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def fly(
    curves: UniformSpline, bumps: Bumps, wind_ned_m_s: Floats, heading_rad: float, time_s: Floats
) -> Rows:
    """Return the true motion [N] TRUTH_DTYPE at the times [N] [s].

    `wind_ned_m_s` [3] is the wind aloft [m/s], `heading_rad` the heading on the ground [rad].
    """
    motion = _motion(curves, bumps, time_s)
    rows = np.zeros(len(time_s), TRUTH_DTYPE)
    heading = _headings(curves, bumps, time_s, heading_rad)
    attitude = quaternion_columns(np.stack([motion.roll, motion.pitch, heading], axis=1))
    rate = _body_rates(motion)
    wind = motion.commands[:, Channel.WIND, None] * wind_ned_m_s
    gust = motion.slopes[:, Channel.WIND, None] * wind_ned_m_s
    force = motion.acceleration + np.cross(rate, motion.velocity)
    force += rotate_columns(inverse_columns(attitude), gust - _GRAVITY_NED)
    velocity = rotate_columns(attitude, motion.velocity) + wind
    acceleration = rotate_columns(attitude, force) + _GRAVITY_NED
    rows["time_s"] = time_s
    rows["ned_from_body"] = attitude
    rows["rate_rad_s"] = rate
    rows["force_m_s2"] = force
    rows["velocity_ned_m_s"] = velocity
    rows["position_ned_m"] = _positions(time_s, velocity, acceleration)
    rows["airspeed_m_s"] = motion.commands[:, Channel.SPEED]
    rows["throttle"] = motion.commands[:, Channel.THROTTLE]
    rows["airborne"] = motion.commands[:, Channel.AIRBORNE]
    return rows
