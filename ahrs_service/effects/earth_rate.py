"""The rotation of the Earth."""

import math
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from ahrs_service.effects.base import (
    Addition,
    Columns,
    Effect,
    Parameter,
    Triad,
    Values,
)
from ahrs_service.rotation import inverse_columns, rotate_columns

EARTH_RATE_RAD_S: Final = 7.292115e-5
"""WGS 84 (NIMA TR8350.2, table 3.1)."""


@dataclass(frozen=True)
class EarthRate(Effect):
    """Body components of the Earth's rate."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro",)
    name: ClassVar[str] = "earth_rate"
    title: ClassVar[str] = "rotation of the Earth"
    equation: ClassVar[str] = "body_from_ned (W cos(lat), 0, -W sin(lat))"
    needs: ClassVar[tuple[str, ...]] = ("ned_from_body",)
    excited_by: ClassVar[str] = "long rests in several headings and tilts"
    taken_for: ClassVar[tuple[str, ...]] = ("gyro_g_sensitivity",)
    separated_by: ClassVar[str] = "rest in six positions and four headings for a minute each"
    not_live: ClassVar[str] = "needs the attitude; to the filter it is a bias of the gyro"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """NaN for an Earth that does not rotate."""
        return (
            Parameter(
                "latitude_deg",
                "deg",
                (),
                90.0,
                "WGS 84",
                neutral=math.nan,
                grid=(-90.0, -70.0, -50.0, -30.0, -10.0, 10.0, 30.0, 50.0, 70.0, 90.0),
                bounds=(-90.0, 90.0),
            ),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return the Earth's rate in body axes."""
        latitude = math.radians(float(values["latitude_deg"]))
        if math.isnan(latitude):
            return Addition(gyro=np.zeros(columns.rate_rad_s.shape))
        ned = EARTH_RATE_RAD_S * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])
        return Addition(gyro=rotate_columns(inverse_columns(columns.ned_from_body), ned))
