"""Simulated flights for robustness.py: what the simulator flies, and what it does not.

A multirotor: its velocity is a sum of sines, its thrust makes the acceleration and overcomes drag,
so attitude, force and velocity agree exactly. Starts that the simulator has not: in the air (the
beginning cut off), upside down on the ground and turned over by hand, thrown by hand.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats, Rows
from ahrs_service.rotation import (
    inverse_columns,
    multiply_columns,
    quaternion_columns,
    rotate_columns,
)
from ahrs_service.sensor.noise import TriadNoise
from ahrs_service.sensor.parameters import Calibration, TriadCalibration
from ahrs_service.simulation.environment import Propeller
from ahrs_service.simulation.imu import Imu, consumer_grade
from ahrs_service.simulation.scenario import SCENARIOS, fly_scenario
from ahrs_service.simulation.trajectory import TRUTH_DTYPE

GRAVITY: Final = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
DRAG_S: Final = 4.0
HELD_S: Final = 6.0
THROW_S: Final = 0.7


def poor_grade(seed: int) -> Imu:
    """A unit that nobody calibrated: 20 mrad/s, 0.5 m/s^2 and 2 % on axes drawn at random."""
    rng = np.random.default_rng(seed)

    def triad(bias: float) -> TriadCalibration:
        matrix = np.eye(3) + rng.uniform(-0.02, 0.02, (3, 3)) * (0.25 + 0.75 * np.eye(3))
        rows = tuple((x, y, z) for x, y, z in matrix.tolist())
        x, y, z = rng.uniform(-bias, bias, 3).tolist()
        return TriadCalibration(matrix=rows, bias=(x, y, z))  # type: ignore[arg-type]

    return Imu(
        calibration=Calibration(gyro=triad(0.02), accel=triad(0.5), serial="POOR", source="drawn"),
        gyro_noise=TriadNoise(density=5e-4, walk=1e-5, wander=1e-3, wander_s=100.0),
        accel_noise=TriadNoise(density=5e-3, walk=1e-4, wander=2e-2, wander_s=100.0),
        propeller=Propeller(accel_m_s2=1.5, gyro_rad_s=0.04),
    )


def imu_of(grade: str, seed: int) -> Imu:
    """The sensor: consumer or poor."""
    if grade == "poor":
        return poor_grade(seed)
    return replace(consumer_grade().sibling(np.random.default_rng(seed)), propeller=Propeller())


def fixed_wing(
    seconds: float, rate_hz: float, wind_m_s: float, turbulence: float, seed: int, name: str
) -> Rows:
    """Truth [N] TRUTH_DTYPE of a flight of the simulator."""
    weather = replace(SCENARIOS[name], wind_m_s=wind_m_s, turbulence=turbulence, imu=Imu())
    rows = fly_scenario(name, weather, seconds, seed, rate_hz).rows
    truth = np.zeros(len(rows), TRUTH_DTYPE)
    for field in TRUTH_DTYPE.names or ():
        truth[field] = rows[field]
    return truth


def multirotor(
    seconds: float, rate_hz: float, wind_m_s: float, turbulence: float, seed: int
) -> Rows:
    """Truth [N] TRUTH_DTYPE of a multirotor: at rest for 8 s, then flown about, down at the end."""
    rng = np.random.default_rng(seed)
    t = np.arange(math.floor(seconds * rate_hz) + 1) / rate_hz
    times = (t, t - 1e-4, t + 1e-4)
    size = np.array([3.0, 3.0, 0.8]) * (0.7 + 0.3 * turbulence)
    hertz, phase = rng.uniform(0.03, 0.35, (3, 5)), rng.uniform(0.0, 2.0 * np.pi, (3, 5))
    share = rng.uniform(0.3, 1.0, (3, 5))
    share *= size[:, None] / np.sqrt((share**2).sum(axis=1) / 2.0)[:, None]
    blowing = wind_m_s * np.array([0.8, 0.6, 0.0])

    def velocity(at: Floats) -> Floats:
        angle = 2.0 * np.pi * hertz * at[:, None, None] + phase
        return _flown(at, seconds)[:, None] * (share * np.sin(angle)).sum(axis=2)

    def acceleration(at: Floats) -> Floats:
        return (velocity(at + 1e-3) - velocity(at - 1e-3)) / 2e-3

    def attitude(at: Floats) -> Floats:
        air = velocity(at) - blowing * _flown(at, seconds)[:, None]
        lift = acceleration(at) - GRAVITY + air / DRAG_S
        down = -lift / np.linalg.norm(lift, axis=1, keepdims=True)
        yaw = 1.5 * np.sin(0.11 * at) * _flown(at, seconds) + 0.3
        forward = np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)
        right = np.cross(down, forward)
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        return _quaternions(np.cross(right, down), right, down)

    now, before, after = (attitude(at) for at in times)
    turn = multiply_columns(inverse_columns(before), after)
    turn *= np.where(turn[:, :1] < 0.0, -1.0, 1.0)
    truth = np.zeros(len(t), TRUTH_DTYPE)
    truth["time_s"], truth["ned_from_body"] = t, now
    truth["rate_rad_s"] = 2.0 * turn[:, 1:] / 2e-4
    truth["force_m_s2"] = rotate_columns(inverse_columns(now), acceleration(t) - GRAVITY)
    truth["velocity_ned_m_s"] = velocity(t)
    truth["airborne"] = _flown(t, seconds)
    truth["throttle"] = 0.6 * truth["airborne"]
    truth["airspeed_m_s"] = np.linalg.norm(
        velocity(t) - blowing * truth["airborne"][:, None], axis=1
    )
    return truth


def _flown(t: Floats, seconds: float) -> Floats:
    """0 on the ground, 1 in flight, smooth between."""
    up = np.clip((t - 8.0) / 4.0, 0.0, 1.0) * np.clip((seconds - 4.0 - t) / 4.0, 0.0, 1.0)
    return np.asarray(up**3 * (10.0 - 15.0 * up + 6.0 * up**2))


def _quaternions(x: Floats, y: Floats, z: Floats) -> Floats:
    """Quaternions [N, 4] of the body's axes in earth axes, each [N, 3]; upright enough."""
    roll, pitch = np.arctan2(y[:, 2], z[:, 2]), -np.arcsin(x[:, 2])
    yaw = np.arctan2(x[:, 1], x[:, 0])
    return quaternion_columns(np.stack([roll, pitch, yaw], axis=1))


def in_the_air(truth: Rows, from_s: float) -> Rows:
    """The flight from `from_s` on."""
    cut = truth[truth["time_s"] >= from_s].copy()
    cut["time_s"] -= cut["time_s"][0]
    return cut


def turned_over(truth: Rows, rate_hz: float) -> Rows:
    """Before the flight, on its back and rolled upright by hand in the last 2 s of 6."""
    t = np.arange(round(HELD_S * rate_hz)) / rate_hz
    share = np.clip((t - HELD_S + 2.0) / 2.0, 0.0, 1.0)
    roll = np.pi * (1.0 - share**2 * (3.0 - 2.0 * share))
    zero = np.zeros_like(t)
    turn = quaternion_columns(np.stack([roll, zero, zero], axis=1))
    head = _held(truth, t)
    head["ned_from_body"] = multiply_columns(truth["ned_from_body"][0], turn)
    head["rate_rad_s"][:, 0] = np.gradient(roll, t)
    head["force_m_s2"] = rotate_columns(inverse_columns(head["ned_from_body"]), -GRAVITY)
    return _joined(head, truth)


def thrown(truth: Rows, from_s: float, rate_hz: float) -> Rows:
    """Held in a hand that moves a little, then thrown into the flight as it is at `from_s`."""
    flight = in_the_air(truth, from_s)
    t = np.arange(round(HELD_S * rate_hz)) / rate_hz
    head = _held(flight, t)
    wobble = 0.04 * np.sin(2.0 * np.pi * 1.3 * t) * np.clip((HELD_S - 1.0 - t) / 2.0, 0.0, 1.0)
    turn = np.stack([wobble, 0.5 * wobble, 0.0 * t], axis=1)
    head["ned_from_body"] = multiply_columns(flight["ned_from_body"][0], quaternion_columns(turn))
    head["rate_rad_s"] = np.gradient(turn, t, axis=0)
    push = np.clip((t - HELD_S + THROW_S) / THROW_S, 0.0, 1.0) > 0.0
    head["velocity_ned_m_s"] = np.cumsum(push)[:, None] / push.sum() * flight["velocity_ned_m_s"][0]
    gain = push[:, None] * flight["velocity_ned_m_s"][0] / THROW_S
    head["force_m_s2"] = rotate_columns(inverse_columns(head["ned_from_body"]), gain - GRAVITY)
    return _joined(head, flight)


def _held(truth: Rows, t: Floats) -> Rows:
    head = np.zeros(len(t), TRUTH_DTYPE)
    head["time_s"] = t
    return head


def _joined(head: Rows, flight: Rows) -> Rows:
    later = flight.copy()
    later["time_s"] += HELD_S
    return np.concatenate([head, later])
