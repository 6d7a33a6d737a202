"""Rotation of the IMU against the vehicle."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

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
class MountingRotation(Effect):
    """R u - u for both triads, R = exp [rho x]."""

    triads: ClassVar[tuple[Triad, ...]] = ("imu",)
    name: ClassVar[str] = "mounting_rotation"
    title: ClassVar[str] = "IMU mounted askew"
    equation: ClassVar[str] = "exp([rho x]) u - u, both triads"
    excited_by: ClassVar[str] = "turns about two axes; tilts"
    taken_for: ClassVar[tuple[str, ...]] = ("gyro_misalignment", "accel_misalignment")
    separated_by: ClassVar[str] = "turn about each axis alone, in six positions"
    alters_motion: ClassVar[bool] = True
    is_constant: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: 10 deg and less is mounted by eye; more is another orientation."""
        source = "autopilot mounting practice (AHRS_TRIM limit of ArduPilot: 10 deg)"
        return (Parameter("rotvec_rad", "rad", PER_AXIS, 0.18, source, step=1e-3),)

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the difference of rotated and ideal readings."""
        excess = Rotation.from_rotvec(values["rotvec_rad"]).as_matrix()
        if not values["rotvec_rad"].any():
            excess = excess * 0.0
        else:
            excess[[0, 1, 2], [0, 1, 2]] -= 1.0
        return Addition(columns.rate_rad_s @ excess.T, columns.force_m_s2 @ excess.T)

    def in_calibration(self, values: Values) -> Contribution | None:
        """Return D = R - I, of both triads."""
        turned = Rotation.from_rotvec(values["rotvec_rad"]).as_matrix()
        return Contribution(linear=turned - np.eye(3))
