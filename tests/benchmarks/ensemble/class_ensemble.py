"""Flights drawn from what the settings of a class of airframe state: the ensemble of consistency.

Errors of the sensors and motion are random, their 1-sigmas those of the settings: gyro bias,
matrix, bias walk and noise; accelerometer bias, scale, and what shakes it, which comes from the
engine and is absent at rest. Along a body axis with drag the vehicle is pushed by

    f = f0 - (v - n) / T

n a Gauss-Markov process of `velocity_sigma_m_s` and `velocity_correlation_s`, T right to DRAG_SHARE
(fusion.motion); along the others v follows such a process itself. Roll, pitch and throttle of a
fixed wing are those of a scenario, at a forward speed of its own and without the angle of attack,
which is trim; a multirotor leans, and what is held in the hand turns, at random. On the ground only
the sensors are drawn: the motion is that of the scenario, rest or a table.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.app.files import config_file
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import force_scale, velocity_constraints
from ahrs_service.records import SAMPLE_DTYPE, Airframe, Floats, ImuSource, Rows, empty
from ahrs_service.rotation import inverse_columns, quaternion_columns, rotate_columns
from ahrs_service.sensor.noise import TriadNoise, gauss_markov, sensor_noise
from ahrs_service.settings import AirframeSettings, FusionSettings, Settings
from ahrs_service.simulation.phases import CRUISE_M_S, Channel, command_curves
from ahrs_service.simulation.scenario import SCENARIOS
from ahrs_service.simulation.spline import UniformSpline

from .air_resistance import attitude_of_rate, pushed_force

RATE_HZ: Final = 100.0
FINE: Final = 4
"""Steps in which the motion is computed, per sample."""
KNOT_S: Final = 0.1
GROUND_S: Final = 8.0
"""Rest before it moves, where no scenario says how long [s]."""
RISE_S: Final = 2.0
VIBRATION_S: Final = 0.03
"""Correlation of what shakes: a fixed wing's 0.2 m/s per sqrt(s) is then 0.8 m/s^2, the size
that simulation.environment.Propeller has, a multirotor's 0.35 is 1.4 m/s^2."""
QUIET_M_S2_RTHZ: Final = 2e-3
"""Noise of an accelerometer that nothing shakes."""
SLOWEST_M_S: Final = 8.0
"""No small wing flies slower."""
TILT_RAD: Final = math.radians(8.0)
TURN_RAD_S: Final = 0.3
LEAN_S: Final = 2.0
"""How a multirotor leans and turns, 1-sigma (quad106: 6 deg, 0.2 rad/s), and for how long."""
HAND_RATE_RAD_S: Final = 1.0
HAND_S: Final = 0.5
"""How fast a hand turns a sensor, 1-sigma about each axis (BROAD: 0.5 to 3 rad/s)."""

_DOWN: Final = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])


@dataclass(frozen=True)
class DrawnFlight:
    """One flight: true attitude [N, 4], samples [N], and its settings."""

    settings: Settings
    ned_from_body: Floats
    samples: Rows


@dataclass(frozen=True)
class _Plan:
    """Fine steps [M]: attitude, rate, commanded velocity, share in the air, shake of 0 to 1."""

    attitude: Floats
    rate: Floats
    velocity: Floats
    air: Floats
    shake: Floats


def _curve(rng: np.random.Generator, time_s: Floats, sigmas: Floats, lasts_s: float) -> Floats:
    """Smooth Gauss-Markov columns [M, len(sigmas)]."""
    knots = math.ceil(time_s[-1] / KNOT_S) + 1
    control = gauss_markov(rng, (knots, len(sigmas)), 1.0, lasts_s, 1.0 / KNOT_S) * sigmas
    return UniformSpline(control, KNOT_S).evaluate(time_s)[0]


def _euler_plan(time_s: Floats, euler: Floats) -> tuple[Floats, Floats]:
    """Attitude and body rate (Z-Y-X) of Euler angles [M, 3]."""
    roll, pitch, _ = euler.T
    slopes = np.gradient(euler, time_s, axis=0).T
    rate = (
        slopes[0] - slopes[2] * np.sin(pitch),
        slopes[1] * np.cos(roll) + slopes[2] * np.cos(pitch) * np.sin(roll),
        -slopes[1] * np.sin(roll) + slopes[2] * np.cos(pitch) * np.cos(roll),
    )
    return quaternion_columns(euler), np.stack(rate, axis=1)


def _wing(scenario: str, a: AirframeSettings, time_s: Floats, rng: np.random.Generator) -> _Plan:
    """Roll, pitch and throttle of a scenario, turning as a coordinated turn does."""
    curves = command_curves(SCENARIOS[scenario].phases(time_s[-1]), 1.0, rng)
    value, _ = curves.evaluate(time_s)
    usual = max(SLOWEST_M_S, rng.normal(a.forward_speed_m_s, a.velocity_sigma_m_s[0]))
    air = value[:, Channel.AIRBORNE]
    speed = value[:, Channel.SPEED] * usual / CRUISE_M_S
    roll, pitch = value[:, Channel.ROLL], value[:, Channel.PITCH] - value[:, Channel.ATTACK]
    turn = air * STANDARD_GRAVITY_M_S2 * np.tan(roll) / np.maximum(speed, SLOWEST_M_S)
    heading = rng.uniform(-np.pi, np.pi) + np.cumsum(turn) * (time_s[1] - time_s[0])
    attitude, rate = _euler_plan(time_s, np.stack([roll, pitch, heading], axis=1))
    velocity = np.stack([speed, np.zeros_like(speed), np.zeros_like(speed)], axis=1)
    # Thrust grows with the throttle's square; a rough strip shakes as much as the engine does.
    shake = np.maximum(value[:, Channel.THROTTLE] ** 2, (1.0 - air) * speed / CRUISE_M_S)
    return _Plan(attitude, rate, velocity, air, shake)


def _rotor(a: AirframeSettings, time_s: Floats, rng: np.random.Generator) -> _Plan:
    """A multirotor that leans and climbs at random, hovering between."""
    air = np.clip((time_s - GROUND_S) / RISE_S, 0.0, 1.0)
    lean = _curve(rng, time_s, np.array([TILT_RAD, TILT_RAD, TURN_RAD_S]), LEAN_S)
    euler = lean * air[:, None] + np.radians(rng.normal(0.0, 1.0, 3))
    euler[:, 2] = rng.uniform(-np.pi, np.pi)
    euler[:, 2] += np.cumsum(air * lean[:, 2]) * (time_s[1] - time_s[0])
    attitude, rate = _euler_plan(time_s, euler)
    velocity = np.zeros((len(time_s), 3))
    climb = _curve(rng, time_s, np.array([a.climb_sigma_m_s]), a.climb_correlation_s)
    velocity[:, 2] = air * climb[:, 0]
    return _Plan(attitude, rate, velocity, air, air)


def _hand(a: AirframeSettings, time_s: Floats, rng: np.random.Generator) -> _Plan:
    """A sensor that a hand turns and moves about at random."""
    air = np.clip((time_s - GROUND_S) / RISE_S, 0.0, 1.0)[:, None]
    rate = air * _curve(rng, time_s, np.full(3, HAND_RATE_RAD_S), HAND_S)
    start = quaternion_columns(rng.uniform(-np.pi, np.pi, (1, 3)) * [1.0, 0.4, 1.0])[0]
    sigmas, lasts = np.array(a.velocity_sigma_m_s), a.velocity_correlation_s[0]
    velocity = air * _curve(rng, time_s, sigmas, lasts)
    attitude = attitude_of_rate(rate, start, time_s[1] - time_s[0])
    return _Plan(attitude, rate, velocity, air[:, 0], air[:, 0])


def _bench(scenario: str, time_s: Floats, rng: np.random.Generator) -> tuple[_Plan, Floats]:
    """Plan and specific force [M, 3] of a scenario on the ground."""
    chosen = SCENARIOS[scenario]
    phases, still = chosen.phases(float(time_s[-1])), np.zeros(len(time_s))
    if chosen.bench is not None:
        truth = chosen.bench.truth(phases, rng.uniform(-np.pi, np.pi), time_s)
        attitude, rate, force = (
            truth[name] for name in ("ned_from_body", "rate_rad_s", "force_m_s2")
        )
    else:
        euler = np.array([*np.radians(rng.normal(0.0, 3.0, 2)), rng.uniform(-np.pi, np.pi)])
        attitude = quaternion_columns(np.broadcast_to(euler, (len(time_s), 3)))
        rate = np.zeros((len(time_s), 3))
        force = rotate_columns(inverse_columns(attitude), -_DOWN)
    return _Plan(attitude, rate, np.zeros_like(rate), still, still), force


def draw(
    profile: str, scenario: str, seconds: float, seed: int, mode: str = "velocity"
) -> DrawnFlight:
    """Draw one flight of a profile: `scenario` names one of the simulator's, or is "moved"."""
    settings = config_file.load(None, [f"fusion.mode={mode}"], profile)
    airframe: AirframeSettings = getattr(settings, settings.fusion.airframe)
    dice = [np.random.default_rng([seed, part]) for part in range(3)]
    time_s = np.arange(math.floor(seconds * RATE_HZ) * FINE) / (RATE_HZ * FINE)
    if profile == "ground_test":
        plan, force = _bench(scenario, time_s, dice[0])
    else:
        if scenario in SCENARIOS:
            plan = _wing(scenario, airframe, time_s, dice[0])
        else:
            plan = (_rotor if profile == "multirotor" else _hand)(airframe, time_s, dice[0])
        force = _pushed(plan, airframe, time_s, dice[1])
    rate, attitude = plan.rate[::FINE], plan.attitude[::FINE]
    if settings.fusion.gyro_sample == "mean":
        # The rate of a fine step leads from its attitude to the next one's.
        rate, force = (v.reshape(-1, FINE, 3).mean(axis=1) for v in (plan.rate, force))
        attitude = np.concatenate([attitude[1:], plan.attitude[-1:]])
    else:
        force = force[::FINE]
    sensed = _sensed(settings.fusion, airframe, rate, force, plan.shake[::FINE], dice[2])
    samples = empty(SAMPLE_DTYPE, len(rate))
    samples["time_ns"] = np.rint(np.arange(len(rate)) * 1e9 / RATE_HZ).astype(np.int64)
    samples["received_ns"] = samples["time_ns"]
    samples["gyro_rad_s"], samples["accel_m_s2"] = sensed
    samples["source"] = ImuSource.HIGHRES_IMU
    samples["airframe"] = Airframe[settings.fusion.airframe.upper()]
    return DrawnFlight(settings, attitude, samples)


def _pushed(plan: _Plan, a: AirframeSettings, time_s: Floats, rng: np.random.Generator) -> Floats:
    """Specific force [M, 3] of the plan."""
    fine_hz = 1.0 / (time_s[1] - time_s[0])
    noise = np.zeros((len(time_s), 3))
    for i in range(3):
        sigma, lasts_s = a.velocity_sigma_m_s[i], a.velocity_correlation_s[i]
        noise[:, i] = gauss_markov(rng, (len(time_s), 1), sigma, lasts_s, fine_hz)[:, 0]
    drag_s = np.array(a.drag_s) * (
        1.0 + velocity_constraints.DRAG_SHARE * np.clip(rng.normal(size=3), -2, 2)
    )
    gravity = rotate_columns(inverse_columns(plan.attitude), _DOWN)
    drag_s = np.where(plan.air[:, None] > 0.5, drag_s, 0.0)
    return pushed_force(plan.velocity, noise, drag_s, plan.rate, gravity, 1.0 / fine_hz)


def _sensed(
    fusion: FusionSettings,
    a: AirframeSettings,
    rate: Floats,
    force: Floats,
    shake: Floats,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """What a sensor of the class shows of rate and force [N, 3]."""
    scale = 1.0
    if a.accel_bias_sigma_m_s2 > 0.0:
        scale += rng.normal(0.0, min(a.accel_scale_error, force_scale.SIGMA))
    excess = np.linalg.norm(force, axis=1) - STANDARD_GRAVITY_M_S2
    density = np.hypot(a.velocity_noise_m_s_rts * shake, a.accel_scale_error * excess)
    unit = gauss_markov(rng, rate.shape, 1.0, VIBRATION_S, RATE_HZ)
    shaken = (density / math.sqrt(2.0 * VIBRATION_S))[:, None] * unit
    accel = scale * force + shaken + rng.normal(0.0, a.accel_bias_sigma_m_s2, 3)
    accel += sensor_noise(rng, len(rate), RATE_HZ, TriadNoise(density=QUIET_M_S2_RTHZ))

    matrix = np.eye(3) + rng.normal(0.0, a.gyro_matrix_sigma, (3, 3))
    turning = np.linalg.norm(rate, axis=1)
    density = np.hypot(fusion.gyro_noise_rad_s_rthz, fusion.gyro_scale_error_rts * turning)
    noise = density[:, None] * rng.normal(0.0, math.sqrt(RATE_HZ), rate.shape)
    # As fusion.propagation knows shake: half the square of a step, over the axes.
    steps2 = 0.5 * (np.diff(accel, axis=0, prepend=accel[:1]) ** 2).sum(axis=1)
    walk = np.hypot(fusion.gyro_bias_walk_rad_s2_rthz, a.shaken_bias_walk_s_m_rts * np.sqrt(steps2))
    bias = np.cumsum(walk[:, None] * rng.normal(0.0, RATE_HZ**-0.5, rate.shape), axis=0)
    bias += rng.normal(0.0, fusion.gyro_bias_sigma_rad_s, 3)
    return rate @ matrix.T + bias + noise, accel
