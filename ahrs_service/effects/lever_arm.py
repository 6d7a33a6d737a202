"""The IMU away from the reference point."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

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
class LeverArm(Effect):
    """dw/dt x r + w x (w x r)."""

    triads: ClassVar[tuple[Triad, ...]] = ("accel",)
    name: ClassVar[str] = "lever_arm"
    title: ClassVar[str] = "accelerometer away from the reference point"
    equation: ClassVar[str] = "dw/dt x r + w x (w x r)"
    needs: ClassVar[tuple[str, ...]] = ("angular_acceleration_rad_s2",)
    excited_by: ClassVar[str] = "fast turns that begin and end quickly"
    taken_for: ClassVar[tuple[str, ...]] = ("imu_time_offset", "accel_scale_nonlinearity")
    separated_by: ClassVar[str] = "turn the vehicle fast about each axis by hand"
    not_live: ClassVar[str] = (
        "needs the angular acceleration, whose noise would be worse than the effect; "
        "it is in the budget of the gates (gate_budget.arm_m)"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size: a vehicle of a metre or two; 5 cm at 200 deg/s gives 0.61 m/s^2."""
        return (Parameter("arm_m", "m", PER_AXIS, 2.0, "rigid-body kinematics", step=1.0),)

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the acceleration of the sensor against the reference point."""
        arm, rate = values["arm_m"], columns.rate_rad_s
        tangential = np.cross(columns.angular_acceleration_rad_s2, arm)
        return Addition(accel=tangential + np.cross(rate, np.cross(rate, arm)))
