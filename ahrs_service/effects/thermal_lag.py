"""Bias that follows a temperature behind the reported one."""

import math
from dataclasses import dataclass
from typing import ClassVar

from scipy.signal import lfilter

from ahrs_service.effects.base import (
    PER_AXIS,
    REFERENCE_DEGC,
    Addition,
    Columns,
    Contribution,
    Effect,
    Parameter,
    Triad,
    Values,
    polynomial,
)
from ahrs_service.records import Floats


def lagged(time_s: Floats, temperature_degc: Floats, time_constant_s: float) -> Floats:
    """Return Td [N] with tau dTd/dt = T - Td, in equilibrium at the beginning.

    Exact for temperatures linear between instants at the mean step.
    """
    if time_constant_s <= 0.0 or len(time_s) < 2:
        return temperature_degc.copy()
    ratio = (time_s[-1] - time_s[0]) / (len(time_s) - 1) / time_constant_s
    keep = math.exp(-ratio)
    share = (1.0 - keep) / ratio
    b = [1.0 - share, share - keep]
    start = temperature_degc[0]
    return start + lfilter(b, [1.0, -keep], temperature_degc - start)


@dataclass(frozen=True)
class ThermalLag(Effect):
    """k (Td - T0), tau dTd/dt = T - Td."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "thermal_lag"
    title: ClassVar[str] = "bias that follows the temperature late"
    equation: ClassVar[str] = "k (Td - T0), tau dTd/dt = T - Td"
    needs: ClassVar[tuple[str, ...]] = ("temperature_degc",)
    excited_by: ClassVar[str] = "temperature that rises and falls within a few time constants"
    taken_for: ClassVar[tuple[str, ...]] = ("thermal_bias", "thermal_rate", "thermal_hysteresis")
    separated_by: ClassVar[str] = "heat quickly, then hold the temperature until the bias settles"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sizes of thermal_bias; seconds to minutes from die to board."""
        is_gyro = self.triad == "gyro"
        unit, slope = ("rad/s", 0.0055) if is_gyro else ("m/s^2", 0.025)
        source = "MPU-6000 data sheet; ISM330DHCX: first 1000 s"
        return (
            Parameter(
                "time_constant_s",
                "s",
                (),
                1000.0,
                source,
                grid=(8.0, 14.0, 24.0, 40.0, 65.0, 105.0, 170.0, 280.0),
                bounds=(1.0, 1500.0),
            ),
            Parameter("linear", f"{unit}/degC", PER_AXIS, slope, source, step=1.0),
            Parameter("reference_degC", "degC", (), 85.0, source, default=REFERENCE_DEGC),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the bias at each lagged temperature."""
        acting = lagged(columns.time_s, columns.temperature_degc, float(values["time_constant_s"]))
        return self.on_triad(values["linear"] * (acting - values["reference_degC"])[:, None])

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return beta(Td) = k (Td - T0), and by how much Td is late."""
        return Contribution(
            bias=polynomial(values["reference_degC"], values["linear"]),
            lag_s=float(values["time_constant_s"]),
        )
