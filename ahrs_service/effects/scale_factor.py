"""Scale factor error."""

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
class ScaleFactor(Effect):
    """k u."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "scale_factor"
    title: ClassVar[str] = "scale factor error"
    equation: ClassVar[str] = "k u"
    excited_by: ClassVar[str] = "rates of 0.5 rad/s; each axis along gravity"
    taken_for: ClassVar[tuple[str, ...]] = ("scale_nonlinearity", "thermal_scale")
    separated_by: ClassVar[str] = "turn each axis both ways, slowly and fast"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: 2 to 3 % (MPU-6000), with margin."""
        source = "MPU-6000 data sheet"
        return (Parameter("scale_error", "1", PER_AXIS, 0.05, source, step=1.0),)

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the excess of the reading."""
        return self.on_triad(values["scale_error"] * self.ideal(columns))

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return D = diag(k)."""
        return Contribution(linear=np.diag(values["scale_error"]))
