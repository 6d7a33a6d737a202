"""Smooth commands: a uniform quintic B-spline through time with exact slopes."""

from typing import Final

import numpy as np
from numpy.polynomial import Polynomial

from ahrs_service.records import Floats

_DEGREE: Final = 5
_REACH: Final = 3


def _pieces() -> list[Polynomial]:
    """Return the polynomials in 0..1 that make up the cardinal B-spline (Cox-de Boor)."""
    pieces = [Polynomial([1.0])]
    for degree in range(1, _DEGREE + 1):
        zero = Polynomial([0.0])
        before = [zero, *pieces, zero]
        pieces = [
            (
                Polynomial([j, 1.0]) * before[j + 1]
                + Polynomial([degree + 1.0 - j, -1.0]) * before[j]
            )
            / degree
            for j in range(degree + 1)
        ]
    return pieces


_PIECES: Final = _pieces()
_SLOPES: Final = [piece.deriv() for piece in _PIECES]


class UniformSpline:
    """Curves with four continuous derivatives that follow control points `step_s` apart.

    The curve smooths the points with a kernel of 0.71 `step_s` standard deviation; constant
    points give that constant exactly, beyond the ends the last point holds.
    """

    def __init__(self, control: Floats, step_s: float) -> None:
        self._control = np.pad(control, ((_REACH, _REACH), (0, 0)), mode="edge")
        self._step_s = step_s
        self._last = len(control) - 1

    def evaluate(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return values and slopes [1/s], both [N, M], at the times [N] [s]."""
        x = np.clip(time_s / self._step_s, 0.0, self._last)
        knot = x.astype(np.int64)
        u = x - knot
        value = np.zeros((len(u), self._control.shape[1]))
        slope = np.zeros_like(value)
        for k in range(_DEGREE + 1):
            points = self._control[np.minimum(knot + k + 1, len(self._control) - 1)]
            value += _PIECES[_DEGREE - k](u)[:, None] * points
            slope += _SLOPES[_DEGREE - k](u)[:, None] * points
        return value, slope / self._step_s


def smooth_step(x: Floats) -> tuple[Floats, Floats, Floats]:
    """Return 0 below 0, 1 above 1 and 10 x^3 - 15 x^4 + 6 x^5 between, with two derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return (
        x**3 * (10.0 - 15.0 * x + 6.0 * x**2),
        30.0 * x**2 * (1.0 - x) ** 2,
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x),
    )
