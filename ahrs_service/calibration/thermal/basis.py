"""Curves of temperature as B-splines: the steps and lines of the paper, cubics, and smooth splines.

A basis of degree 0 is the paper's table (one value per segment, jumping at its borders), of degree
1 the same table drawn continuous, of degree 3 with one piece the cubic that both autopilots fit.
Outside its span a basis holds the value of the nearest end, as compensation does.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.interpolate import BSpline

from ahrs_service.records import Floats

LADDER: Final = (
    (0, 1),
    (1, 1),
    (2, 1),
    (3, 1),
    *((3, pieces) for pieces in (2, 3, 4, 6, 8, 12, 16, 24)),
)
"""Degrees and pieces of the smooth curves, from the stiffest to the most flexible.

All pieces are whole numbers of 16th or of 24th parts of the span, so that curves of different
orders share their borders.
"""


@dataclass(frozen=True, slots=True)
class Basis:
    """B-splines of `degree` on `pieces` equal intervals from `low_degc` to `high_degc` [degC].

    They sum to 1 everywhere (de Boor, A Practical Guide to Splines, ch. IX).
    """

    low_degc: float
    high_degc: float
    degree: int
    pieces: int

    @property
    def size(self) -> int:
        """Number of functions."""
        return self.degree + self.pieces

    @property
    def breaks(self) -> Floats:
        """Ends of the pieces [pieces + 1] [degC]."""
        # k / n is the same number for the same share of the span, whatever n.
        shares = np.arange(self.pieces + 1) / self.pieces
        return self.low_degc + (self.high_degc - self.low_degc) * shares

    @property
    def knots(self) -> Floats:
        """Knots with the ends repeated [size + degree + 1] [degC]."""
        return np.pad(self.breaks, self.degree, mode="edge")

    def values(self, temperature_degc: Floats) -> Floats:
        """Return the functions [N, size] at temperatures [N] [degC]."""
        breaks = self.breaks
        inside = np.clip(np.atleast_1d(temperature_degc), breaks[0], breaks[-1])
        matrix = BSpline.design_matrix(inside, self.knots, self.degree)
        return np.asarray(matrix.toarray(), np.float64)

    def zeroed(self, temperature_degc: Floats, zero_degc: float) -> Floats:
        """Return a basis [N, size - 1] of those curves that are 0 at `zero_degc`."""
        at_zero = _values_at(self, zero_degc)
        shifted = self.values(temperature_degc) - at_zero
        return np.delete(shifted, int(np.argmax(at_zero)), axis=1)

    def coefficients_of_zeroed(self, weights: Floats, zero_degc: float) -> Floats:
        """Return the B-spline coefficients [size, M] of `weights` [size - 1, M] on `zeroed`."""
        at_zero = _values_at(self, zero_degc)
        dropped = int(np.argmax(at_zero))
        level = np.delete(at_zero, dropped) @ weights
        return np.insert(weights, dropped, 0.0, axis=0) - level

    def polynomials(self, coefficients: Floats) -> Floats:
        """Return polynomials [degree + 1, pieces, M] of the curves of `coefficients` [size, M].

        In T - breaks, the highest power first: the form of scipy's PPoly.
        """
        spline = BSpline(self.knots, coefficients, self.degree)
        powers = [
            spline(self.breaks[:-1], nu=power) / math.factorial(power)
            for power in range(self.degree, -1, -1)
        ]
        return np.stack(powers)


@lru_cache(maxsize=1024)
def _values_at(basis: Basis, degc: float) -> Floats:
    return basis.values(np.array([degc]))[0]


def segments(low_degc: float = -40.0, high_degc: float = 70.0, width_degc: float = 5.0) -> int:
    """Return the number of segments of `width_degc` in a span, at least one (Liu et al., S3)."""
    return max(1, round((high_degc - low_degc) / width_degc))
