"""Functions of temperature as pieces of polynomials, the one form for every thermal model.

Steps, lines that meet or jump at the nodes, splines and Chebyshev series all are such pieces, so
one table and one kernel serve them all.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats

POWERS: Final = 4
"""Coefficients of a piece: up to a cubic."""

_STRICT = {"extra": "forbid"}

Piece = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Curve:
    """Columns of values over temperature: in each segment a polynomial up to the cubic.

    `breaks_degc` [n + 1] borders of the segments [degC], rising; `pieces` [n, columns, powers]: in
    segment i a column is the sum of pieces[i][column][k] (T - breaks_degc[i])^k [unit/degC^k].
    At a border the segment above holds. Beyond the first and last border the value there holds.
    `Curve()` has neither and is zero everywhere.
    """

    __pydantic_config__: ClassVar = _STRICT
    breaks_degc: tuple[float, ...] = ()
    pieces: tuple[Piece, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError that names the field, its value and what to do."""
        breaks, count = self.breaks_degc, len(self.pieces)
        if not count and not breaks:
            return
        if len(breaks) != count + 1 or not count:
            raise InvalidValueError(
                f"breaks_degc has {len(breaks)} borders for {count} pieces: "
                "give one border more than pieces"
            )
        if not all(math.isfinite(x) for x in breaks) or (np.diff(breaks) <= 0.0).any():
            raise InvalidValueError(
                f"breaks_degc = {breaks} does not rise: sort the borders, and the pieces with "
                "them, and give each temperature once"
            )
        for i, piece in enumerate(self.pieces):
            widths = {len(column) for column in piece}
            if not piece or len(piece) != self.columns or not widths <= set(range(1, POWERS + 1)):
                raise InvalidValueError(
                    f"pieces[{i}] = {piece}: give {max(self.columns, 1)} columns of 1 to {POWERS} "
                    "coefficients, as in the first piece"
                )
            if not all(math.isfinite(x) for column in piece for x in column):
                raise InvalidValueError(f"pieces[{i}] = {piece}: give finite numbers")

    @classmethod
    def steps(cls, breaks_degc: npt.ArrayLike, values: npt.ArrayLike) -> "Curve":
        """Return constants `values` [n, columns] in the segments between `breaks_degc` [n + 1]."""
        return cls.from_ppoly(breaks_degc, np.asarray(values, np.float64)[None])

    @classmethod
    def linear(cls, nodes_degc: npt.ArrayLike, values: npt.ArrayLike) -> "Curve":
        """Return the lines that join `values` [n + 1, columns] at `nodes_degc` [n + 1]."""
        nodes, y = np.asarray(nodes_degc, np.float64), np.asarray(values, np.float64)
        slopes = np.diff(y, axis=0) / np.diff(nodes)[:, None]
        return cls.from_ppoly(nodes, np.stack([slopes, y[:-1]]))

    @classmethod
    def from_ppoly(cls, breaks_degc: npt.ArrayLike, c: npt.ArrayLike) -> "Curve":
        """Return the curve of scipy's PPoly form (`ppoly.x`, `ppoly.c`).

        `c` [powers, n, columns], the highest power first. Segments without length, as at the
        repeated knots of a spline, are left out.
        """
        breaks = np.asarray(breaks_degc, np.float64)
        pieces = np.moveaxis(np.asarray(c, np.float64)[::-1], 0, -1)
        has_length = np.diff(breaks) > 0.0
        return cls(
            tuple(breaks[np.append(has_length, True)].tolist()),
            tuple(tuple(map(tuple, piece)) for piece in pieces[has_length].tolist()),
        )

    @classmethod
    def through(cls, breaks_degc: npt.ArrayLike, function: Callable[[Floats], Any]) -> "Curve":
        """Return in each segment the cubic through four points of `function`.

        `function` gives [m, columns] for temperatures [m] [degC]: a scipy BSpline with knots at
        the borders is met exactly, a smooth one (Chebyshev) to the fourth order of the segments.
        """
        breaks = np.asarray(breaks_degc, np.float64)
        lengths = np.diff(breaks)
        # Chebyshev's points: none on a border, where the neighbour's piece might answer.
        places = 0.5 - 0.5 * np.cos((np.arange(POWERS) + 0.5) * np.pi / POWERS)
        t = breaks[:-1, None] + lengths[:, None] * places
        y = np.asarray(function(t.ravel()), np.float64).reshape(*t.shape, -1)
        c = np.einsum("kp,npm->knm", np.linalg.inv(np.vander(places, increasing=True)), y)
        c /= lengths[None, :, None] ** np.arange(POWERS)[:, None, None]
        return cls.from_ppoly(breaks, c[::-1])

    @property
    def columns(self) -> int:
        """How many values the curve gives; 0 for the empty one."""
        return len(self.pieces[0]) if self.pieces else 0

    @property
    def span_degc(self) -> tuple[float, float]:
        """First and last border [degC]; NaN, NaN for the empty curve."""
        return (self.breaks_degc[0], self.breaks_degc[-1]) if self.pieces else (math.nan, math.nan)

    def table(self) -> Floats:
        """Return the coefficients [n, columns, POWERS], the missing powers 0."""
        table = np.zeros((len(self.pieces), self.columns, POWERS))
        for i, piece in enumerate(self.pieces):
            for j, column in enumerate(piece):
                table[i, j, : len(column)] = column
        return table

    def at(self, temperature_degc: npt.ArrayLike) -> Floats:
        """Return the values [..., columns] at temperatures [...] [degC]; NaN gives NaN."""
        t = np.asarray(temperature_degc, np.float64)
        if not self.pieces:
            return np.zeros((*t.shape, 0))
        segment, rest = _place(np.array(self.breaks_degc), t)
        c, rest = self.table()[segment], rest[..., None]
        value: Floats = ((c[..., 3] * rest + c[..., 2]) * rest + c[..., 1]) * rest + c[..., 0]
        return value

    def on(self, breaks_degc: npt.ArrayLike) -> "Curve":
        """Return the same curve with more borders; they must include all its present ones."""
        breaks = np.asarray(breaks_degc, np.float64)
        own, table = np.array(self.breaks_degc), self.table()
        segment = np.clip(np.searchsorted(own, breaks[:-1], "right") - 1, 0, len(own) - 2)
        c, h = table[segment], (breaks[:-1] - own[segment])[:, None]
        moved = np.empty_like(c)
        for k in range(POWERS):
            moved[..., k] = sum(
                math.comb(m, k) * c[..., m] * h ** (m - k) for m in range(k, POWERS)
            )
        return Curve.from_ppoly(breaks, np.moveaxis(moved, -1, 0)[::-1])

    def times(self, factor: npt.ArrayLike) -> "Curve":
        """Return the curve with every column multiplied by its `factor` [columns]."""
        if not self.pieces:
            return self
        table = self.table() * np.asarray(factor, np.float64)[..., None]
        return Curve.from_ppoly(self.breaks_degc, np.moveaxis(table, -1, 0)[::-1])

    def plus(self, constant: npt.ArrayLike) -> "Curve":
        """Return the curve with a `constant` [columns] added everywhere."""
        table = self.table()
        table[..., 0] += np.asarray(constant, np.float64)
        return Curve.from_ppoly(self.breaks_degc, np.moveaxis(table, -1, 0)[::-1])


def _place(breaks: Floats, t: Floats) -> tuple[npt.NDArray[np.intp], Any]:
    """Return the segment of each temperature and how far it lies above the segment's border."""
    inside = np.clip(t, breaks[0], breaks[-1])
    segment = np.clip(np.searchsorted(breaks, inside, "right") - 1, 0, len(breaks) - 2)
    return segment, inside - breaks[segment]
