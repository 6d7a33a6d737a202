"""From the sensor's output to rate and specific force: the inverse of sensor.forward."""

from typing import Final

from numba import njit

from ahrs_service.records import Flag, Floats, Record, Rows

_OUT_OF_RANGE: Final = int(Flag.TEMPERATURE_OUT_OF_RANGE)


@njit(cache=True)
def segment(triad: Record, temperature_degc: float) -> int:
    """Index of the last node at or below the temperature, at most the last but one."""
    low, high = 0, triad["nodes"] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if triad["temperature_degc"][middle] <= temperature_degc:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True)
def weight(triad: Record, low: int, temperature_degc: float) -> float:
    """Share of node `low` + 1 in the drift, 0..1: outside the nodes the nearest one holds."""
    left = triad["temperature_degc"][low]
    share = (temperature_degc - left) / (triad["temperature_degc"][low + 1] - left)
    return min(max(share, 0.0), 1.0)


@njit(cache=True)
def drift(triad: Record, low: int, share: float, axis: int, raw: float) -> float:
    """E_T = a N^2 + b N + c of one axis for the output `raw` (Liu et al., eq. (3))."""
    a = triad["a"][low, axis] + share * (triad["a"][low + 1, axis] - triad["a"][low, axis])
    b = triad["b"][low, axis] + share * (triad["b"][low + 1, axis] - triad["b"][low, axis])
    c = triad["c"][low, axis] + share * (triad["c"][low + 1, axis] - triad["c"][low, axis])
    return (a * raw + b) * raw + c


@njit(cache=True)
def compensate_triad(triad: Record, raw: Floats, temperature_degc: float, out: Floats) -> int:
    """A = K^-1 (N - E_T(N) - B) of one triad; `out` [3] may be `raw` [3]; returns flags."""
    x = raw[0] - triad["bias"][0]
    y = raw[1] - triad["bias"][1]
    z = raw[2] - triad["bias"][2]
    flags = 0
    nodes = triad["nodes"]
    if nodes > 0 and temperature_degc == temperature_degc:
        low = segment(triad, temperature_degc)
        share = weight(triad, low, temperature_degc)
        x -= drift(triad, low, share, 0, raw[0])
        y -= drift(triad, low, share, 1, raw[1])
        z -= drift(triad, low, share, 2, raw[2])
        if (
            temperature_degc < triad["temperature_degc"][0]
            or temperature_degc > triad["temperature_degc"][nodes - 1]
        ):
            flags = _OUT_OF_RANGE
    for i in range(3):
        inverse = triad["inverse"]
        out[i] = inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] * z
    return flags


@njit(cache=True)
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
    [3] [m/s^2]; `temperature_degc` NaN leaves the thermal term out. Beyond the nodes the drift of
    the nearest node is used and the flag returned. Liu et al., eq. (2) solved for A.
    """
    row = coefficients[0]
    flags = compensate_triad(row["gyro"], gyro_raw, temperature_degc, gyro)
    return flags | compensate_triad(row["accel"], accel_raw, temperature_degc, accel)
