"""Scale factor that follows the temperature."""

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
class ThermalScale(Effect):
    """k (T - T0) u."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "thermal_scale"
    title: ClassVar[str] = "scale factor that follows the temperature"
    equation: ClassVar[str] = "k (T - T0) u"
    needs: ClassVar[tuple[str, ...]] = ("temperature_degc",)
    excited_by: ClassVar[str] = "the same manoeuvre at temperatures 10 degC apart"
    taken_for: ClassVar[tuple[str, ...]] = ("scale_factor", "thermal_bias")
    separated_by: ClassVar[str] = "turn each axis both ways, cold and again warm"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: 2 % over 65 degC (gyro), 0.02 %/degC (accel), both of the MPU-6000, with margin."""
        size = 0.002 if self.triad == "gyro" else 0.001
        source = "MPU-6000 data sheet"
        return (
            Parameter("per_degC", "1/degC", PER_AXIS, size, source, step=1.0),
            Parameter("reference_degC", "degC", (), 85.0, source, default=REFERENCE_DEGC),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the change of the reading."""
        above = (columns.temperature_degc - values["reference_degC"])[:, None]
        return self.on_triad(values["per_degC"] * above * self.ideal(columns))

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return D_T(T) = k (T - T0)."""
        return Contribution(scale=polynomial(values["reference_degC"], values["per_degC"]))
