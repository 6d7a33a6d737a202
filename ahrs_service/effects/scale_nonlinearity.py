"""Scale factor that depends on the input."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ahrs_service.effects.base import (
    PER_AXIS,
    Addition,
    Columns,
    Contribution,
    Effect,
    Parameter,
    Triad,
    Values,
)


@dataclass(frozen=True)
class ScaleNonlinearity(Effect):
    """Gyro k w |w|, accelerometer k f^2."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "scale_nonlinearity"
    title: ClassVar[str] = "scale factor that changes with the input"
    equation: ClassVar[str] = "gyro k w abs(w); accel k f^2"
    excited_by: ClassVar[str] = "inputs from zero to the largest, both ways"
    taken_for: ClassVar[tuple[str, ...]] = ("scale_factor", "vibration_rectification")
    separated_by: ClassVar[str] = "turn each axis at several rates; each axis up, level and down"
    not_live: ClassVar[str] = "k w |w| is odd in the rate, the calibration's quadratic term is even"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: 0.2 % of 250 deg/s, 0.5 % of 2 g (MPU-6000), with margin."""
        is_gyro = self.triad == "gyro"
        unit, size = ("s/rad", 0.02) if is_gyro else ("s^2/m", 0.003)
        return (Parameter("k", unit, PER_AXIS, size, "MPU-6000 data sheet", step=1.0),)

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the excess of the reading."""
        u = self.ideal(columns)
        return self.on_triad(values["k"] * u * (np.abs(u) if self.triad == "gyro" else u))

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return k of the accelerometer's k f^2; the gyro's term is odd."""
        return None if self.triad == "gyro" else Contribution(quadratic=values["k"])
