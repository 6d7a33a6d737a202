"""From fitted numbers to the records of a calibration."""

import numpy as np

from ahrs_service.calibration.thermal.basis import Basis
from ahrs_service.calibration.triad import vector
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import Matrix


def matrix_rows(values: Floats) -> Matrix:
    """Return a matrix [3, 3] as the records hold it."""
    first, second, third = (vector(row) for row in values)
    return first, second, third


def curve_of(basis: Basis, coefficients: Floats) -> Curve:
    """Return the curve of B-spline `coefficients` [size, M]."""
    return Curve.from_ppoly(basis.breaks, basis.polynomials(coefficients))


def columns_of(parts: list[tuple[Basis, Floats]]) -> Curve:
    """Return one curve whose columns are those of `parts`, on the borders of all."""
    curves = [curve_of(basis, coefficients) for basis, coefficients in parts]
    breaks = sorted({border for curve in curves for border in curve.breaks_degc})
    tables = np.concatenate([curve.on(breaks).table() for curve in curves], axis=1)
    return Curve.from_ppoly(breaks, tables.transpose(2, 0, 1)[::-1])


def sum_of(one: Curve, other: Curve) -> Curve:
    """Return the sum of two curves of one span, on the borders of both."""
    breaks = sorted({*one.breaks_degc, *other.breaks_degc})
    total = one.on(breaks).table() + other.on(breaks).table()
    return Curve.from_ppoly(breaks, total.transpose(2, 0, 1)[::-1])
