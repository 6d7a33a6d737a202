"""Bias that follows the temperature."""

from dataclasses import dataclass
from typing import ClassVar

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


@dataclass(frozen=True)
class ThermalBias(Effect):
    """k1 (T - T0) + k2 (T - T0)^2."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "thermal_bias"
    title: ClassVar[str] = "bias that follows the temperature"
    equation: ClassVar[str] = "k1 (T - T0) + k2 (T - T0)^2"
    needs: ClassVar[tuple[str, ...]] = ("temperature_degc",)
    excited_by: ClassVar[str] = "a span of temperature of 10 degC or more"
    taken_for: ClassVar[tuple[str, ...]] = ("thermal_lag", "warm_up", "thermal_hysteresis")
    separated_by: ClassVar[str] = "heat, then cool through the same temperatures at rest"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sizes: 20 deg/s over 65 degC and 60 mg over 45 degC, both ways (MPU-6000)."""
        is_gyro = self.triad == "gyro"
        unit = "rad/s" if is_gyro else "m/s^2"
        slope = 0.0055 if is_gyro else 0.025
        source = "MPU-6000 data sheet; iNav issue 73"
        return (
            Parameter("linear", f"{unit}/degC", PER_AXIS, slope, source, step=1.0),
            Parameter("quadratic", f"{unit}/degC^2", PER_AXIS, slope / 40.0, source, step=1.0),
            Parameter("reference_degC", "degC", (), 85.0, source, default=REFERENCE_DEGC),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the bias at each temperature."""
        above = (columns.temperature_degc - values["reference_degC"])[:, None]
        return self.on_triad((values["linear"] + values["quadratic"] * above) * above)

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return beta(T) = k1 (T - T0) + k2 (T - T0)^2."""
        powers = values["linear"], values["quadratic"]
        return Contribution(bias=polynomial(values["reference_degC"], *powers))
