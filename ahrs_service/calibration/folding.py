"""From physical effects to the calibration that takes them away live.

A sensor of calibration (K + dK, B, c, G) with effects on its ideal reading u gives

    N - E_T = (K + dK(T)) (u + D u + D_T(T) u + beta(T) + Gamma f) + B + c(T) + G f

which is a sensor of another calibration: matrix (K + dK)(I + D + D_T), bias c + (K + dK) beta,
g-sensitivity G + K Gamma. So what diagnosis accepted is compensated by the estimator's own step,
with no second place for physics: each effect defines its own form in a calibration
(`Effect.in_calibration`), here it is only summed. The accelerometer's k f^2 becomes the drift's a,
to first order in k. What does not have this form is left, each with its reason.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from ahrs_service.effects.base import Contribution, Effect, OfTemperature, Values
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Calibration, Matrix, TriadCalibration, Vector

Part = tuple[Effect, Contribution]

SPAN_DEGC: Final = (-40.0, 85.0)
"""Where the curves of a calibration that had none hold: the sensors' own range."""

_ONE_LAG: Final = "a triad has one lag, and another thermal effect of it has none"


@dataclass(frozen=True, slots=True)
class Folded:
    """A calibration that compensates the effects `taken`; `left` are (id, why it is not)."""

    calibration: Calibration
    taken: tuple[str, ...]
    left: tuple[tuple[str, str], ...]


def fold(calibration: Calibration, effects: Iterable[tuple[Effect, Values]]) -> Folded:
    """Return the calibration of a sensor of `calibration` that has `effects` as well."""
    taken: list[Part] = []
    left: list[tuple[str, str]] = []
    known = [(effect, effect.in_calibration(values)) for effect, values in effects]
    for effect, contribution in known:
        if contribution is None:
            left.append((effect.id, effect.not_live))
        elif contribution.lag_s is not None and _has_rival(effect, calibration, known):
            left.append((effect.id, _ONE_LAG))
        else:
            taken.append((effect, contribution))
    room = calibration.room_degc
    folded = replace(
        calibration,
        gyro=_fold_triad("gyro", calibration.gyro, taken, room),
        accel=_fold_triad("accel", calibration.accel, taken, room),
    )
    return Folded(folded, tuple(effect.id for effect, _ in taken), tuple(left))


def _has_rival(
    effect: Effect, calibration: Calibration, known: list[tuple[Effect, Contribution | None]]
) -> bool:
    """Whether another thermal model applies to a triad of an effect."""
    for triad in ("gyro", "accel"):
        if effect.acts_on(triad):
            own: TriadCalibration = getattr(calibration, triad)
            others = [c for other, c in known if other.acts_on(triad) and other != effect]
            if own.span_degc or any(c is not None and c.follows_temperature for c in others):
                return True
    return False


@dataclass(slots=True)
class _Sum:
    """What all effects on one triad come to: D, D_T, beta, Gamma, k, and the lag."""

    linear: Floats
    scale: list[OfTemperature]
    bias: list[OfTemperature]
    g_sensitivity: Floats
    quadratic: Floats
    lag_s: float = 0.0


def _sum(triad: str, parts: list[Part]) -> _Sum:
    total = _Sum(np.zeros((3, 3)), [], [], np.zeros((3, 3)), np.zeros(3))
    for effect, part in parts:
        if not effect.acts_on(triad):
            continue
        if part.linear is not None:
            total.linear += part.linear
        if part.g_sensitivity is not None:
            total.g_sensitivity += part.g_sensitivity
        if part.quadratic is not None:
            total.quadratic += part.quadratic
        total.scale += [] if part.scale is None else [part.scale]
        total.bias += [] if part.bias is None else [part.bias]
        total.lag_s += part.lag_s or 0.0
    return total


def _fold_triad(
    name: str, triad: TriadCalibration, parts: list[Part], room_degc: float
) -> TriadCalibration:
    total = _sum(name, parts)
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
    thermal: dict[str, Any] = {}
    if total.scale or triad.matrix_drift.pieces:
        thermal["matrix_drift"] = Curve.through(
            breaks, lambda t: (matrix_at(t) - at_room).reshape(len(t), 9)
        )
    if total.bias:
        thermal["c"] = Curve.through(breaks, lambda t: bias_at(t) - bias)
    else:
        bias = np.zeros(3)
    if total.quadratic.any():
        own = triad.a if triad.a.pieces else Curve.steps(breaks[[0, -1]], np.zeros((1, 3)))
        thermal["a"] = own.plus(total.quadratic)
    return replace(
        triad,
        matrix=_matrix(at_room),
        bias=_vector(np.array(triad.bias) + bias),
        g_sensitivity=_matrix(gamma),
        thermal_lag_s=triad.thermal_lag_s + total.lag_s,
        **thermal,
    )


def _vector(values: Floats) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def _matrix(values: Floats) -> Matrix:
    x, y, z = (_vector(row) for row in values)
    return x, y, z
