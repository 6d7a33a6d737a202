"""Bias that is another on the way up than on the way down."""

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from ahrs_service.effects.base import (
    PER_AXIS,
    Addition,
    Columns,
    Effect,
    Parameter,
    Triad,
    Values,
)
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats

_ROUNDED: Final = 0.12
"""A loop of three plays (Prandtl, Ishlinskii) has rounder corners than this one of a single stop,
which fits it with 0.75 to 0.98 of its half amplitude."""


@kernel
def _branch(temperature_degc: Floats, width_degc: float, out: Floats) -> None:
    branch = 0.0
    out[0] = 0.0
    for i in range(1, temperature_degc.shape[0]):
        branch += 2.0 * (temperature_degc[i] - temperature_degc[i - 1]) / width_degc
        branch = min(1.0, max(-1.0, branch))
        out[i] = branch


def branch(temperature_degc: Floats, width_degc: float) -> Floats:
    """Return h [N] from -1 (cooled) to 1 (warmed): it crosses within `width_degc` of a reversal.

    The stop operator of Prandtl, dh = 2 dT / width within -1..1, from 0 at the beginning.
    """
    out = np.empty(len(temperature_degc))
    _branch(np.ascontiguousarray(temperature_degc, np.float64), width_degc, out)
    return out


@dataclass(frozen=True)
class ThermalHysteresis(Effect):
    """a h(T), h of the direction from which T came."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "thermal_hysteresis"
    title: ClassVar[str] = "bias that differs between warming and cooling"
    equation: ClassVar[str] = "a h, dh = 2 dT / width, -1 <= h <= 1"
    needs: ClassVar[tuple[str, ...]] = ("temperature_degc",)
    excited_by: ClassVar[str] = "warming and cooling through the same temperatures"
    taken_for: ClassVar[tuple[str, ...]] = ("thermal_rate", "thermal_lag", "thermal_bias")
    separated_by: ClassVar[str] = "hold the temperature after warming, and again after cooling"
    not_live: ClassVar[str] = "needs the history of the temperature, which the calibration has not"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: 0.1 deg/s (ADIS16460) with margin; some mg."""
        is_gyro = self.triad == "gyro"
        unit, size = ("rad/s", 0.02) if is_gyro else ("m/s^2", 0.2)
        return (
            Parameter(
                "half_amplitude",
                unit,
                PER_AXIS,
                size,
                "ADIS16460 data sheet",
                step=1.0,
                form_share=_ROUNDED,
            ),
            Parameter(
                "width_degC",
                "degC",
                (),
                12.0,
                "ADIS16460 data sheet",
                grid=(0.5, 1.0, 2.0, 4.0, 8.0),
                default=4.0,
                bounds=(0.1, 12.0),
            ),
        )

    def grid(self, columns: Columns) -> list[dict[str, float]]:
        """Return the widths that the temperature crosses both ways: none if it never reverses."""
        temperature = columns.temperature_degc
        fall = float((np.maximum.accumulate(temperature) - temperature).max())
        rise = float((temperature - np.minimum.accumulate(temperature)).max())
        return [form for form in super().grid(columns) if form["width_degC"] <= min(fall, rise)]

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the bias of the branch at each instant."""
        width = float(values["width_degC"])
        if not width > 0.0:
            return self.on_triad(np.zeros((len(columns.time_s), 3)))
        return self.on_triad(
            values["half_amplitude"] * branch(columns.temperature_degc, width)[:, None]
        )
