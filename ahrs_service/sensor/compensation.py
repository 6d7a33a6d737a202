"""From the sensor's output to rate and specific force: the inverse of sensor.forward."""

from typing import Final

from ahrs_service.kernel import kernel
from ahrs_service.records import Flag, Floats, Record, Rows

_OUT_OF_RANGE: Final = int(Flag.TEMPERATURE_OUT_OF_RANGE)


@kernel
def segment(nodes: Floats, count: int, temperature_degc: float) -> int:
    """Index of the last of `count` nodes at or below the temperature, at most the last but one."""
    low, high = 0, count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[middle] <= temperature_degc:
            low = middle
        else:
            high = middle
    return low


@kernel
def between(table: Floats, low: int, share: float, axis: int) -> float:
    """Coefficient of `axis` at `share` 0..1 of the way from node `low` to the next."""
    left = table[low, axis]
    return left + share * (table[low + 1, axis] - left)


@kernel
def compensate_triad(triad: Record, raw: Floats, temperature_degc: float, out: Floats) -> int:
    """A = K^-1 (N - E_T(N) - B) of one triad; `out` [3] may be `raw` [3]; returns flags."""
    # Each field is fetched once: a fetch in compiled code costs more than the sums do.
    bias, inverse, count = triad["bias"], triad["inverse"], triad["nodes"]
    x = raw[0] - bias[0]
    y = raw[1] - bias[1]
    z = raw[2] - bias[2]
    flags = 0
    if count > 0 and temperature_degc == temperature_degc:
        nodes, a, b, c = triad["temperature_degc"], triad["a"], triad["b"], triad["c"]
        low = segment(nodes, count, temperature_degc)
        share = (temperature_degc - nodes[low]) / (nodes[low + 1] - nodes[low])
        if share < 0.0 or share > 1.0:
            share = min(max(share, 0.0), 1.0)
            flags = _OUT_OF_RANGE
        ax, bx, cx = between(a, low, share, 0), between(b, low, share, 0), between(c, low, share, 0)
        ay, by, cy = between(a, low, share, 1), between(b, low, share, 1), between(c, low, share, 1)
        az, bz, cz = between(a, low, share, 2), between(b, low, share, 2), between(c, low, share, 2)
        x -= (ax * raw[0] + bx) * raw[0] + cx
        y -= (ay * raw[1] + by) * raw[1] + cy
        z -= (az * raw[2] + bz) * raw[2] + cz
    for i in range(3):
        out[i] = inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] * z
    return flags


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
    [3] [m/s^2]; `temperature_degc` NaN leaves the thermal term out. Beyond the nodes the drift of
    the nearest node is used and the flag returned. Liu et al., eq. (2) solved for A.
    """
    row = coefficients[0]
    flags = compensate_triad(row["gyro"], gyro_raw, temperature_degc, gyro)
    return flags | compensate_triad(row["accel"], accel_raw, temperature_degc, accel)
