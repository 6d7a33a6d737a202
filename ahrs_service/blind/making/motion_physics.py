"""Hidden effects of motion: scale, axes, timing, filters, lever arms."""

from typing import Any, Final

import numpy as np
from scipy.signal import cont2discrete, lfilter

from ahrs_service.blind.making.physics import Draw, Hidden, Scene, Signals, axes, linear, on
from ahrs_service.records import Floats
from ahrs_service.rotation import inverse_columns, rotate_columns

EARTH_RATE_RAD_S: Final = 7.292115e-5
"""Rotation of the Earth against the stars (IERS conventions 2010, table 1.2) [rad/s]."""

_ARM_STEP_S: Final = 1e-3
"""Step of the second difference [s]: its relative error is (rate * step)^2 / 12."""


def scale_factor(sensor: str) -> Draw:
    """K u."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        name = f"{sensor}_scale_factor"
        basis = scene_reading(sensor)
        return linear(name, sensor, "scale_error", axes(rng, 0.008), basis)

    return draw


def scene_reading(sensor: str) -> Any:
    """Return the basis that is the sensor's ideal reading."""
    return lambda scene: scene.reading(sensor)


def scale_nonlinearity(sensor: str) -> Draw:
    """Gyro k w |w|, accelerometer k f^2."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        def basis(scene: Scene) -> Floats:
            u = scene.reading(sensor)
            return np.sign(u) * u**2 if sensor == "gyro" else u**2

        name = f"{sensor}_scale_nonlinearity"
        return linear(name, sensor, "k", axes(rng, 0.006 if sensor == "gyro" else 6e-4), basis)

    return draw


def misalignment(sensor: str) -> Draw:
    """Off-diagonal M u."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        m = np.array([axes(rng, 0.006) for _ in range(3)]) * (1.0 - np.eye(3))

        def signals(scene: Scene, size: float) -> Signals:
            return on(sensor, size * scene.reading(sensor) @ m.T)

        def params(size: float) -> dict[str, Any]:
            return {"off_diagonal": (size * m).tolist()}

        return Hidden(f"{sensor}_misalignment", signals, params)

    return draw


def mounting_rotation(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """Both triads rotated: the reading is exactly R(v) u."""
    rotation = axes(rng, 0.008)

    def signals(scene: Scene, size: float) -> Signals:
        half = 0.5 * size * rotation
        angle = float(np.linalg.norm(half))
        q = np.concatenate([[np.cos(angle)], np.sinc(angle / np.pi) * half])[None]
        w, f = scene.motion.rate_rad_s, scene.motion.force_m_s2
        return rotate_columns(q, w) - w, rotate_columns(q, f) - f

    def params(size: float) -> dict[str, Any]:
        return {"rotvec_rad": (size * rotation).tolist(), "meaning": "reading = R(rotvec) u"}

    return Hidden("imu_mounting_rotation", signals, params)


def _resampled(scene: Scene, taken_s: Floats) -> Signals:
    """Return what is added by sampling at other times: the motion is evaluated there."""
    taken, stamped = scene.path.at(taken_s), scene.motion
    return (taken.rate_rad_s - stamped.rate_rad_s, taken.force_m_s2 - stamped.force_m_s2)


def time_offset(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """The sample stamped t was taken at t - offset."""
    offset = float(rng.uniform(6e-3, 12e-3) * rng.choice((-1.0, 1.0), p=(0.3, 0.7)))
    return Hidden(
        "imu_time_offset",
        lambda scene, size: _resampled(scene, scene.time_s - size * offset),
        lambda size: {
            "offset_s": size * offset,
            "meaning": "sample stamped t was taken at t - offset",
        },
    )


def clock_drift(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """The sample stamped t was taken at t (1 - ppm 1e-6), t since the recording's start."""
    ppm = float(rng.uniform(50.0, 120.0) * rng.choice((-1.0, 1.0)))
    return Hidden(
        "imu_clock_drift",
        lambda scene, size: _resampled(scene, scene.time_s * (1.0 - 1e-6 * size * ppm)),
        lambda size: {"ppm": size * ppm, "meaning": "stamped t was taken at t - ppm 1e-6 t"},
    )


def low_pass(sensor: str) -> Draw:
    """Second-order Butterworth filter, discretised exactly for inputs linear between samples."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        cutoff = float(np.exp(rng.uniform(np.log(8.0), np.log(60.0))))

        def signals(scene: Scene, size: float) -> Signals:
            sharp = scene.reading(sensor) + scene.shake[sensor == "accel"]
            step = scene.time_s[1] - scene.time_s[0]
            return on(sensor, filtered(sharp, cutoff, step) - sharp)

        params = {"cutoff_hz": cutoff, "order": 2}
        return Hidden(f"{sensor}_low_pass", signals, lambda size: params, is_fixed=True)

    return draw


def filtered(values: Floats, cutoff_hz: float, step_s: float) -> Floats:
    """Response [N, 3] of y'' + sqrt(2) w y' + w^2 y = w^2 u, from rest at the first value."""
    w = 2.0 * np.pi * cutoff_hz
    system = ([w**2], [1.0, np.sqrt(2.0) * w, w**2])
    b, a, _ = cont2discrete(system, step_s, method="foh")
    return np.asarray(values[0] + lfilter(b[0], a, values - values[0], axis=0), np.float64)


def saturation(sensor: str) -> Draw:
    """Clipped at the limit, on every axis, vibration included."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        def limit(scene: Scene, size: float) -> float:
            full = np.abs(scene.reading(sensor) + scene.shake[sensor == "accel"])
            return float(full.max() * np.exp(-0.2 * size))

        def signals(scene: Scene, size: float) -> Signals:
            full = scene.reading(sensor) + scene.shake[sensor == "accel"]
            bound = limit(scene, size)
            return on(sensor, np.clip(full, -bound, bound) - full)

        return Hidden(
            f"{sensor}_saturation",
            signals,
            lambda size: {"limit": limit(scene, size)},
            clipped=sensor,
        )

    return draw


def g_sensitivity(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """G f: 0.1 deg/s/g is 1.8e-4 rad/s per m/s^2."""
    g = np.array([axes(rng, 2.2e-4) for _ in range(3)])
    return Hidden(
        "gyro_g_sensitivity",
        lambda scene, size: on("gyro", size * scene.motion.force_m_s2 @ g.T),
        lambda size: {"matrix_rad_s_per_m_s2": (size * g).tolist()},
    )


def place_acceleration(scene: Scene, arm_m: Floats) -> Floats:
    """Acceleration [N, 3] (body axes) of a point at the arm, by the second difference of R r."""

    def place(shift_s: float) -> Floats:
        attitude = scene.path.at(scene.time_s + shift_s).ned_from_body
        return rotate_columns(attitude, np.broadcast_to(arm_m, (len(attitude), 3)))

    second = place(_ARM_STEP_S) - 2.0 * place(0.0) + place(-_ARM_STEP_S)
    body = inverse_columns(scene.motion.ned_from_body)
    return rotate_columns(body, second / _ARM_STEP_S**2)


def lever_arm(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """The accelerometer is not at the reference point."""
    arm = axes(rng, 0.06)
    return Hidden(
        "accel_lever_arm",
        lambda scene, size: on("accel", place_acceleration(scene, size * arm)),
        lambda size: {"arm_m": (size * arm).tolist()},
    )


def earth_rate(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """The gyro also measures the Earth's rotation, with which the reference's axes rotate."""
    latitude = float(rng.uniform(-70.0, 70.0))
    rate = EARTH_RATE_RAD_S * np.array(
        [np.cos(np.radians(latitude)), 0.0, -np.sin(np.radians(latitude))]
    )

    def signals(scene: Scene, size: float) -> Signals:
        body = inverse_columns(scene.motion.ned_from_body)
        return on("gyro", rotate_columns(body, np.broadcast_to(rate, (len(body), 3))))

    return Hidden(
        "gyro_earth_rate", signals, lambda size: {"latitude_deg": latitude}, is_fixed=True
    )
