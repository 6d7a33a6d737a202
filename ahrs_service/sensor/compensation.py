"""From the sensor's output to rate and specific force: the inverse of sensor.forward."""

import math
from typing import Final

from ahrs_service.kernel import kernel
from ahrs_service.records import Flag, Floats, Record, Rows

_OUT_OF_RANGE: Final = int(Flag.TEMPERATURE_OUT_OF_RANGE)


@kernel
def node_position(triad: Record, temperature_degc: float) -> float:
    """Where the temperature lies among the nodes: 2.25 is a quarter of the way from 2 to 3.

    Clamped to the first and last node; NaN where there are no nodes or no temperature.
    """
    if triad["nodes"] == 0 or math.isnan(temperature_degc):
        return math.nan
    nodes = triad["temperature_degc"]
    low, high = 0, triad["nodes"] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[middle] <= temperature_degc:
            low = middle
        else:
            high = middle
    share = (temperature_degc - nodes[low]) / (nodes[low + 1] - nodes[low])
    return low + min(max(share, 0.0), 1.0)


@kernel
def drift_coefficient(triad: Record, power: int, position: float, axis: int) -> float:
    """Coefficient of N^`power` in the drift of one axis, linear between the nodes."""
    table = triad["drift"]
    low = min(int(position), triad["nodes"] - 2)
    left = table[power, low, axis]
    return left + (position - low) * (table[power, low + 1, axis] - left)


@kernel
def thermal_drift(triad: Record, position: float, axis: int, raw: float) -> float:
    """E_T = a N^2 + b N + c of one axis for the output `raw` (Liu et al., eq. (3))."""
    a = drift_coefficient(triad, 2, position, axis)
    b = drift_coefficient(triad, 1, position, axis)
    c = drift_coefficient(triad, 0, position, axis)
    return (a * raw + b) * raw + c


@kernel
def is_outside(triad: Record, temperature_degc: float) -> bool:
    """Whether the temperature lies beyond the first or last node."""
    nodes = triad["temperature_degc"]
    last = triad["nodes"] - 1
    return last > 0 and (temperature_degc < nodes[0] or temperature_degc > nodes[last])


@kernel
def invert(
    triad: Record, x: float, y: float, z: float, position: float
) -> tuple[float, float, float]:
    """A = K^-1 (N - E_T(N) - B) of one triad (Liu et al., eq. (2)); `position` NaN for no E_T."""
    bias, inverse = triad["bias"], triad["inverse"]
    p, q, r = x - bias[0], y - bias[1], z - bias[2]
    if not math.isnan(position):
        p -= thermal_drift(triad, position, 0, x)
        q -= thermal_drift(triad, position, 1, y)
        r -= thermal_drift(triad, position, 2, z)
    return (
        inverse[0, 0] * p + inverse[0, 1] * q + inverse[0, 2] * r,
        inverse[1, 0] * p + inverse[1, 1] * q + inverse[1, 2] * r,
        inverse[2, 0] * p + inverse[2, 1] * q + inverse[2, 2] * r,
    )


@kernel
def compensate(
    coefficients: Rows,
    gyro_raw: Floats,
    accel_raw: Floats,
    temperature_degc: float,
    gyro: Floats,
    accel: Floats,
) -> int:
    """Compensate one sample and return Flag.TEMPERATURE_OUT_OF_RANGE or 0.

    `coefficients` [1] COEFFICIENTS_DTYPE; raw and compensated rate [3] [rad/s] and specific force
    [3] [m/s^2]; the outputs may be the inputs. `temperature_degc` NaN leaves the thermal term out;
    beyond the nodes the drift of the nearest one is used and the flag returned.
    """
    row = coefficients[0]
    triad, raw = row["gyro"], gyro_raw
    position = node_position(triad, temperature_degc)
    gyro[0], gyro[1], gyro[2] = invert(triad, raw[0], raw[1], raw[2], position)
    is_out = is_outside(triad, temperature_degc)
    triad, raw = row["accel"], accel_raw
    position = node_position(triad, temperature_degc)
    accel[0], accel[1], accel[2] = invert(triad, raw[0], raw[1], raw[2], position)
    is_out = is_out or is_outside(triad, temperature_degc)
    return _OUT_OF_RANGE if is_out else 0
