"""Bias that settles after power-on."""

from dataclasses import dataclass
from typing import ClassVar

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


@dataclass(frozen=True)
class WarmUp(Effect):
    """a exp(-t / tau) since power-on."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "warm_up"
    title: ClassVar[str] = "bias that settles after power-on"
    equation: ClassVar[str] = "a exp(-t / tau)"
    needs: ClassVar[tuple[str, ...]] = ("since_power_on_s",)
    excited_by: ClassVar[str] = "a recording from power-on to some time constants after"
    taken_for: ClassVar[tuple[str, ...]] = ("thermal_bias", "thermal_lag", "thermal_rate")
    separated_by: ClassVar[str] = "switch on in a chamber held at one temperature"
    not_live: ClassVar[str] = "needs the time since power-on, which the calibration has not"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sizes: the bias of a warm-up by some 20 degC; minutes."""
        is_gyro = self.triad == "gyro"
        unit, size = ("rad/s", 0.1) if is_gyro else ("m/s^2", 0.5)
        source = "ISM330DHCX: first 1000 s; MPU-6000 data sheet"
        return (
            Parameter("amplitude", unit, PER_AXIS, size, source, step=1.0),
            Parameter(
                "time_constant_s",
                "s",
                (),
                1000.0,
                source,
                grid=(10.0, 18.0, 32.0, 56.0, 100.0, 180.0, 320.0),
                bounds=(1.0, 1500.0),
            ),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the bias that is left at each instant."""
        tau = float(values["time_constant_s"])
        if not tau > 0.0:
            return self.on_triad(np.zeros((len(columns.time_s), 3)))
        left = np.exp(-columns.since_power_on_s / tau)
        return self.on_triad(values["amplitude"] * left[:, None])
