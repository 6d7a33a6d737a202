"""Axes that are not square to each other."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

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
from ahrs_service.records import Floats


@dataclass(frozen=True)
class Misalignment(Effect):
    """M u, M without diagonal."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "misalignment"
    title: ClassVar[str] = "axes out of square"
    equation: ClassVar[str] = "M u, M without diagonal"
    excited_by: ClassVar[str] = "turns about, and gravity along, each axis in turn"
    taken_for: ClassVar[tuple[str, ...]] = ("imu_mounting_rotation", "gyro_g_sensitivity")
    separated_by: ClassVar[str] = "turn about each axis alone, in six positions"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: cross-axis sensitivity of 2 % (MPU-6000), with margin."""
        source = "MPU-6000 data sheet"
        return (
            Parameter("off_diagonal", "1", MATRIX, 0.05, source, step=1.0, is_off_diagonal=True),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return what each axis sees of the others."""
        return self.on_triad(self.ideal(columns) @ _matrix(values).T)

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return D = M."""
        return Contribution(linear=_matrix(values))


def _matrix(values: Values) -> Floats:
    return np.asarray(values["off_diagonal"] * (1.0 - np.eye(3)))
