"""From the sensor's output to rate and specific force: the inverse of sensor.forward."""

import math
from typing import Final

import numpy as np

from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Flag, Floats, Record, Rows
from ahrs_service.sensor.thermometer import acting_columns, forget_temperature, read_thermometer

_OUT_OF_RANGE: Final = int(Flag.TEMPERATURE_OUT_OF_RANGE)
_IMU_CHANGED: Final = int(Flag.IMU_CHANGED)
_UNCOMPENSATED: Final = int(Flag.UNCOMPENSATED)
A: Final = 0
B: Final = 3
C: Final = 6
_MATRIX: Final = 9
"""Columns of the drift table (sensor.parameters.COLUMNS)."""


@kernel
def find_segment(triad: Record, temperature_degc: float) -> tuple[int, float]:
    """Return the segment of a temperature and how far it lies above the segment's border [degC].

    Clamped to the first and last border; -1 where nothing drifts or no temperature is known.
    """
    last = triad["segments"]
    if last == 0 or math.isnan(temperature_degc):
        return -1, 0.0
    breaks = triad["breaks_degc"]
    inside = min(max(temperature_degc, breaks[0]), breaks[last])
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if breaks[middle] <= inside:
            low = middle
        else:
            high = middle
    return low, inside - breaks[low]


@kernel
def drift(triad: Record, segment: int, rest_degc: float, column: int) -> float:
    """Value of one column of the drift table."""
    table = triad["drift"]
    value = table[segment, column, 3] * rest_degc + table[segment, column, 2]
    value = value * rest_degc + table[segment, column, 1]
    return value * rest_degc + table[segment, column, 0]


@kernel
def is_outside(triad: Record, temperature_degc: float) -> bool:
    """Whether the temperature lies beyond the first or last border."""
    breaks, last = triad["breaks_degc"], triad["segments"]
    return last > 0 and (temperature_degc < breaks[0] or temperature_degc > breaks[last])


@kernel
def without_drift(triad: Record, segment: int, rest_degc: float, axis: int, raw: float) -> float:
    """N - E_T - B of one axis, E_T = a N^2 + b N + c (Liu et al., eq. (3))."""
    level = raw - triad["bias"][axis]
    if segment < 0:
        return level
    a = drift(triad, segment, rest_degc, A + axis)
    b = drift(triad, segment, rest_degc, B + axis)
    c = drift(triad, segment, rest_degc, C + axis)
    return level - ((a * raw + b) * raw + c)


@kernel
def matrix_element(triad: Record, segment: int, rest_degc: float, i: int, j: int) -> float:
    """Element i, j of K + dK(T)."""
    if segment < 0:
        return triad["matrix"][i, j]
    return triad["matrix"][i, j] + drift(triad, segment, rest_degc, _MATRIX + 3 * i + j)


@kernel
def solve(
    triad: Record, segment: int, rest_degc: float, p: float, q: float, r: float
) -> tuple[float, float, float]:
    """Solve (K + dK) A = (p, q, r) for A: by cofactors where K drifts, else by its inverse."""
    if triad["matrix_drifts"] == 0 or segment < 0:
        inverse = triad["inverse"]
        return (
            inverse[0, 0] * p + inverse[0, 1] * q + inverse[0, 2] * r,
            inverse[1, 0] * p + inverse[1, 1] * q + inverse[1, 2] * r,
            inverse[2, 0] * p + inverse[2, 1] * q + inverse[2, 2] * r,
        )
    a = matrix_element(triad, segment, rest_degc, 0, 0)
    b = matrix_element(triad, segment, rest_degc, 0, 1)
    c = matrix_element(triad, segment, rest_degc, 0, 2)
    d = matrix_element(triad, segment, rest_degc, 1, 0)
    e = matrix_element(triad, segment, rest_degc, 1, 1)
    f = matrix_element(triad, segment, rest_degc, 1, 2)
    g = matrix_element(triad, segment, rest_degc, 2, 0)
    h = matrix_element(triad, segment, rest_degc, 2, 1)
    k = matrix_element(triad, segment, rest_degc, 2, 2)
    ek, dk, dh = e * k - f * h, d * k - f * g, d * h - e * g
    scale = 1.0 / (a * ek - b * dk + c * dh)
    return (
        scale * (ek * p - (b * k - c * h) * q + (b * f - c * e) * r),
        scale * (-dk * p + (a * k - c * g) * q - (a * f - c * d) * r),
        scale * (dh * p - (a * h - b * g) * q + (a * e - b * d) * r),
    )


@kernel
def g_effect(triad: Record, axis: int, x: float, y: float, z: float) -> float:
    """G f of one axis for the specific force (x, y, z)."""
    g = triad["g_sensitivity"]
    return g[axis, 0] * x + g[axis, 1] * y + g[axis, 2] * z


@kernel
def invert(
    triad: Record, raw: Floats, fx: float, fy: float, fz: float, temperature_degc: float
) -> tuple[float, float, float]:
    """A = (K + dK)^-1 (N - E_T(N) - B - G f) of one triad for N = `raw` [3], f = (fx, fy, fz)."""
    segment, rest = find_segment(triad, temperature_degc)
    p = without_drift(triad, segment, rest, 0, raw[0])
    q = without_drift(triad, segment, rest, 1, raw[1])
    r = without_drift(triad, segment, rest, 2, raw[2])
    if triad["feels_force"] != 0:
        p -= g_effect(triad, 0, fx, fy, fz)
        q -= g_effect(triad, 1, fx, fy, fz)
        r -= g_effect(triad, 2, fx, fy, fz)
    return solve(triad, segment, rest, p, q, r)


@kernel
def compensate(
    coefficients: Record,
    gyro_raw: Floats,
    accel_raw: Floats,
    gyro_degc: float,
    accel_degc: float,
    gyro: Floats,
    accel: Floats,
) -> int:
    """Compensate one sample and return Flag.TEMPERATURE_OUT_OF_RANGE or 0.

    `coefficients` of COEFFICIENTS_DTYPE; raw and compensated rate [3] [rad/s] and specific force
    [3] [m/s^2]; the outputs may be the inputs. The temperatures are those that act on the gyros
    and on the accelerometers (sensor.thermometer); NaN leaves all drift out, beyond the calibrated
    span that at its end is used and the flag returned. Where no force is known its effect on the
    gyros is left out.
    """
    triad = coefficients["accel"]
    accel[0], accel[1], accel[2] = invert(triad, accel_raw, 0.0, 0.0, 0.0, accel_degc)
    is_out = is_outside(triad, accel_degc)
    triad = coefficients["gyro"]
    x, y, z = accel[0], accel[1], accel[2]
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        x = y = z = 0.0
    gyro[0], gyro[1], gyro[2] = invert(triad, gyro_raw, x, y, z, gyro_degc)
    is_out = is_out or is_outside(triad, gyro_degc)
    return _OUT_OF_RANGE if is_out else 0


@inlined_kernel
def compensate_sample(coefficients: Record, state: Record, sample: Record) -> int:
    """Write `gyro_rad_s` and `accel_m_s2` of the state from a sample; return the sample's flags.

    Without a calibration they are the sample's. So is what comes of an IMU that the calibration is
    not of, and it is flagged; flagged too is what lacks the temperature on which its drift depends.
    """
    flags, is_ideal = sample["flags"], coefficients["is_ideal"] != 0
    if is_ideal or coefficients["holds_for_source"][sample["source"]] == 0:
        for i in range(3):
            state["gyro_rad_s"][i] = sample["gyro_rad_s"][i]
            state["accel_m_s2"][i] = sample["accel_m_s2"][i]
        return flags if is_ideal else flags | _UNCOMPENSATED
    if flags & _IMU_CHANGED != 0:
        forget_temperature(state)
    reported_degc = sample["temperature_degc"]
    segments = coefficients["gyro"]["segments"] + coefficients["accel"]["segments"]
    if math.isnan(reported_degc) and segments > 0:
        flags |= _UNCOMPENSATED
    gyro_degc, accel_degc = read_thermometer(coefficients, state, sample["time_ns"], reported_degc)
    return flags | compensate(
        coefficients,
        sample["gyro_rad_s"],
        sample["accel_m_s2"],
        gyro_degc,
        accel_degc,
        state["gyro_rad_s"],
        state["accel_m_s2"],
    )


@kernel
def _compensate_rows(
    coefficients: Record, gyro_raw: Floats, accel_raw: Floats, acting_degc: Floats, out: Floats
) -> None:
    for i in range(len(gyro_raw)):
        gyro_degc, accel_degc = acting_degc[i, 0], acting_degc[i, 1]
        compensate(
            coefficients, gyro_raw[i], accel_raw[i], gyro_degc, accel_degc, out[0, i], out[1, i]
        )


def compensate_columns(
    coefficients: Rows,
    gyro_raw: Floats,
    accel_raw: Floats,
    temperature_degc: Floats,
    time_s: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Return rate and specific force [N, 3] of outputs [N, 3]: the inverse of forward_columns."""
    out = np.empty((2, *gyro_raw.shape))
    _compensate_rows(
        coefficients[0],
        np.ascontiguousarray(gyro_raw, np.float64),
        np.ascontiguousarray(accel_raw, np.float64),
        acting_columns(coefficients, temperature_degc, time_s),
        out,
    )
    return out[0], out[1]
