"""From true rate and specific force to the sensor's output: the model that all else inverts."""

import math

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record, Rows
from ahrs_service.sensor.compensation import drift_coefficient, node_position


@kernel
def output_of_axis(triad: Record, position: float, axis: int, level: float) -> float:
    """Output N of one axis where K A + B = `level`; `position` NaN for no thermal term.

    Solves a N^2 - (1 - b) N + (c + level) = 0 for the root that is `level` where the drift is
    nil, in the form that does not cancel; NaN where the parabola never reaches the level.
    """
    if math.isnan(position):
        return level
    a = drift_coefficient(triad, 2, position, axis)
    slope = 1.0 - drift_coefficient(triad, 1, position, axis)
    shifted = level + drift_coefficient(triad, 0, position, axis)
    discriminant = slope * slope - 4.0 * a * shifted
    if discriminant < 0.0:
        return math.nan
    return 2.0 * shifted / (slope + math.sqrt(discriminant))


@kernel
def respond(
    triad: Record, x: float, y: float, z: float, temperature_degc: float
) -> tuple[float, float, float]:
    """Output of one triad for the input (x, y, z) (Liu et al., eq. (2) solved for N)."""
    matrix, bias = triad["matrix"], triad["bias"]
    position = node_position(triad, temperature_degc)
    p = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + bias[0]
    q = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + bias[1]
    r = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + bias[2]
    return (
        output_of_axis(triad, position, 0, p),
        output_of_axis(triad, position, 1, q),
        output_of_axis(triad, position, 2, r),
    )


@kernel
def forward(
    coefficients: Rows,
    rate: Floats,
    force: Floats,
    temperature_degc: float,
    gyro_raw: Floats,
    accel_raw: Floats,
) -> None:
    """Write what the sensor gives for one instant; sensor.compensation is the exact inverse.

    `coefficients` [1] COEFFICIENTS_DTYPE; true rate [3] [rad/s], specific force [3] [m/s^2], and
    the outputs in the same units; `temperature_degc` NaN leaves the thermal term out.
    """
    row, t = coefficients[0], temperature_degc
    gyro_raw[0], gyro_raw[1], gyro_raw[2] = respond(row["gyro"], rate[0], rate[1], rate[2], t)
    accel_raw[0], accel_raw[1], accel_raw[2] = respond(
        row["accel"], force[0], force[1], force[2], t
    )


@kernel
def _forward_rows(
    coefficients: Rows,
    rate: Floats,
    force: Floats,
    temperature_degc: Floats,
    gyro_raw: Floats,
    accel_raw: Floats,
) -> None:
    for i in range(temperature_degc.shape[0]):
        forward(coefficients, rate[i], force[i], temperature_degc[i], gyro_raw[i], accel_raw[i])


def forward_columns(
    coefficients: Rows, rate: Floats, force: Floats, temperature_degc: Floats
) -> tuple[Floats, Floats]:
    """Return the outputs [N, 3] of gyros and accelerometers for columns of inputs.

    Rate [N, 3] [rad/s], specific force [N, 3] [m/s^2], temperature [N] [degC].
    """
    gyro_raw, accel_raw = np.empty(rate.shape), np.empty(force.shape)
    _forward_rows(
        coefficients,
        np.ascontiguousarray(rate, np.float64),
        np.ascontiguousarray(force, np.float64),
        np.ascontiguousarray(temperature_degc, np.float64),
        gyro_raw,
        accel_raw,
    )
    return gyro_raw, accel_raw
