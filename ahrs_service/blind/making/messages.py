"""A case as the columns of the messages that a vehicle logs."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ahrs_service.blind.making.case import Case
from ahrs_service.blind.making.recording_noise import SHAKE_AXES
from ahrs_service.blind.making.surroundings import POWER_ON_S
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats, Integers
from ahrs_service.rotation import euler_columns, multiply_columns

BOOT_US: Final = int(POWER_ON_S * 1e6)
"""Time since boot of the first sample [us]."""

_REFERENCE_HZ: Final = 50
"""A choice: rate of a good reference [Hz]; noise.py assumes the same."""
_HIGHRES_FIELDS: Final = 0b1000000111111
"""HIGHRES_IMU.fields_updated: accelerations, rates, temperature."""
_PLANE, _COPTER, _ARDUPILOT, _ACTIVE = 1, 2, 3, 4
_REPORT_SPREAD: Final = 0.04
"""Relative sigma of a VIBRATION message about the true level."""


@dataclass(frozen=True, slots=True)
class Table:
    """Messages of one name: times since boot [us] [M] and fields [M] or [M, k]."""

    name: str
    time_us: Integers
    fields: dict[str, Any]


def tables(case: Case) -> list[Table]:
    """Return the messages of a case, one table per name, in the order of sending."""
    rng = np.random.default_rng((case.request.seed, 1))
    return [
        _highres(case),
        *_reference(case, rng),
        *_slow(case, rng),
    ]


def _times_us(case: Case, rate_hz: int) -> tuple[Integers, slice]:
    """Timestamps of a message at a rate, and the slice of sensor samples at those instants."""
    step = case.truth["imu_rate_hz"] // rate_hz if rate_hz else 1
    every = slice(None, None, step)
    stamps = BOOT_US + np.round(case.scene.time_s[every] * 1e6).astype(np.int64)
    return stamps, every


def _highres(case: Case) -> Table:
    time_us, _ = _times_us(case, case.truth["imu_rate_hz"])
    fields: dict[str, Any] = {"time_usec": time_us, "abs_pressure": 1013.25}
    for n, axis in enumerate("xyz"):
        fields[f"{axis}acc"] = case.accel_m_s2[:, n]
        fields[f"{axis}gyro"] = case.gyro_rad_s[:, n]
    fields["temperature"] = np.trunc(case.reported.baro_degc * 100.0) / 100.0
    fields["fields_updated"] = _HIGHRES_FIELDS
    return Table("HIGHRES_IMU", time_us, fields)


def _reference(case: Case, rng: np.random.Generator) -> list[Table]:
    """ATTITUDE_QUATERNION, LOCAL_POSITION_NED and ATTITUDE with the reference's own error."""
    time_us, every = _times_us(case, _REFERENCE_HZ)
    scene, error = case.scene, case.law.reference
    motion, is_bench = scene.motion, case.request.kind == "bench"
    if case.request.null == "jittered reference":
        late = rng.normal(0.0, 2e-3, len(time_us)).clip(-6e-3, 6e-3)
        motion, every = scene.path.at((time_us - BOOT_US) * 1e-6 + late), slice(None)
    count, step = len(time_us), 1.0 / _REFERENCE_HZ
    tilt = error.attitude.draw(rng, count, step)
    tilt += rng.normal(0.0, error.attitude_white_rad, (count, 3))
    velocity = motion.velocity_ned_m_s[every] + error.velocity.draw(rng, count, step)
    velocity += rng.normal(0.0, error.velocity_white_m_s, (count, 3))
    if case.request.null == "reference glitches":
        _glitch(rng, tilt, velocity)
    if is_bench:
        velocity[:] = 0.0
    half = 0.5 * tilt
    wrong = np.concatenate([np.sqrt(1.0 - np.sum(half**2, axis=1, keepdims=True)), half], axis=1)
    attitude = multiply_columns(motion.ned_from_body[every], wrong)
    place = np.cumsum(velocity, axis=0) * step
    # In flight the autopilot's rates come from this same gyro, less its turn-on bias.
    own_every = _times_us(case, _REFERENCE_HZ)[1]
    own = case.gyro_rad_s[own_every] - case.law.gyro_bias
    rate = motion.rate_rad_s[every] if is_bench else own
    milliseconds = time_us // 1000
    rates = dict(zip(("rollspeed", "pitchspeed", "yawspeed"), rate.T, strict=True))
    quaternion = dict(zip(("q1", "q2", "q3", "q4"), attitude.T, strict=True))
    local = dict(zip(("x", "y", "z"), place.T, strict=True))
    local |= dict(zip(("vx", "vy", "vz"), velocity.T, strict=True))
    slow = slice(None, None, 5)
    euler = euler_columns(attitude[slow])
    angles = dict(zip(("roll", "pitch", "yaw"), euler.T, strict=True))
    slow_rates = {name: values[slow] for name, values in rates.items()}
    boot = {"time_boot_ms": milliseconds}
    return [
        Table("ATTITUDE_QUATERNION", time_us, boot | quaternion | rates),
        Table("LOCAL_POSITION_NED", time_us, boot | local),
        Table(
            "ATTITUDE",
            time_us[slow],
            {"time_boot_ms": milliseconds[slow]} | angles | slow_rates,
        ),
    ]


def _glitch(rng: np.random.Generator, tilt_rad: Floats, velocity_m_s: Floats) -> None:
    """Offset the reference by some 2 deg and 0.8 m/s three to five times, for about a second."""
    for _ in range(rng.integers(3, 6)):
        start = rng.integers(len(tilt_rad) // 10, len(tilt_rad) - 200)
        here = slice(start, start + rng.integers(20, 100))
        tilt_rad[here] += rng.normal(0.0, np.radians(1.5), 3)
        velocity_m_s[here] += rng.normal(0.0, 0.6, 3)


def _slow(case: Case, rng: np.random.Generator) -> list[Table]:
    """The messages at 10 Hz and less."""
    around, request = case.reported, case.request
    time_us, every = _times_us(case, 10)
    count = len(time_us)
    speed = np.linalg.norm(case.scene.motion.velocity_ned_m_s[every, :2], axis=1)
    reports = around.vibration_m_s2[every, None] * SHAKE_AXES
    reports = reports * (1.0 + rng.normal(0.0, _REPORT_SPREAD, (count, 3)))
    milli_g = 1000.0 / STANDARD_GRAVITY_M_S2
    scaled: dict[str, Any] = {"time_boot_ms": time_us // 1000}
    for n, axis in enumerate("xyz"):
        scaled[f"{axis}acc"] = _whole(case.accel_m_s2[every, n] * milli_g)
        scaled[f"{axis}gyro"] = _whole(case.gyro_rad_s[every, n] * 1000.0)
    scaled["temperature"] = _whole(around.imu_degc[every] * 100.0)
    half_us, rare = _times_us(case, 2)
    volts = np.full((len(half_us), 10), 65535)
    volts[:, 0] = np.round(around.voltage_v[rare] * 1000.0)
    seconds_us, _ = _times_us(case, 1)
    vibration = dict(zip((f"vibration_{a}" for a in "xyz"), reports.T, strict=True))
    return [
        Table(
            "VFR_HUD",
            time_us,
            {
                "airspeed": around.airspeed_m_s[every] + rng.normal(0.0, 0.2, count),
                "groundspeed": speed,
                "throttle": _whole(around.throttle[every] * 100.0),
            },
        ),
        Table("SCALED_IMU", time_us, scaled),
        Table(
            "BATTERY_STATUS",
            half_us,
            {
                "battery_function": 1,
                "type": 3,
                "temperature": 32767,
                "voltages": volts,
                "current_battery": _whole(around.current_a[rare] * 100.0),
                "energy_consumed": -1,
                "battery_remaining": 80,
            },
        ),
        Table(
            "SCALED_PRESSURE",
            half_us,
            {
                "time_boot_ms": half_us // 1000,
                "press_abs": 1013.25,
                "temperature": _whole(around.baro_degc[rare] * 100.0),
            },
        ),
        Table(
            "HEARTBEAT",
            seconds_us,
            {
                "type": _COPTER if request.kind == "copter" else _PLANE,
                "autopilot": _ARDUPILOT,
                "base_mode": 81,
                "system_status": _ACTIVE,
                "mavlink_version": 3,
            },
        ),
        Table("VIBRATION", time_us, {"time_usec": time_us} | vibration),
    ]


def _whole(values: Floats) -> Integers:
    """Truncate to integers, toward zero, as the autopilot's casts do."""
    return np.trunc(values).astype(np.int64)
