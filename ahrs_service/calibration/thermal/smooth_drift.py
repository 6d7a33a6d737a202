"""The smooth thermal model: how its curves are fitted, and which curves the data can bear.

The output of one triad while its input stays at level p, with u_p the output that this level would
give at the zero temperature T0:

    N = u_p + c(T) + b(T) u_p        c(T0) = 0, b(T0) = 0

c [3] is the drift of bias, b [3, 3] that of scale (its diagonal) and axes. The levels u_p are
fitted too, so nobody needs to know how the unit lay in the chamber: the second mounting, which
costs the conventional calibration 30 mg (Liu et al., sec. 2.2.1), does not enter.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
import scipy.linalg

from ahrs_service.calibration.thermal.basis import Basis
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.records import Floats, Integers

_RANK: Final = 1e-10
"""Directions of the normal equations below this share of the largest are taken as not seen."""
_ORDERS: Final = ("constant", "linear", "quadratic", "cubic")

Order = tuple[int, int]
"""Degree and pieces of a curve."""


class Scale(IntEnum):
    """What of an axis's scale follows temperature: nothing, its own input's, that of all inputs."""

    NONE = 0
    OWN = 1
    ALL = 2


@dataclass(frozen=True, slots=True)
class Structure:
    """Which curves the fit of one axis has."""

    bias: Order = (0, 1)
    scale: Order = (0, 1)
    kind: Scale = Scale.NONE

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return sum(self.bias) - 1 + (0, 1, 3)[self.kind] * (sum(self.scale) - 1)

    def inputs(self, axis: int) -> tuple[int, ...]:
        """Inputs that act on the axis by the scale's curves."""
        return {Scale.NONE: (), Scale.OWN: (axis,), Scale.ALL: (0, 1, 2)}[self.kind]

    @property
    def text(self) -> str:
        """The structure in words."""
        bias = f"bias {_order_text(self.bias)}"
        if self.kind is Scale.NONE:
            return bias
        scale = "scale and axes" if self.kind is Scale.ALL else "scale"
        return f"{bias}, {scale} {_order_text(self.scale)}"


def _order_text(order: Order) -> str:
    degree, pieces = order
    return _ORDERS[degree] if pieces == 1 else f"{_ORDERS[degree]} in {pieces} pieces"


@dataclass(frozen=True, slots=True)
class AxisCurves:
    """Fitted curves of one axis: B-spline coefficients `bias` [size] and `scale` [size, 3].

    `levels` [P] are the u_p, NaN where no row was seen; `covariance` [q, q] that of the weights on
    the zeroed bases, bias first, for a residual without colour.
    """

    structure: Structure
    zero_degc: float
    bias_basis: Basis
    scale_basis: Basis
    bias: Floats
    scale: Floats
    levels: Floats
    covariance: Floats

    def drift(self, temperature_degc: Floats, level_output: Floats) -> Floats:
        """Return c(T) + b(T) u [N] for u = `level_output` [N, 3]."""
        drift: Floats = self.bias_basis.values(temperature_degc) @ self.bias
        if self.structure.kind is not Scale.NONE:
            row = self.scale_basis.values(temperature_degc) @ self.scale
            drift = drift + np.einsum("nj,nj->n", row, level_output)
        return drift

    def bias_sigma(self, temperature_degc: Floats) -> Floats:
        """Return the standard error of c(T) [N] for a residual without colour."""
        functions = self.bias_basis.zeroed(temperature_degc, self.zero_degc)
        count = functions.shape[1]
        variance = np.einsum("nq,qr,nr->n", functions, self.covariance[:count, :count], functions)
        return np.sqrt(np.maximum(variance, 0.0))


class AxisProblem:
    """The rows' output along one axis laid out for one structure, to fit parts of them quickly.

    `fold` [N] numbers the parts from 0, `level_output` [P, 3] are the u_p that the scale's curves
    multiply; they need to be known to a per cent only, for b is small itself.
    """

    def __init__(
        self,
        rows: ThermalRows,
        axis: int,
        structure: Structure,
        zero_degc: float,
        level_output: Floats,
        fold: Integers | None = None,
    ) -> None:
        self.rows, self.axis, self.structure, self.zero_degc = rows, axis, structure, zero_degc
        self._bias = Basis(*rows.span_degc, *structure.bias)
        self._scale = Basis(*rows.span_degc, *structure.scale)
        self._u = level_output[rows.level]
        self._fold = np.zeros(len(rows), np.int64) if fold is None else fold
        self._columns = self._design(rows.temperature_degc, self._u)
        marks = np.eye(rows.levels)[rows.level]
        everything = np.hstack([self._columns, rows.output[:, [axis]], marks])
        self._products = np.stack(
            [_product(everything[self._fold == n]) for n in range(int(self._fold.max()) + 1)]
        )

    def _design(self, temperature_degc: Floats, u: Floats) -> Floats:
        """Return the columns [N, size]: the bias's functions, then the scale's times inputs."""
        parts = [self._bias.zeroed(temperature_degc, self.zero_degc)]
        if self.structure.kind is not Scale.NONE:
            scale = self._scale.zeroed(temperature_degc, self.zero_degc)
            parts += [scale * u[:, [j]] for j in self.structure.inputs(self.axis)]
        return np.hstack(parts)

    def fit(self) -> AxisCurves:
        """Fit all rows."""
        total = self._products.sum(axis=0)
        weights, levels, covariance = _solve(total, self.structure.size)
        count = self._bias.size - 1
        full = np.zeros((self._scale.size - 1, 3))
        used = self.structure.inputs(self.axis)
        if used:
            full[:, list(used)] = weights[count:].reshape(len(used), -1).T
        return AxisCurves(
            structure=self.structure,
            zero_degc=self.zero_degc,
            bias_basis=self._bias,
            scale_basis=self._scale,
            bias=self._bias.coefficients_of_zeroed(weights[:count, None], self.zero_degc)[:, 0],
            scale=self._scale.coefficients_of_zeroed(full, self.zero_degc),
            levels=levels,
            covariance=covariance,
        )

    def residual(self, curves: AxisCurves) -> Floats:
        """Return what the curves leave of the rows [N]."""
        rest = self.rows.output[:, self.axis] - curves.drift(self.rows.temperature_degc, self._u)
        return rest - curves.levels[self.rows.level]

    def held_out(self) -> Floats:
        """Return what is left of each row [N] by a fit that has not seen its fold.

        The rows are met as in use: temperatures beyond those fitted take the nearest one. A level
        that was not fitted says nothing about its own height: its mean is taken off.
        """
        rest = np.empty(len(self.rows))
        total, temperature = self._products.sum(axis=0), self.rows.temperature_degc
        for fold, product in enumerate(self._products):
            out = np.flatnonzero(self._fold == fold)
            seen, level = temperature[self._fold != fold], self.rows.level[out]
            weights, heights, _ = _solve(total - product, self.structure.size)
            columns = self._columns[out]
            inside = np.clip(temperature[out], seen.min(), seen.max())
            far = np.flatnonzero(inside != temperature[out])
            if len(far):
                columns[far] = self._design(inside[far], self._u[out[far]])
            part = self.rows.output[out, self.axis] - columns @ weights
            for number in np.unique(level[np.isnan(heights[level])]):
                heights[number] = part[level == number].mean()
            rest[out] = part - heights[level]
        return rest


def _product(columns: Floats) -> Floats:
    product: Floats = columns.T @ columns
    return product


def _solve(products: Floats, size: int) -> tuple[Floats, Floats, Floats]:
    """Least squares from the products of [columns, output, level marks], levels eliminated.

    Returns weights [size], levels [P], covariance [size, size] of the weights.
    """
    counts = np.diag(products)[size + 1 :]
    seen = counts > 0.5
    share = np.where(seen, 1.0 / np.where(seen, counts, 1.0), 0.0)
    to_level = products[size + 1 :, : size + 1]
    centred = products[: size + 1, : size + 1] - to_level.T @ (share[:, None] * to_level)
    length = np.sqrt(np.maximum(np.diag(centred)[:size], 1e-300))
    inverse = _inverse(centred[:size, :size] / np.outer(length, length))
    inverse /= np.outer(length, length)
    weights = inverse @ centred[:size, size]
    freedom = counts.sum() - seen.sum() - size
    square = max(float(centred[size, size] - weights @ centred[:size, size]), 0.0)
    levels = share * (to_level[:, size] - to_level[:, :size] @ weights)
    levels[~seen] = np.nan
    return weights, levels, inverse * (square / max(freedom, 1.0))


def _inverse(matrix: Floats) -> Floats:
    """Inverse of a symmetric matrix; directions that no row has seen are left at zero."""
    if not len(matrix):
        return matrix
    factor, failed = scipy.linalg.lapack.dpotrf(matrix, lower=1)
    if not failed and np.diag(factor).min() ** 2 > _RANK:
        lower, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
        return np.asarray(np.tril(lower) + np.tril(lower, -1).T, np.float64)
    values, vectors = np.linalg.eigh(matrix)
    kept = values > _RANK * max(float(values[-1]), 1e-300)
    return np.asarray(vectors[:, kept] / values[kept] @ vectors[:, kept].T, np.float64)
