"""A range smaller than the motion."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import ndtr

from ahrs_service.effects.base import (
    Addition,
    Columns,
    Effect,
    Parameter,
    Triad,
    Values,
)
from ahrs_service.records import Floats


@dataclass(frozen=True)
class Saturation(Effect):
    """clip(u, -limit, limit) - u."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "saturation"
    title: ClassVar[str] = "reading cut at the end of its range"
    equation: ClassVar[str] = "clip(u, -limit, limit) - u"
    excited_by: ClassVar[str] = "rates or accelerations beyond the range"
    taken_for: ClassVar[tuple[str, ...]] = ("scale_nonlinearity", "scale_factor")
    separated_by: ClassVar[str] = "repeat the hardest manoeuvre at half its strength"
    not_live: ClassVar[str] = "what is cut off is lost; choose a larger range"
    limited_by: ClassVar[str] = "limit"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Ranges of 250 to 2000 deg/s and 2 to 16 g, less where a driver scales wrongly."""
        is_gyro = self.triad == "gyro"
        unit, largest = ("rad/s", 35.0) if is_gyro else ("m/s^2", 160.0)
        return (
            Parameter(
                "limit",
                unit,
                (),
                largest,
                "MPU-6000 data sheet",
                neutral=np.inf,
                grid=(np.inf,),
                bounds=(0.0, np.inf),
            ),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return what is cut off; on average, where noise and vibration are left out."""
        u, limit = self.ideal(columns), float(values["limit"])
        if columns.scatter is None or not np.isfinite(limit):
            return self.on_triad(np.clip(u, -limit, limit) - u)
        part = columns.scatter[:, :3] if self.triad == "gyro" else columns.scatter[:, 3:]
        return self.on_triad(_excess(-u - limit, part) - _excess(u - limit, part))


def _excess(above: Floats, sigma: Floats) -> Floats:
    """Return the mean of what is positive of a normal variable of mean `above`."""
    sigma = np.maximum(sigma, 1e-12)
    z = above / sigma
    return np.asarray(sigma * np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) + above * ndtr(z))
