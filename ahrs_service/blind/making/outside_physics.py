"""Hidden effects that no catalogue entry describes: the answer is `unexplained`."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from ahrs_service.blind.making.motion_physics import place_acceleration
from ahrs_service.blind.making.physics import Draw, Hidden, Scene, Signals, axes, on
from ahrs_service.records import Floats
from ahrs_service.rotation import euler_columns


def _unknown(depends_on: str, sensor: str, law: str, signal: Callable[[Scene], Floats]) -> Hidden:
    def signals(scene: Scene, size: float) -> Signals:
        return on(sensor, size * signal(scene))

    def params(size: float) -> dict[str, Any]:
        return {"depends_on": depends_on, "sensor": sensor, "law": law, "size": size}

    return Hidden("unknown", signals, params)


def airspeed(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """Aerodynamic load on the case: k V^2 on the accelerometer."""
    k = axes(rng, 1e-3)
    return _unknown("airspeed", "accel", "k V^2", lambda s: k * s.around.airspeed_m_s[:, None] ** 2)


def attitude(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """A local field affects the gyro: k sin(2 yaw + phase)."""
    k, phase = axes(rng, 1e-3), float(rng.uniform(0.0, 2.0 * np.pi))

    def signal(s: Scene) -> Floats:
        yaw = euler_columns(s.motion.ned_from_body)[:, 2:]
        return k * np.sin(2.0 * yaw + phase)

    return _unknown("attitude", "gyro", "k sin(2 yaw + phase)", signal)


def supply(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """The sensor's bias follows its supply: k (U - U0)."""
    k = axes(rng, 5e-3)
    return _unknown(
        "voltage", "gyro", "k (U - U0)", lambda s: k * (s.around.voltage_v[:, None] - 11.8)
    )


def axis_size(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """The accelerometer's three axes are at three different positions (size effect)."""
    arms = rng.normal(0.0, 0.03, (3, 3))

    def signal(s: Scene) -> Floats:
        parts = [place_acceleration(s, arms[i])[:, i] for i in range(3)]
        return np.stack(parts, axis=1)

    return _unknown("rate", "accel", "each axis at its own place", signal)


def anisoelastic(rng: np.random.Generator, kind: str, scene: Scene) -> Hidden:
    """Anisoelastic gyro: its bias grows with the square of the specific force."""
    k = np.array([axes(rng, 2e-5) for _ in range(3)])
    return _unknown("acceleration", "gyro", "k f^2", lambda s: s.motion.force_m_s2**2 @ k.T)


OUTSIDE: Final[dict[str, tuple[Draw, tuple[str, ...]]]] = {
    "airspeed": (airspeed, ("flight",)),
    "attitude": (attitude, ("flight", "copter")),
    "voltage": (supply, ("flight", "copter")),
    "rate": (axis_size, ("bench", "copter")),
    "acceleration": (anisoelastic, ("bench", "copter")),
}
"""What the effect depends on to (how to draw it, kinds of recording that excite it)."""
