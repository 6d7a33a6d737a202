"""The form of calibration that autopilots have, and the one of that form nearest to ours.

Of each axis of a sensor, in the sensor's own axes, both ArduPilot and PX4 compute

    compensated = (raw - bias(T)) scale        bias(T) = sum_k powers[k] (T - reference)^k, k <= 3

with T held within the calibrated span, and with scale 1 for gyros. Sources: ArduPilot
libraries/AP_InertialSensor/AP_InertialSensor_Backend.cpp (_rotate_and_correct_accel) and
AP_InertialSensor_tempcal.cpp (correct_sensor); PX4 src/lib/sensor_calibration/Accelerometer.hpp
(Correct) and src/modules/temperature_compensation/TemperatureCompensation.cpp
(calc_thermal_offsets_3D).
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, cast

import numpy as np
from numpy.polynomial import Legendre, Polynomial, legendre

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import POWERS, Curve
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.parameters import (
    Calibration,
    Matrix,
    TriadCalibration,
    coefficients,
)

Triad = Literal["gyro", "accel"]

FIT_RATE_RAD_S: Final = math.radians(100.0)
"""Rate at which a gyro's scale, cross-axis and g-sensitivity count in a stated loss."""
OUTSIDE_WEIGHT: Final = 0.01
"""Of temperatures at which the unit does not work: enough to keep the cubic in bounds there."""
STEPS: Final = 111
"""Temperatures over the span: every degree of -40..70 degC."""
_NIL: Final = 1e-11
"""What a power adds over the span below this is the rounding of the fit [unit]."""
_DIRECTIONS: Final = np.array(
    [d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)], np.float64
)
_UNIT: Final = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
"""Faces, edges and corners of a cube [26, 3]: all directions alike to the third moment."""
_FACES: Final = np.concatenate([np.eye(3), -np.eye(3)])
"""Directions up [6, 3] of a unit on each of its faces."""


@dataclass(frozen=True, slots=True)
class TriadForm:
    """An autopilot's calibration of three gyros or accelerometers, in the sensor's axes.

    `scale` [3]; `powers` [4, 3] [unit/degC^k] of T - `reference_degc`; `span_degc` within which T
    is held, None where temperature changes nothing.
    """

    scale: Floats
    powers: Floats
    reference_degc: float = 0.0
    span_degc: tuple[float, float] | None = None

    def bias(self, temperature_degc: Floats) -> Floats:
        """Return the bias [n, 3] [unit] at temperatures [n] [degC]."""
        if self.span_degc is None:
            return np.broadcast_to(self.powers[0], (len(temperature_degc), 3))
        inside = np.clip(temperature_degc, *self.span_degc)
        values: Floats = np.vander(inside - self.reference_degc, POWERS, True) @ self.powers
        return values

    def compensate(self, raw: Floats, temperature_degc: Floats) -> Floats:
        """Return rate or force [n, 3] in the sensor's axes of its output [n, 3]."""
        return (raw - self.bias(temperature_degc)) * self.scale

    def respond(self, value: Floats, temperature_degc: Floats) -> Floats:
        """Return the output [n, 3] that is compensated to `value` [n, 3]."""
        return value / self.scale + self.bias(temperature_degc)


@dataclass(frozen=True, slots=True)
class Bench:
    """Inputs in all directions at temperatures over a span, and our sensor's output to them.

    Of `triad`, in the sensor's axes: `value` [n, 3] the input, `raw` [n, 3] the output,
    `temperature_degc` [n]; `force` [n, 3] [m/s^2] in body axes.
    """

    triad: Triad
    body_from_sensor: Floats
    span_degc: tuple[float, float] | None
    temperature_degc: Floats
    value: Floats
    raw: Floats
    force: Floats

    @property
    def size(self) -> float:
        """Norm of every input [unit]."""
        return STANDARD_GRAVITY_M_S2 if self.triad == "accel" else FIT_RATE_RAD_S


def bench(
    calibration: Calibration,
    triad: Triad,
    body_from_sensor: Floats,
    below: TriadForm | None = None,
    span: tuple[float, float] | None = None,
) -> Bench:
    """Return the outputs over `span` [degC] of the sensor that `calibration` (body axes) describes.

    `below` is an autopilot's calibration that had worked on the output before `calibration` was
    made from it; `raw` is then that from before it, so that a form fitted replaces both.
    """
    t = np.array([calibration.room_degc]) if span is None else np.linspace(*span, STEPS)
    if triad == "accel":
        value = force = STANDARD_GRAVITY_M_S2 * _UNIT
    else:
        value = np.repeat(FIT_RATE_RAD_S * _UNIT, len(_FACES), axis=0)
        force = np.tile(STANDARD_GRAVITY_M_S2 * _FACES, (len(_UNIT), 1))
    temperature = np.repeat(t, len(value))
    value, force = np.tile(value, (len(t), 1)), np.tile(force, (len(t), 1))
    rate = value if triad == "gyro" else np.zeros_like(value)
    outputs = forward_columns(coefficients(calibration), rate, force, temperature)
    raw = outputs[0 if triad == "gyro" else 1] @ body_from_sensor
    if below is not None:
        raw = below.respond(raw, temperature)
    return Bench(triad, body_from_sensor, span, temperature, value @ body_from_sensor, raw, force)


def joint_span(*spans: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return the temperatures that all spans given have in common; ValueError if none."""
    known = [span for span in spans if span is not None]
    if not known:
        return None
    low, high = max(span[0] for span in known), min(span[1] for span in known)
    if not low < high:
        raise InvalidValueError(
            f"the calibrated spans {known} degC have nothing in common: calibrate both triads "
            "over the same temperatures"
        )
    return low, high


def fit(
    made: Bench, reference_degc: float, works_at: tuple[float, float] | None = None
) -> TriadForm:
    """Return the form that explains the outputs best.

    Least squares over all inputs and temperatures: per axis raw = value / scale + bias(T), the
    cubic taken in Legendre's polynomials over the span; scale 1 for gyros. Every temperature of
    the span weighs alike, but those outside `works_at` [degC], where it is given, a hundredth.
    """
    t = made.temperature_degc
    is_outside = False if works_at is None else (t < works_at[0]) | (t > works_at[1])
    w: Floats = np.where(np.broadcast_to(is_outside, t.shape), math.sqrt(OUTSIDE_WEIGHT), 1.0)
    low, high = made.span_degc or (reference_degc, reference_degc + 1.0)
    x = (2.0 * made.temperature_degc - low - high) / (high - low)
    columns = legendre.legvander(x, POWERS - 1 if made.span_degc else 0)
    domain = (low - reference_degc, high - reference_degc)
    scale, powers = np.ones(3), np.zeros((POWERS, 3))
    for axis in range(3):
        value, raw = made.value[:, axis], made.raw[:, axis]
        if made.triad == "accel":
            design = np.column_stack([columns, value])
            *series, inverse = _solved(design * w[:, None], raw * w)
            scale[axis] = 1.0 / inverse
        else:
            series = _solved(columns * w[:, None], (raw - value) * w)
        power = Legendre(series, domain).convert(kind=Polynomial, domain=(-1, 1)).coef
        powers[: len(power), axis] = power
    form = TriadForm(scale, powers, reference_degc, made.span_degc)
    return _without_rounding(form)


def _solved(design: Floats, target: Floats) -> list[float]:
    """Return the least squares solution, refined once.

    Far from the reference small errors grow: 2000 times over 11 degC that lie 65 degC below it.
    """
    first = np.linalg.lstsq(design, target, rcond=None)[0]
    second = np.linalg.lstsq(design, target - design @ first, rcond=None)[0]
    solution: list[float] = (first + second).tolist()
    return solution


def _without_rounding(form: TriadForm) -> TriadForm:
    reach = max((abs(t - form.reference_degc) for t in form.span_degc or ()), default=0.0)
    effect = np.abs(form.powers) * (reach ** np.arange(POWERS))[:, None]
    powers = np.where(effect < _NIL, 0.0, form.powers)
    return TriadForm(form.scale, powers, form.reference_degc, form.span_degc)


def says_nothing(calibration: Calibration, triad: Triad, below: Mapping[Triad, TriadForm]) -> bool:
    """Return whether an autopilot's own figures of a triad should stay as they are.

    So where the calibration has none, and no drift that it was made on top of must be kept.
    """
    under = below.get(triad)
    is_nil = bool(getattr(calibration, triad) == TriadCalibration())
    return is_nil and (under is None or under.span_degc is None)


def as_calibration(
    forms: Mapping[Triad, TriadForm], body_from_sensor: Floats, room_degc: float
) -> Calibration:
    """Return our calibration, in body axes, that compensates exactly as the forms of both triads.

    The bias at `room_degc` is B, what temperature adds to it c(T); K is diagonal in the
    sensor's axes.
    """
    gyro, accel = (
        _triad_calibration(forms[triad], body_from_sensor, room_degc) for triad in ("gyro", "accel")
    )
    return Calibration(gyro=gyro, accel=accel, room_degc=room_degc)


def _triad_calibration(
    form: TriadForm, body_from_sensor: Floats, room_degc: float
) -> TriadCalibration:
    matrix = body_from_sensor @ np.diag(1.0 / form.scale) @ body_from_sensor.T
    bias = body_from_sensor @ form.bias(np.array([room_degc]))[0]
    curve = Curve()
    if form.span_degc is not None:
        low, high = form.span_degc
        moved = np.column_stack(
            [_moved(form.powers[:, axis], low - form.reference_degc) for axis in range(3)]
        )
        in_body = (moved @ body_from_sensor.T)[::-1, None, :]
        curve = Curve.from_ppoly((low, high), in_body).plus(-bias)
    return TriadCalibration(
        matrix=cast(Matrix, tuple(map(tuple, matrix.tolist()))),
        bias=tuple(bias.tolist()),
        c=curve,
        model="" if form.span_degc is None else "cubic",
    )


def _moved(powers: Floats, step: float) -> Floats:
    """Return the coefficients of p(x + step) for those of p(x), lowest power first."""
    moved = np.zeros(POWERS)
    for k, power in enumerate(powers):
        for j in range(k + 1):
            moved[j] += math.comb(k, j) * power * step ** (k - j)
    return moved
