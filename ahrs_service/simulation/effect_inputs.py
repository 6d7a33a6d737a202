"""Inputs of a simulated sensor's effects."""

from typing import Final

import numpy as np

from ahrs_service.effects.base import Columns, Effect, Values
from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats, Rows

POWER_ON_S: Final = 3.0
"""How long the sensor has been on when a flight begins [s]: links.simulated.autopilot_messages."""


def columns_of(
    truth: Rows,
    temperature_degc: Floats,
    rate_hz: float,
    current_a: Floats | None,
    vibration_m_s2: Floats,
) -> Columns:
    """Return the effect inputs of a sensor that makes the true motion `truth` [N] TRUTH_DTYPE.

    The recording begins POWER_ON_S after power-on; slopes are central differences.
    """
    unknown = np.full(len(truth), np.nan)
    return Columns(
        time_s=truth["time_s"],
        since_power_on_s=truth["time_s"] + POWER_ON_S,
        rate_rad_s=truth["rate_rad_s"],
        force_m_s2=truth["force_m_s2"],
        angular_acceleration_rad_s2=np.gradient(truth["rate_rad_s"], 1.0 / rate_hz, axis=0),
        temperature_degc=temperature_degc,
        temperature_slope_degc_s=np.gradient(temperature_degc, 1.0 / rate_hz),
        vibration_m_s2=vibration_m_s2,
        current_a=unknown if current_a is None else current_a,
        throttle=truth["throttle"],
        airspeed_m_s=truth["airspeed_m_s"],
        ned_from_body=truth["ned_from_body"],
    )


def needed(
    effects: tuple[tuple[Effect, Values], ...], columns: Columns
) -> list[tuple[Effect, Values]]:
    """Return the effects if all they need is known; ValueError names what is not."""
    for effect, _ in effects:
        name = effect.unknown_need(columns)
        if name is not None:
            raise InvalidValueError(
                f"{effect.id} needs {name}, which is not known here: "
                "leave the effect out, or simulate a recording that has it"
            )
    return list(effects)
