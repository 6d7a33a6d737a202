"""Gyros that feel specific force."""

from dataclasses import dataclass
from typing import ClassVar

from ahrs_service.effects.base import (
    MATRIX,
    Addition,
    Columns,
    Contribution,
    Effect,
    Parameter,
    Triad,
    Values,
)


@dataclass(frozen=True)
class GSensitivity(Effect):
    """G f."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro",)
    name: ClassVar[str] = "g_sensitivity"
    title: ClassVar[str] = "gyro that feels acceleration"
    equation: ClassVar[str] = "G f"
    excited_by: ClassVar[str] = "gravity and acceleration along each axis in turn"
    taken_for: ClassVar[tuple[str, ...]] = ("gyro_misalignment", "gyro_earth_rate")
    separated_by: ClassVar[str] = "rest in six positions"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: 0.1 deg/s/g (MPU-6000), with margin."""
        source = "MPU-6000 data sheet"
        return (Parameter("matrix_rad_s_per_m_s2", "rad s/m", MATRIX, 0.002, source, step=1.0),)

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the rate that is felt."""
        return Addition(gyro=columns.force_m_s2 @ values["matrix_rad_s_per_m_s2"].T)

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return Gamma = G."""
        return Contribution(g_sensitivity=values["matrix_rad_s_per_m_s2"])
