"""Where a calibration comes from, how well it is known, and whether it may be used.

No kernel reads this: it is carried by the calibration, written to its file and shown.
"""

import datetime
import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ahrs_service.errors import InvalidValueError
from ahrs_service.sensor.curve import Curve

_STRICT = {"extra": "forbid"}


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a calibration may be used: in plain words, and the figures behind them.

    `sentences` say first what counts most; `figures` are finite numbers by a name with its unit,
    as "residual_accel_x_m_s2".
    """

    __pydantic_config__: ClassVar = _STRICT
    usable: bool = True
    sentences: tuple[str, ...] = ()
    figures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError for a figure that is no finite number."""
        for name, value in self.figures.items():
            if not math.isfinite(value):
                raise InvalidValueError(f"figures.{name} = {value}: leave out what is not known")


@dataclass(frozen=True, slots=True)
class SourceRecording:
    """A recording that a calibration was made from: its file name, its hash, what it was for."""

    __pydantic_config__: ClassVar = _STRICT
    name: str
    sha256: str
    use: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError for what is no SHA-256."""
        if len(self.sha256) != 64 or set(self.sha256) - set("0123456789abcdef"):
            raise InvalidValueError(f"sha256 = {self.sha256!r}: give 64 lower-case hex digits")


@dataclass(frozen=True, slots=True)
class Provenance:
    """`date` of the calibration (ISO 8601), the `procedures` run, and the `recordings` used."""

    __pydantic_config__: ClassVar = _STRICT
    date: str = ""
    procedures: tuple[str, ...] = ()
    recordings: tuple[SourceRecording, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError for a date that is none."""
        if self.date:
            try:
                datetime.date.fromisoformat(self.date[:10])
            except ValueError:
                raise InvalidValueError(f"date = {self.date!r}: write it as 2024-05-31") from None


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """How well the figures of one triad are known, 1-sigma; None and empty where not known.

    `bias_residual` [3] is what the calibration leaves of the bias over its temperatures (RMS, of
    data that the fit has not seen where there is any) [unit]: the filter's prior of the bias.
    `bias_turn_on` [3] is how the bias differs from one power-on to the next [unit].
    `bias_sigma` and `scale_sigma` are curves of 3 columns: sigma of B + c [unit] and of the scale
    factors [1] over temperature. `covariance` [n, n] belongs to the fitted `parameters` [n], named
    like "matrix.xy", "bias.x", "g_sensitivity.zx", "c.x.3.1" (segment, power), "thermal_lag_s".
    """

    __pydantic_config__: ClassVar = _STRICT
    bias_residual: tuple[float, float, float] | None = None
    bias_turn_on: tuple[float, float, float] | None = None
    bias_sigma: Curve = field(default_factory=Curve)
    scale_sigma: Curve = field(default_factory=Curve)
    parameters: tuple[str, ...] = ()
    covariance: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError that names the field, its value and what to do."""
        for name in ("bias_residual", "bias_turn_on"):
            value = getattr(self, name)
            if value is not None and not all(0.0 <= x < math.inf for x in value):
                raise InvalidValueError(f"{name} = {value}: give 3 finite sigmas, none negative")
        for name in ("bias_sigma", "scale_sigma"):
            if getattr(self, name).columns not in (0, 3):
                raise InvalidValueError(f"{name} needs 3 columns: x, y, z")
        self._check_covariance()

    def _check_covariance(self) -> None:
        count = len(self.parameters)
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            raise InvalidValueError(
                f"covariance needs {count} x {count} numbers for the {count} parameters named"
            )
        matrix = np.array(self.covariance).reshape(count, count)
        if not np.isfinite(matrix).all() or (np.diag(matrix) < 0.0).any():
            raise InvalidValueError(
                "covariance: give finite numbers, none negative on the diagonal"
            )

    def standard_errors(self) -> dict[str, float]:
        """Return the standard error of each fitted parameter by its name."""
        return {name: math.sqrt(self.covariance[i][i]) for i, name in enumerate(self.parameters)}
