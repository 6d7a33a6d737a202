"""Bias under vibration."""

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
class VibrationRectification(Effect):
    """k sigma_vib^2."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "vibration_rectification"
    title: ClassVar[str] = "vibration turned into bias"
    equation: ClassVar[str] = "k sigma_vib^2"
    needs: ClassVar[tuple[str, ...]] = ("vibration_m_s2",)
    excited_by: ClassVar[str] = "motors at several speeds, and off"
    taken_for: ClassVar[tuple[str, ...]] = ("current_coupling", "thermal_bias")
    separated_by: ClassVar[str] = "run the motors without propellers, or load them held down"
    not_live: ClassVar[str] = (
        "needs the level of vibration, which samples do not carry; mount the sensor softer"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: 58 mg at 2 to 5 m/s^2 of vibration (ArduPilot PR 32471), with margin."""
        is_gyro = self.triad == "gyro"
        unit, size = ("rad s^3/m^2", 0.05) if is_gyro else ("s^2/m", 0.5)
        source = "ArduPilot PR 32471"
        return (Parameter("per_vibration_variance", unit, PER_AXIS, size, source, step=1.0),)

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the bias at each level of vibration."""
        return self.on_triad(
            values["per_vibration_variance"] * (columns.vibration_m_s2**2)[:, None]
        )
