"""From the temperature a sensor reports to those of its gyro and accelerometer elements.

A lag tau > 0 is a sensing element that warms later than the thermometer: a first-order low pass. A
lag tau < 0 is a thermometer that stands apart and warms later: the low pass is undone by a lead,
(1 + LEAD_GAIN p s) / (1 + p s) with p = tau / (LEAD_GAIN - 1), which enlarges the thermometer's
noise and steps no more than LEAD_GAIN times. On a ramp, as masses warm, it leaves no lag at all;
after a step, as they never do, it goes too far by a ninth.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record, Rows

LEAD_GAIN: Final = 4.0
"""Steps of 0.1 degC stay below half a degree."""

THERMOMETER_FIELDS: Final = [("filtered_degc", "f8", 2), ("thermometer_time_ns", "i8")]
"""Fields of the pipeline's state that this module keeps, gyros before accelerometers."""


@kernel
def _act(lag_s: float, memory: Floats, place: int, reported_degc: float, dt_s: float) -> float:
    """Move the filter of one triad on by `dt_s`; return the element temperature."""
    if lag_s == 0.0:
        return reported_degc
    pole_s = lag_s if lag_s > 0.0 else -lag_s / (LEAD_GAIN - 1.0)
    if math.isnan(memory[place]):
        memory[place] = reported_degc
    memory[place] -= math.expm1(-dt_s / pole_s) * (reported_degc - memory[place])
    if lag_s > 0.0:
        return memory[place]
    return reported_degc + (LEAD_GAIN - 1.0) * (reported_degc - memory[place])


@kernel
def read_thermometer(
    coefficients: Record, state: Record, time_ns: int, reported_degc: float
) -> tuple[float, float]:
    """Return the element temperatures of gyros and accelerometers at `time_ns` [degC].

    NaN where none is known. After a gap, or a time without, the temperature that comes then is
    assumed to hold throughout; a stamp before the last moves nothing.
    """
    gyro_lag_s = coefficients["gyro"]["thermal_lag_s"]
    accel_lag_s = coefficients["accel"]["thermal_lag_s"]
    if (gyro_lag_s == 0.0 and accel_lag_s == 0.0) or math.isnan(reported_degc):
        return reported_degc, reported_degc
    dt_s = max((time_ns - state["thermometer_time_ns"]) * 1e-9, 0.0)
    state["thermometer_time_ns"] = time_ns
    memory = state["filtered_degc"]
    return (
        _act(gyro_lag_s, memory, 0, reported_degc, dt_s),
        _act(accel_lag_s, memory, 1, reported_degc, dt_s),
    )


@kernel
def forget_temperature(state: Record) -> None:
    """Begin anew with the next temperature, as with another sensor's."""
    state["filtered_degc"][0] = state["filtered_degc"][1] = math.nan


@kernel
def _acting_rows(
    coefficients: Record, memory: Floats, temperature_degc: Floats, time_s: Floats, out: Floats
) -> None:
    last_s = time_s[0] if len(time_s) else 0.0
    for i in range(len(temperature_degc)):
        reported = temperature_degc[i]
        if math.isnan(reported):
            out[i, 0] = out[i, 1] = reported
            continue
        dt_s = max(time_s[i] - last_s, 0.0)
        last_s = time_s[i]
        out[i, 0] = _act(coefficients["gyro"]["thermal_lag_s"], memory, 0, reported, dt_s)
        out[i, 1] = _act(coefficients["accel"]["thermal_lag_s"], memory, 1, reported, dt_s)


def acting_columns(coefficients: Rows, temperature_degc: Floats, time_s: Floats | None) -> Floats:
    """Return the element temperatures [N, 2] (gyros, accelerometers) for the reported [N] [degC].

    `time_s` [N] [s]; without it `temperature_degc` is already that of the elements.
    """
    temperature = np.ascontiguousarray(temperature_degc, np.float64)
    if time_s is None:
        return np.stack([temperature, temperature], axis=1)
    acting = np.empty((len(temperature), 2))
    memory, time = np.full(2, np.nan), np.ascontiguousarray(time_s, np.float64)
    _acting_rows(coefficients[0], memory, temperature, time, acting)
    return acting
