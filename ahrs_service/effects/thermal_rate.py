"""Bias that follows the slope of the temperature."""

from dataclasses import dataclass
from typing import ClassVar

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
class ThermalRate(Effect):
    """k dT/dt."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "thermal_rate"
    title: ClassVar[str] = "bias while the temperature changes"
    equation: ClassVar[str] = "k dT/dt"
    needs: ClassVar[tuple[str, ...]] = ("temperature_slope_degc_s",)
    excited_by: ClassVar[str] = "temperature that changes fast, then slowly"
    taken_for: ClassVar[tuple[str, ...]] = ("thermal_lag", "thermal_hysteresis", "warm_up")
    separated_by: ClassVar[str] = "change the temperature at two rates, up and down"
    not_live: ClassVar[str] = "needs the slope of the temperature, which the calibration has not"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sizes: gradients of 0.1 degC/s that give as much as 2 degC of bias drift."""
        is_gyro = self.triad == "gyro"
        unit, size = ("rad", 0.5) if is_gyro else ("m/s", 2.0)
        source = "thermal bias of the MPU-6000 data sheet over a gradient in the package"
        return (Parameter("per_degC_per_s", f"{unit}/degC", PER_AXIS, size, source, step=1.0),)

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the bias at each slope."""
        return self.on_triad(values["per_degC_per_s"] * columns.temperature_slope_degc_s[:, None])
