"""From physical effects to the calibration that takes them away live.

A sensor of calibration (K + dK, B, c, G) on whose ideal reading u effects act gives

    N - E_T = (K + dK(T)) (u + D u + D_T(T) u + beta(T) + Gamma f) + B + c(T) + G f

which is a sensor of another calibration: matrix (K + dK)(I + D + D_T), bias c + (K + dK) beta,
g-sensitivity G + K Gamma. So what diagnosis accepted is compensated by the estimator's own step,
with no second place for physics. The accelerometer's k f^2 becomes the drift's a, to first order in
k. What does not have this form is left, each with its reason.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from ahrs_service.effects.base import Effect, Values
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, Matrix, TriadCalibration, Vector

SPAN_DEGC: Final = (-40.0, 85.0)
"""Where the curves of a calibration that had none hold: the sensors' own range."""

NOT_LIVE: Final = MappingProxyType(
    {
        "time_offset": "the step takes stamps as they come; shift the stamps, or the timing of "
        "the link",
        "clock_drift": "the step takes stamps as they come; correct the clock of the sender",
        "low_pass": "what a filter took away comes back only with amplified noise; open the filter",
        "saturation": "what is cut off is lost; choose a larger range",
        "thermal_rate": "needs the slope of the temperature, which the calibration has not",
        "thermal_hysteresis": "needs the history of the temperature, which the calibration has not",
        "warm_up": "needs the time since power-on, which the calibration has not",
        "vibration_rectification": "needs the level of vibration, which samples do not carry; "
        "mount the sensor softer",
        "current_coupling": "needs the battery current, which samples do not carry",
        "lever_arm": "needs the angular acceleration, whose noise would be worse than the effect; "
        "it is in the budget of the gates (gate_budget.arm_m)",
        "earth_rate": "needs the attitude; to the filter it is a bias of the gyro",
    }
)
"""Effects by name that cannot be compensated live, and why."""

_ODD: Final = "k w |w| is odd in the rate, the calibration's quadratic term is even"
_ONE_LAG: Final = "a triad has one lag, and another thermal effect of it acts without"


@dataclass(frozen=True, slots=True)
class Folded:
    """A calibration that compensates the effects `taken`; `left` are (id, why it is not)."""

    calibration: Calibration
    taken: tuple[str, ...]
    left: tuple[tuple[str, str], ...]


def why_not_live(effect: Effect) -> str | None:
    """Return why an effect cannot be compensated live, None where it can."""
    if effect.id == "gyro_scale_nonlinearity":
        return _ODD
    return NOT_LIVE.get(effect.name)


def fold(calibration: Calibration, effects: Iterable[tuple[Effect, Values]]) -> Folded:
    """Return the calibration of a sensor of `calibration` on which `effects` act as well."""
    taken: list[tuple[Effect, Values]] = []
    left: list[tuple[str, str]] = []
    known = list(effects)
    ids = {effect.id for effect, _ in known}
    for effect, values in known:
        why = why_not_live(effect)
        if effect.name == "thermal_lag":
            triad: TriadCalibration = getattr(calibration, effect.triad)
            rivals = {f"{effect.triad}_thermal_bias", f"{effect.triad}_thermal_scale"}
            why = _ONE_LAG if triad.span_degc or rivals & ids else None
        if why is None:
            taken.append((effect, values))
        else:
            left.append((effect.id, why))
    room = calibration.room_degc
    folded = replace(
        calibration,
        gyro=_fold_triad("gyro", calibration.gyro, taken, room),
        accel=_fold_triad("accel", calibration.accel, taken, room),
    )
    return Folded(folded, tuple(effect.id for effect, _ in taken), tuple(left))


@dataclass(slots=True)
class _Sum:
    """What all effects on one triad come to: D, D_T, beta, Gamma, a, and the lag."""

    linear: Floats
    scale: list[Callable[[Floats], Floats]]
    bias: list[Callable[[Floats], Floats]]
    g_sensitivity: Floats
    quadratic: Floats
    lag_s: float = 0.0


def _sum(triad: str, effects: list[tuple[Effect, Values]]) -> _Sum:
    total = _Sum(np.zeros((3, 3)), [], [], np.zeros((3, 3)), np.zeros(3))
    for effect, values in effects:
        if effect.triad not in (triad, "imu"):
            continue
        if effect.name == "scale_factor":
            total.linear += np.diag(values["scale_error"])
        elif effect.name == "misalignment":
            total.linear += values["off_diagonal"] * (1.0 - np.eye(3))
        elif effect.name == "mounting_rotation":
            total.linear += Rotation.from_rotvec(values["rotvec_rad"]).as_matrix() - np.eye(3)
        elif effect.name == "g_sensitivity":
            total.g_sensitivity += values["matrix_rad_s_per_m_s2"]
        elif effect.name == "scale_nonlinearity":
            total.quadratic += values["k"]
        elif effect.name == "thermal_scale":
            total.scale.append(_polynomial(values["reference_degC"], values["per_degC"]))
        else:
            slope, bend = values["linear"], values.get("quadratic", np.zeros(3))
            total.bias.append(_polynomial(values["reference_degC"], slope, bend))
            total.lag_s += float(values.get("time_constant_s", 0.0))
    return total


def _polynomial(origin_degc: Floats, *powers: Floats) -> Callable[[Floats], Floats]:
    """Return T [m] -> sum of powers[k] (T - origin)^(k + 1) [m, 3]."""

    def at(temperature_degc: Floats) -> Floats:
        warm = (temperature_degc - origin_degc)[:, None]
        return sum((p * warm ** (k + 1) for k, p in enumerate(powers)), np.zeros((len(warm), 3)))

    return at


def _fold_triad(
    name: str, triad: TriadCalibration, effects: list[tuple[Effect, Values]], room_degc: float
) -> TriadCalibration:
    total = _sum(name, effects)
    gamma = np.array(triad.g_sensitivity) + np.array(triad.matrix) @ total.g_sensitivity
    breaks = triad.breaks_degc() if triad.span_degc else np.array(SPAN_DEGC)
    plain = np.eye(3) + total.linear

    def matrix_at(t: Floats) -> Floats:
        warm = sum((scale(t) for scale in total.scale), np.zeros((len(t), 3)))
        return triad.matrix_at(t) @ (plain + warm[:, :, None] * np.eye(3))

    def bias_at(t: Floats) -> Floats:
        own = triad.c.at(t) if triad.c.pieces else np.zeros((len(t), 3))
        felt = sum((drift(t) for drift in total.bias), np.zeros((len(t), 3)))
        return own + (triad.matrix_at(t) @ felt[:, :, None])[:, :, 0]

    room = np.array([room_degc])
    at_room, bias = matrix_at(room)[0], bias_at(room)[0]
    parts: dict[str, Any] = {}
    if total.scale or triad.matrix_drift.pieces:
        parts["matrix_drift"] = Curve.through(
            breaks, lambda t: (matrix_at(t) - at_room).reshape(len(t), 9)
        )
    if total.bias:
        parts["c"] = Curve.through(breaks, lambda t: bias_at(t) - bias)
    else:
        bias = np.zeros(3)
    if total.quadratic.any():
        own = triad.a if triad.a.pieces else Curve.steps(breaks[[0, -1]], np.zeros((1, 3)))
        parts["a"] = own.plus(total.quadratic)
    return replace(
        triad,
        matrix=_matrix(at_room),
        bias=_vector(np.array(triad.bias) + bias),
        g_sensitivity=_matrix(gamma),
        thermal_lag_s=triad.thermal_lag_s + total.lag_s,
        **parts,
    )


def _vector(values: Floats) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def _matrix(values: Floats) -> Matrix:
    x, y, z = (_vector(row) for row in values)
    return x, y, z
