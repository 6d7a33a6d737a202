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

from ahrs_service.calibration.temperature_basis import Basis
from ahrs_service.calibration.thermal_rows import ThermalRows
from ahrs_service.records import Floats, Integers

_RANK: Final = 1e-10
"""Directions of the normal equations below this share of the largest are taken as not seen."""
_ORDERS: Final = ("constant", "linear", "quadratic", "cubic")


class Scale(IntEnum):
    """What of the scale follows temperature: nothing, each axis by itself, the whole matrix."""

    NONE = 0
    AXES = 1
    MATRIX = 2


@dataclass(frozen=True, slots=True)
class Structure:
    """Which curves a fit has: (degree, pieces) of bias and of scale."""

    bias: tuple[int, int] = (0, 1)
    scale: tuple[int, int] = (0, 1)
    kind: Scale = Scale.NONE

    @property
    def size(self) -> int:
        """Coefficients per axis."""
        return sum(self.bias) - 1 + (0, 1, 3)[self.kind] * (sum(self.scale) - 1)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Output axes that share their columns, and so one solution."""
        return ((0,), (1,), (2,)) if self.kind is Scale.AXES else ((0, 1, 2),)

    def inputs(self, axis: int) -> tuple[int, ...]:
        """Axes whose input acts on this axis by the scale's curves."""
        return {Scale.NONE: (), Scale.AXES: (axis,), Scale.MATRIX: (0, 1, 2)}[self.kind]

    @property
    def text(self) -> str:
        """The structure in words."""
        scale = {Scale.NONE: "none", Scale.AXES: "of each axis ", Scale.MATRIX: "and axes "}
        tail = "" if self.kind is Scale.NONE else _order_text(self.scale)
        return f"bias {_order_text(self.bias)}, scale {scale[self.kind]}{tail}"


def _order_text(order: tuple[int, int]) -> str:
    degree, pieces = order
    return _ORDERS[degree] if pieces == 1 else f"{_ORDERS[degree]} in {pieces} pieces"


@dataclass(frozen=True, slots=True)
class Curves:
    """Fitted curves: `bias` [size, 3] and `scale` [size, 9] (row by row) B-spline coefficients.

    `levels` [P, 3] are the u_p, NaN where no row was seen; `covariance` [3, q, q] per axis of the
    weights on the zeroed bases, bias first, for residuals without colour.
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
        """Return c(T) + b(T) u [N, 3] for u = `level_output` [N, 3]."""
        drift: Floats = self.bias_basis.values(temperature_degc) @ self.bias
        if self.structure.kind is not Scale.NONE:
            matrix = (self.scale_basis.values(temperature_degc) @ self.scale).reshape(-1, 3, 3)
            drift = drift + np.einsum("nij,nj->ni", matrix, level_output)
        return drift

    def bias_sigma(self, temperature_degc: Floats, inflation: Floats) -> Floats:
        """Return the standard error of c(T) [N, 3]; `inflation` [3] of the variance per axis."""
        functions = self.bias_basis.zeroed(temperature_degc, self.zero_degc)
        own = self.covariance[:, : functions.shape[1], : functions.shape[1]]
        variance = np.einsum("nq,iqr,nr->ni", functions, own, functions) * inflation
        return np.sqrt(np.maximum(variance, 0.0))


class Problem:
    """Rows of one triad laid out for one structure, so that parts of them are quickly fitted.

    `block` [N] numbers the parts from 0, `level_output` [P, 3] are the u_p that the scale's curves
    multiply; they need to be known to a per cent only, for b is small itself.
    """

    def __init__(
        self,
        rows: ThermalRows,
        structure: Structure,
        zero_degc: float,
        level_output: Floats,
        block: Integers,
    ) -> None:
        self.rows, self.structure, self.zero_degc = rows, structure, zero_degc
        self.bases = tuple(Basis(*rows.span_degc, *o) for o in (structure.bias, structure.scale))
        self._u, self._block = level_output[rows.level], block
        count = int(block.max()) + 1
        self._sums = []
        for axes in structure.groups:
            columns = self._columns(rows.temperature_degc, self._u, axes[0])
            parts = [self._sum(columns, axes, block == n) for n in range(count)]
            self._sums.append(np.stack(parts))

    def _columns(self, temperature_degc: Floats, u: Floats, axis: int) -> Floats:
        bias, scale = (basis.zeroed(temperature_degc, self.zero_degc) for basis in self.bases)
        return np.hstack([bias, *(scale * u[:, [j]] for j in self.structure.inputs(axis))])

    def _sum(self, columns: Floats, axes: tuple[int, ...], own: Integers) -> Floats:
        """Return the products of all columns, outputs and level marks over some rows."""
        marks = np.eye(self.rows.levels)[self.rows.level[own]]
        everything = np.hstack([columns[own], self.rows.output[own][:, list(axes)], marks])
        return np.asarray(everything.T @ everything, np.float64)

    def fit(self, leave_out: int | None = None) -> Curves:
        """Fit all rows but those of one block."""
        size, count = self.structure.size, self.rows.levels
        weights, levels = np.empty((3, size)), np.empty((count, 3))
        covariance = np.empty((3, size, size))
        for axes, parts in zip(self.structure.groups, self._sums, strict=True):
            total = parts.sum(axis=0) - (0.0 if leave_out is None else parts[leave_out])
            solved = _solve(total, size, len(axes))
            for n, axis in enumerate(axes):
                weights[axis], levels[:, axis] = solved.weights[:, n], solved.levels[:, n]
                covariance[axis] = solved.inverse * solved.variance[n]
        return self._curves(weights, levels, covariance)

    def _curves(self, weights: Floats, levels: Floats, covariance: Floats) -> Curves:
        first = self.bases[0].size - 1
        bias = self.bases[0].coefficients_of_zeroed(weights[:, :first].T, self.zero_degc)
        full = np.zeros((self.bases[1].size - 1, 3, 3))
        for axis in range(3):
            used = self.structure.inputs(axis)
            if used:
                full[:, axis, list(used)] = weights[axis, first:].reshape(len(used), -1).T
        flat = full.reshape(-1, 9)
        scale = self.bases[1].coefficients_of_zeroed(flat, self.zero_degc)
        own, other = self.bases
        return Curves(self.structure, self.zero_degc, own, other, bias, scale, levels, covariance)

    def residual(self, curves: Curves, block: int | None = None) -> Floats:
        """Return what the curves leave of the rows [N, 3], or of those of one block.

        Rows of a block are met as in use: temperatures beyond those fitted take the nearest one. A
        level that was not fitted says nothing about its own height: its mean is taken off.
        """
        own = slice(None) if block is None else np.flatnonzero(self._block == block)
        temperature, level = self.rows.temperature_degc[own], self.rows.level[own]
        if block is not None:
            seen = self.rows.temperature_degc[self._block != block]
            temperature = np.clip(temperature, seen.min(), seen.max())
        rest = self.rows.output[own] - curves.drift(temperature, self._u[own])
        heights = curves.levels.copy()
        for number in np.unique(level[np.isnan(heights[level, 0])]):
            heights[number] = rest[level == number].mean(axis=0)
        return rest - heights[level]


@dataclass(frozen=True, slots=True)
class _Solved:
    """Weights [q, m], levels [P, m], (X'X)^-1 [q, q] with the levels fitted too, variances [m]."""

    weights: Floats
    levels: Floats
    inverse: Floats
    variance: Floats


def _solve(products: Floats, size: int, outputs: int) -> _Solved:
    """Least squares from the products of [columns, outputs, level marks], levels eliminated."""
    x, y = slice(0, size), slice(size, size + outputs)
    counts = np.diag(products)[size + outputs :]
    seen = counts > 0.5
    share = np.where(seen, 1.0 / np.where(seen, counts, 1.0), 0.0)
    to_level = products[size + outputs :, : size + outputs]
    centred = products[: size + outputs, : size + outputs] - to_level.T @ (
        share[:, None] * to_level
    )
    length = np.sqrt(np.maximum(np.diag(centred)[x], 1e-300))
    values, vectors = np.linalg.eigh(centred[x, x] / np.outer(length, length))
    kept = values > _RANK * max(values[-1], 1e-300) if size else np.zeros(0, np.bool_)
    turned = vectors[:, kept] / length[:, None]
    inverse = turned / values[kept] @ turned.T
    weights = inverse @ centred[x, y]
    rest = np.diag(centred[y, y]) - np.einsum("qm,qm->m", weights, centred[x, y])
    freedom = counts.sum() - seen.sum() - kept.sum()
    levels = share[:, None] * (to_level[:, y] - to_level[:, x] @ weights)
    levels[~seen] = np.nan
    variance = np.maximum(rest, 0.0) / freedom if freedom > 0 else np.full(outputs, np.inf)
    return _Solved(weights, levels, inverse, variance)
