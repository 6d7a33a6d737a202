"""Hidden effects of temperature, time since power-on, vibration and current."""

import itertools
from typing import Any, Final

import numpy as np

from ahrs_service.blind.making.physics import (
    REFERENCE_DEGC,
    Draw,
    Hidden,
    Scene,
    Signals,
    axes,
    linear,
    on,
)
from ahrs_service.blind.making.surroundings import POWER_ON_S, lag
from ahrs_service.records import Floats

_NOMINAL: Final = {"gyro": 1.0, "accel": 30.0}
"""A thermal coefficient of the accelerometer [m/s^2] for one of the gyro [rad/s]."""

PLAYS: Final = (0.25, 0.5, 1.0)
"""Half widths of the play operators, as shares of the widest."""
_PLAY_WEIGHTS: Final = (0.25, 0.35, 0.4)  # A choice: they sum to one


def above(scene: Scene) -> Floats:
    """Sensor temperature minus the reference temperature [N, 1] [K]."""
    return (scene.around.imu_degc - REFERENCE_DEGC)[:, None]


def thermal_bias(sensor: str) -> Draw:
    """k1 (T - T0) + k2 (T - T0)^2."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        slope = axes(rng, 1.5e-4 * _NOMINAL[sensor])
        bend = axes(rng, 1.5e-6 * _NOMINAL[sensor])

        def signals(scene: Scene, size: float) -> Signals:
            t = above(scene)
            return on(sensor, size * t * (slope + bend * t))

        def params(size: float) -> dict[str, Any]:
            return {
                "linear": (size * slope).tolist(),
                "quadratic": (size * bend).tolist(),
                "reference_degC": REFERENCE_DEGC,
            }

        return Hidden(f"{sensor}_thermal_bias", signals, params)

    return draw


def thermal_scale(sensor: str) -> Draw:
    """K (T - T0) u."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        k = axes(rng, 2e-4)

        def signals(scene: Scene, size: float) -> Signals:
            return on(sensor, size * k * above(scene) * scene.reading(sensor))

        def params(size: float) -> dict[str, Any]:
            return {"per_degC": (size * k).tolist(), "reference_degC": REFERENCE_DEGC}

        return Hidden(f"{sensor}_thermal_scale", signals, params)

    return draw


def thermal_lag(sensor: str) -> Draw:
    """K (Td - T0) with the differential equation tau dTd/dt = T - Td."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        k, tau = axes(rng, 6e-4 * _NOMINAL[sensor]), float(rng.uniform(30.0, 90.0))

        def signals(scene: Scene, size: float) -> Signals:
            own, step = scene.around.imu_degc, scene.time_s[1] - scene.time_s[0]
            lagged = lag(own, step, tau, own[0])
            return on(sensor, size * k * (lagged - REFERENCE_DEGC)[:, None])

        def params(size: float) -> dict[str, Any]:
            return {"time_constant_s": tau, "linear": (size * k).tolist()}

        bias = f"{sensor}_thermal_bias"
        return Hidden(f"{sensor}_thermal_lag", signals, params, implies=(bias,))

    return draw


def thermal_rate(sensor: str) -> Draw:
    """K dT/dt, with the slope of the temperature's own equation."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        return linear(
            f"{sensor}_thermal_rate",
            sensor,
            "per_degC_per_s",
            axes(rng, 0.01 * _NOMINAL[sensor]),
            lambda scene: scene.around.imu_degc_s[:, None],
        )

    return draw


def play(values: Floats, half_width: float) -> Floats:
    """Output [N] of a play operator (backlash): a pin that drags a slot of +-`half_width` along.

    Between two turning points of `values` the pin moves one way and the output is a running
    extreme: the result is exact piece by piece.
    """
    extremes = np.flatnonzero(np.diff(np.sign(np.diff(values))) != 0) + 1
    bounds = np.concatenate([[0], extremes, [len(values) - 1]])
    dragged = np.empty_like(values)
    dragged[0] = held = values[0]
    for start, stop in itertools.pairwise(bounds):
        piece = values[start : stop + 1]
        dragged[start : stop + 1] = np.clip(held, piece - half_width, piece + half_width)
        held = dragged[stop]
    return dragged


def hysteresis_state(own: Floats, half_width: float) -> Floats:
    """Weighted plays [N], -1 on the cooling branch and 1 on the warming one."""
    shares = (half_width * share for share in PLAYS)
    parts = ((own - play(own, width)) / width for width in shares)
    return np.asarray(sum(w * p for w, p in zip(_PLAY_WEIGHTS, parts, strict=True)), np.float64)


def thermal_hysteresis(sensor: str) -> Draw:
    """Half amplitude times a Prandtl-Ishlinskii state of three plays."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        half, width = axes(rng, 8e-4 * _NOMINAL[sensor]), float(rng.uniform(3.0, 8.0))

        def signals(scene: Scene, size: float) -> Signals:
            state = hysteresis_state(scene.around.imu_degc, width)
            return on(sensor, size * half * state[:, None])

        def params(size: float) -> dict[str, Any]:
            form = "Prandtl-Ishlinskii, three plays"
            return {"half_amplitude": (size * half).tolist(), "width_degC": width, "form": form}

        return Hidden(f"{sensor}_thermal_hysteresis", signals, params)

    return draw


def warm_up(sensor: str) -> Draw:
    """A exp(-t / tau) since power-on."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        a, tau = axes(rng, 2e-3 * _NOMINAL[sensor]), float(rng.uniform(20.0, 120.0))

        def signals(scene: Scene, size: float) -> Signals:
            since = scene.time_s + POWER_ON_S
            return on(sensor, size * a * np.exp(-since / tau)[:, None])

        def params(size: float) -> dict[str, Any]:
            return {"amplitude": (size * a).tolist(), "time_constant_s": tau}

        return Hidden(f"{sensor}_warm_up", signals, params)

    return draw


def vibration_rectification(sensor: str) -> Draw:
    """K A^2, with A the vibration's amplitude."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        return linear(
            f"{sensor}_vibration_rectification",
            sensor,
            "per_vibration_variance",
            axes(rng, 0.1 * _NOMINAL[sensor] / 30.0),
            lambda scene: scene.around.vibration_m_s2[:, None] ** 2,
        )

    return draw


def current_coupling(sensor: str) -> Draw:
    """K (I - I0), with I0 the current of the board alone."""

    def draw(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
        return linear(
            f"{sensor}_current_coupling",
            sensor,
            "per_ampere",
            axes(rng, 2e-4 * _NOMINAL[sensor]),
            lambda scene: (scene.around.current_a - 0.6)[:, None],
        )

    return draw
