"""Bias that follows the battery current."""

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
class CurrentCoupling(Effect):
    """k (I - I0)."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "current_coupling"
    title: ClassVar[str] = "bias that follows the battery current"
    equation: ClassVar[str] = "k (I - I0)"
    needs: ClassVar[tuple[str, ...]] = ("current_a",)
    excited_by: ClassVar[str] = "currents from idle to full"
    taken_for: ClassVar[tuple[str, ...]] = ("vibration_rectification", "thermal_bias")
    separated_by: ClassVar[str] = "draw current at rest without motors turning"
    not_live: ClassVar[str] = "needs the battery current, which samples do not carry"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: supply ripple of 0.1 V/10 A at the supply sensitivity of MEMS sensors."""
        is_gyro = self.triad == "gyro"
        unit, size = ("rad/s", 0.01) if is_gyro else ("m/s^2", 0.1)
        source = "supply sensitivity of MEMS data sheets"
        return (
            Parameter("per_ampere", f"{unit}/A", PER_AXIS, size, source, step=1.0),
            Parameter("reference_a", "A", (), 0.0, source, default=0.0),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the bias at each current."""
        above = columns.current_a - values["reference_a"]
        return self.on_triad(values["per_ampere"] * above[:, None])
