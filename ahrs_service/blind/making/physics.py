"""Physics to hide in a recording, coded independently of the fitting.

An effect is drawn (its direction and nonlinear parameters) and then evaluated at a size: what it
adds to the readings. Size 1 is a data sheet's magnitude; the oracle scales it. The forms differ
from the fitting's: hysteresis is a Prandtl-Ishlinskii sum of play operators, lag an integrated
differential equation, a late sample the motion at another instant, a lever arm the second
difference of the sensor's position, a filter the exact discretisation of its equation.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ahrs_service.blind.making.motion import Motion, Path
from ahrs_service.blind.making.surroundings import Surroundings
from ahrs_service.records import Floats

Signals = tuple[Floats, Floats]
"""Additions to gyro [N, 3] [rad/s] and accelerometer [N, 3] [m/s^2]."""


@dataclass(frozen=True, slots=True)
class Scene:
    """All that an effect may depend on; `shake` is the vibration that was drawn."""

    kind: str
    rate_hz: int
    time_s: Floats
    path: Path
    motion: Motion
    around: Surroundings
    shake: Signals

    def reading(self, sensor: str) -> Floats:
        """Ideal reading [N, 3] of a sensor without vibration."""
        return self.motion.rate_rad_s if sensor == "gyro" else self.motion.force_m_s2


@dataclass(frozen=True, slots=True)
class Hidden:
    """One effect as drawn: `signals(scene, size)`, `params(size)` for the truth file."""

    effect: str
    signals: Callable[[Scene, float], Signals]
    params: Callable[[float], dict[str, Any]]
    implies: tuple[str, ...] = ()
    is_fixed: bool = False
    """Its size is given by nature: it cannot be scaled."""
    clipped: str | None = None
    """The sensor ("gyro", "accel") whose final reading is clipped at the parameter `limit`."""


Draw = Callable[[np.random.Generator, str, "Scene"], Hidden]

REFERENCE_DEGC: Final = 25.0
"""Temperature at which the thermal effects vanish [degC]."""


def axes(rng: np.random.Generator, nominal: float) -> Floats:
    """Draw three coefficients of about `nominal`, with any sign."""
    return nominal * rng.uniform(0.6, 1.2, 3) * rng.choice((-1.0, 1.0), 3)


def on(sensor: str, values: Floats) -> Signals:
    """`values` [N, 3] added to one sensor, zero to the other."""
    none = np.zeros_like(values)
    return (values, none) if sensor == "gyro" else (none, values)


def linear(
    effect: str, sensor: str, name: str, coefficients: Floats, basis: Callable[[Scene], Floats]
) -> Hidden:
    """Effect that is `coefficients` [3] times a basis [N, 3] or [N, 1]."""

    def signals(scene: Scene, size: float) -> Signals:
        return on(sensor, size * coefficients * basis(scene))

    return Hidden(effect, signals, lambda size: {name: (size * coefficients).tolist()})
