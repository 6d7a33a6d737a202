"""The table of what an autopilot's form of calibration loses."""

import math
from collections.abc import Mapping
from typing import Final

from rich.table import Table

from ahrs_service.calibration.autopilots.compensation_model import Triad
from ahrs_service.calibration.autopilots.loss import Loss

_UNITS: Final = {"m/s^2": (1.0, "m/s²"), "rad/s": (math.degrees(1.0), "°/s")}


def loss_table(imu: int, losses: Mapping[Triad, Loss]) -> Table:
    """Return what the autopilot's form loses: per body axis, all of it and by its cause."""
    table = Table(
        title=f"IMU {imu}: what the autopilot's form of calibration loses",
        caption="largest over the span and all directions of 1 g and 100 °/s; bias: not a cubic",
        title_justify="left",
        caption_justify="left",
    )
    for column in ("", "largest", "rms", "bias", "scale", "cross-axis", "by force", ""):
        table.add_column(column, justify="right" if column else "left")
    for triad, loss in losses.items():
        factor, unit = _UNITS[loss.unit]
        parts = (loss.largest, loss.rms, loss.bias, loss.scale, loss.cross, loss.force)
        for axis in range(3):
            figures = [f"{factor * part[axis]:.4f}" for part in parts]
            table.add_row(f"{triad} {'xyz'[axis]}", *figures, unit)
    return table
