"""From true rate and specific force to the sensor's output: the model that all else inverts."""

import math

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record, Rows
from ahrs_service.sensor.compensation import (
    A,
    B,
    C,
    drift,
    find_segment,
    g_effect,
    matrix_element,
)
from ahrs_service.sensor.thermometer import acting_columns


@kernel
def output_of_axis(triad: Record, segment: int, rest_degc: float, axis: int, level: float) -> float:
    """Output N of one axis where (K + dK) A + B + G f = `level`.

    Solves a N^2 - (1 - b) N + (c + level) = 0 for the root that is `level` where the drift is
    zero, in the form that does not cancel; NaN where the parabola never reaches the level.
    """
    if segment < 0:
        return level
    a = drift(triad, segment, rest_degc, A + axis)
    slope = 1.0 - drift(triad, segment, rest_degc, B + axis)
    shifted = level + drift(triad, segment, rest_degc, C + axis)
    discriminant = slope * slope - 4.0 * a * shifted
    if discriminant < 0.0:
        return math.nan
    return 2.0 * shifted / (slope + math.sqrt(discriminant))


@kernel
def _level(
    triad: Record, segment: int, rest_degc: float, axis: int, x: float, y: float, z: float
) -> float:
    """(K + dK) A + B of one axis for A = (x, y, z)."""
    return (
        matrix_element(triad, segment, rest_degc, axis, 0) * x
        + matrix_element(triad, segment, rest_degc, axis, 1) * y
        + matrix_element(triad, segment, rest_degc, axis, 2) * z
        + triad["bias"][axis]
    )


@kernel
def respond(
    triad: Record, a: Floats, fx: float, fy: float, fz: float, temperature_degc: float, out: Floats
) -> None:
    """Write the output [3] of one triad for the input `a` [3] under the force (fx, fy, fz)."""
    x, y, z = a[0], a[1], a[2]
    segment, rest = find_segment(triad, temperature_degc)
    for axis in range(3):
        level = _level(triad, segment, rest, axis, x, y, z) + g_effect(triad, axis, fx, fy, fz)
        out[axis] = output_of_axis(triad, segment, rest, axis, level)


@kernel
def forward(
    coefficients: Rows,
    rate: Floats,
    force: Floats,
    gyro_degc: float,
    accel_degc: float,
    gyro_raw: Floats,
    accel_raw: Floats,
) -> None:
    """Write what the sensor gives for one instant; sensor.compensation is the exact inverse.

    `coefficients` [1] COEFFICIENTS_DTYPE; true rate [3] [rad/s], specific force [3] [m/s^2], and
    the outputs in the same units; the temperatures are those that act on gyros and accelerometers
    (sensor.thermometer), NaN leaves all drift out.
    """
    row, x, y, z = coefficients[0], force[0], force[1], force[2]
    respond(row["gyro"], rate, x, y, z, gyro_degc, gyro_raw)
    respond(row["accel"], force, 0.0, 0.0, 0.0, accel_degc, accel_raw)


@kernel
def _forward_rows(
    coefficients: Rows,
    rate: Floats,
    force: Floats,
    acting_degc: Floats,
    gyro_raw: Floats,
    accel_raw: Floats,
) -> None:
    for i in range(len(rate)):
        gyro_degc, accel_degc = acting_degc[i, 0], acting_degc[i, 1]
        forward(coefficients, rate[i], force[i], gyro_degc, accel_degc, gyro_raw[i], accel_raw[i])


def forward_columns(
    coefficients: Rows,
    rate: Floats,
    force: Floats,
    temperature_degc: Floats,
    time_s: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Return the outputs [N, 3] of gyros and accelerometers for columns of inputs.

    Rate [N, 3] [rad/s], specific force [N, 3] [m/s^2]; temperature [N] [degC] as the thermometer
    shows it at `time_s` [N] [s]; without times it is the element temperature of both.
    """
    gyro_raw, accel_raw = np.empty(rate.shape), np.empty(force.shape)
    _forward_rows(
        coefficients,
        np.ascontiguousarray(rate, np.float64),
        np.ascontiguousarray(force, np.float64),
        acting_columns(coefficients, temperature_degc, time_s),
        gyro_raw,
        accel_raw,
    )
    return gyro_raw, accel_raw
