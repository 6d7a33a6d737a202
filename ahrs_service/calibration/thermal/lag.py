"""The lag between a sensor's thermometer and its elements, from how the residual depends on it."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from ahrs_service.calibration.thermal.coloured import inflation
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth_drift import AxisProblem, Structure
from ahrs_service.records import Floats

LARGEST_LAG_S: Final = 180.0  # A choice: range of the search [s]
_HALF_CHI2: Final = 0.5 * 3.841
"""Drop of the log likelihood at the ends of a 95 % interval (chi-squared of one parameter)."""
_GRID: Final = np.linspace(-1.0, 1.0, 17) ** 3 * LARGEST_LAG_S
"""Where the profile is looked at first, finest about 0 [s]."""


@dataclass(frozen=True, slots=True)
class Lag:
    """Lag of the elements behind the thermometer [s], and its 95 % interval [s].

    `is_reported` is false where the interval reaches an end of the search or holds 0; the lag is
    then taken as 0, for a lag that is not known does more harm than good.
    """

    lag_s: float = 0.0
    low_s: float = -LARGEST_LAG_S
    high_s: float = LARGEST_LAG_S
    is_reported: bool = False

    @property
    def sigma_s(self) -> float:
        """Standard error equivalent to the interval [s]."""
        return (self.high_s - self.low_s) / 3.92


class _Profile:
    """Minus the log likelihood of the rows at a lag, all else fitted anew.

    Of independent Gauss residuals it is n/2 log(RSS) per axis; colour leaves n / inflation of the
    n rows.
    """

    def __init__(
        self,
        rows: ThermalRows,
        structures: tuple[Structure, ...],
        zero_degc: float,
        level_output: Floats,
    ) -> None:
        self._rows, self._structures, self._zero = rows, structures, zero_degc
        self._u = level_output
        self.look_at(0.0)

    def _residual(self, lag_s: float) -> Floats:
        rows = self._rows.at_element(lag_s)
        rests = []
        for axis, structure in enumerate(self._structures):
            problem = AxisProblem(rows, axis, structure, self._zero, self._u)
            rests.append(problem.residual(problem.fit()))
        return np.stack(rests, axis=1)

    def look_at(self, lag_s: float) -> None:
        """Take the residual's colour from that at `lag_s`."""
        rest = self._residual(lag_s)
        self._effective = np.array([len(rest) / inflation(rest[:, i]) for i in range(3)])

    def __call__(self, lag_s: float) -> float:
        rest = self._residual(lag_s)
        squares = np.maximum(np.einsum("ni,ni->i", rest, rest), 1e-300)
        return float(0.5 * self._effective @ np.log(squares))


def estimate_lag(
    rows: ThermalRows,
    structures: tuple[Structure, ...],
    zero_degc: float,
    level_output: Floats,
) -> Lag:
    """Estimate the elements' lag by the profile likelihood, between the ends of LARGEST_LAG_S.

    A constant-rate run cannot separate a lag from a shift of the temperature, and the interval
    then is as wide as the search. `structures` of the three axes, `level_output` [P, 3] as
    AxisProblem takes it.
    """
    if not any(structure.size for structure in structures):
        return Lag()
    profile = _Profile(rows, structures, zero_degc, level_output)
    n = int(np.clip(np.argmin([profile(x) for x in _GRID]), 1, len(_GRID) - 2))
    # The colour at lag 0 is that of the lag itself; once it is off, the profile is sharper.
    profile.look_at(_GRID[n])
    bounds = (_GRID[n - 1], _GRID[n + 1])
    found = minimize_scalar(profile, bounds=bounds, method="bounded", options={"xatol": 0.05})
    best, least = float(found.x), float(found.fun)

    def above(lag_s: float) -> float:
        return profile(lag_s) - least - _HALF_CHI2

    ends = (-LARGEST_LAG_S, LARGEST_LAG_S)
    low, high = (
        float(brentq(above, best, end, xtol=0.1)) if above(end) > 0.0 else end for end in ends
    )
    is_reported = low > ends[0] and high < ends[1] and not low <= 0.0 <= high
    return Lag(best if is_reported else 0.0, low, high, is_reported)
