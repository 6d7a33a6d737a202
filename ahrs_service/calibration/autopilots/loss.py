"""What an autopilot's form of calibration loses against our model."""

import math
from dataclasses import dataclass

import numpy as np

from ahrs_service.calibration.autopilots.compensation_model import STEPS, Bench, TriadForm
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats
from ahrs_service.sensor.parameters import Calibration, TriadCalibration


@dataclass(frozen=True, slots=True)
class Loss:
    """By how much an autopilot's form differs from our model over the span; [3] per body axis.

    `unit` of all; `largest` and `rms` of all that differs, at every temperature and with inputs of
    `size` in all directions. Parts of it, the largest each: `bias` what the cubic does not follow,
    `scale` a scale factor that is not carried or changes with temperature, `cross` what other axes
    add, `force` what the specific force adds to a gyro.
    """

    unit: str
    size: float
    largest: Floats
    rms: Floats
    bias: Floats
    scale: Floats
    cross: Floats
    force: Floats


def loss(made: Bench, form: TriadForm) -> Loss:
    """Return what `form` loses against the model that `made` comes from, in body axes."""
    to_body = made.body_from_sensor.T
    difference = (form.compensate(made.raw, made.temperature_degc) - made.value) @ to_body
    count = len(np.unique(made.temperature_degc))
    error = difference.reshape(count, -1, 3)
    value = (made.value @ to_body).reshape(error.shape)
    linear = _slopes(error, value)
    diagonal = np.einsum("tii->ti", linear)
    cross = np.sqrt(np.maximum((linear**2).sum(axis=2) - diagonal**2, 0.0))
    force = np.zeros((count, 3))
    if made.triad == "gyro":
        slopes = _slopes(error, made.force.reshape(error.shape))
        force = STANDARD_GRAVITY_M_S2 * np.linalg.norm(slopes, axis=2)
    return Loss(
        "m/s^2" if made.triad == "accel" else "rad/s",
        made.size,
        largest=np.abs(difference).max(axis=0),
        rms=np.sqrt((difference**2).mean(axis=0)),
        bias=np.abs(error.mean(axis=1)).max(axis=0),
        scale=made.size * np.abs(diagonal).max(axis=0),
        cross=made.size * cross.max(axis=0),
        force=force.max(axis=0),
    )


def _slopes(error: Floats, value: Floats) -> Floats:
    """Return d error / d value [t, 3, 3] of errors and inputs [t, n, 3] in all directions."""
    products = np.einsum("tni,tnj->tij", error, value)
    squares: Floats = (value**2).sum(axis=(1, 2)) / 3.0
    return products / squares[:, None, None]


def lag_remarks(calibration: Calibration) -> tuple[str, ...]:
    """Report the loss where our model has a thermometer lag: no autopilot has one."""
    remarks = []
    for triad, unit in (("gyro", "deg/s"), ("accel", "m/s^2")):
        made: TriadCalibration = getattr(calibration, triad)
        if made.thermal_lag_s == 0.0 or made.span_degc is None:
            continue
        low, high = made.span_degc
        t = np.linspace(low, high, STEPS)
        slope = float(np.abs(np.diff(made.c.at(t), axis=0)).max() / (t[1] - t[0]))
        error = slope * abs(made.thermal_lag_s) / 60.0
        error = math.degrees(error) if triad == "gyro" else error
        remarks.append(
            f"{triad}: the lag of {made.thermal_lag_s:.0f} s between sensor and thermometer is not "
            f"carried; while it warms by 1 degC a minute that is up to {error:.2g} {unit}"
        )
    return tuple(remarks)
