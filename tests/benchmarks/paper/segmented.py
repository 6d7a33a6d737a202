"""The paper's two thermal models: a table over temperature segments, conventional and improved.

Conventional (Liu et al., eq. (1)): in each segment K and B from six positions in the chamber. It
takes each position for what the table was commanded, so a unit that lies rotated in its mounting,
as the second mounting always does, gets axes rotated by as much.

Improved (eq. (2) and (3)): K and B from six positions on a true table at room temperature; in the
chamber only what the output moved since room temperature counts, in like position, as a quadratic
of the output per segment, E_T = a N^2 + b N + c. How the unit lies does not enter.

Segments jump at their borders, as the paper's do, or meet there (`continuous`).
"""

import numpy as np

from ahrs_service.calibration.thermal.basis import Basis, segments
from ahrs_service.calibration.thermal.drift_records import curve_of, matrix_rows
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth_choice import SEGMENT_DEGC
from ahrs_service.calibration.triad import vector
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats
from ahrs_service.sensor.parameters import TriadCalibration


def segment_basis(rows: ThermalRows, continuous: bool, width_degc: float = SEGMENT_DEGC) -> Basis:
    """Return lines (continuous) or steps over the rows' temperatures, segments of about `width`."""
    low, high = rows.span_degc
    return Basis(low, high, int(continuous), segments(low, high, width_degc))


def fit_conventional(
    rows: ThermalRows, nominal: Floats, room_degc: float, continuous: bool = True
) -> TriadCalibration:
    """Fit K(T) and B(T) (Liu et al., eq. (1)); `nominal` [N, 3] what the table was commanded."""
    basis = segment_basis(rows, continuous)
    functions = basis.values(rows.temperature_degc)
    inputs = np.hstack([nominal, np.ones((len(rows), 1))])
    design = (functions[:, :, None] * inputs[:, None, :]).reshape(len(rows), -1)
    weights = _solve(design, rows.output, "six positions in each temperature segment")
    table = np.moveaxis(weights.reshape(basis.size, 4, 3), 1, 2)
    room = np.einsum("k,kij->ij", basis.values(np.array([room_degc]))[0], table)
    drift = (table - room).reshape(basis.size, 12)
    matrix = [4 * i + j for i in range(3) for j in range(3)]
    return TriadCalibration(
        matrix=matrix_rows(room[:, :3]),
        bias=vector(room[:, 3]),
        c=curve_of(basis, drift[:, 3::4]),
        matrix_drift=curve_of(basis, drift[:, matrix]),
        model="conventional",
    )


def fit_improved(
    rows: ThermalRows, matrix: Floats, bias: Floats, room_degc: float, continuous: bool = True
) -> TriadCalibration:
    """Fit E_T (Liu et al., eq. (3)); `matrix` K and `bias` B are those of room temperature."""
    basis = segment_basis(rows, continuous)
    moved = rows.output - _room_outputs(rows, room_degc)[rows.level]
    # A table that jumps is zero at room temperature by its fit: a mean over the whole segment.
    if continuous:
        functions = basis.zeroed(rows.temperature_degc, room_degc)
    else:
        functions = basis.values(rows.temperature_degc)
    parts = []
    for axis in range(3):
        powers = rows.output[:, [axis]] ** np.arange(3)
        design = (functions[:, :, None] * powers[:, None, :]).reshape(len(rows), -1)
        weights = _solve(design, moved[:, axis], "positions or rates along each axis, both ways")
        parts.append(weights.reshape(-1, 3))
    tables = list(np.moveaxis(np.stack(parts, axis=2), 1, 0))
    if continuous:
        tables = [basis.coefficients_of_zeroed(table, room_degc) for table in tables]
    c, b, a = (curve_of(basis, table) for table in tables)
    return TriadCalibration(
        matrix=matrix_rows(matrix), bias=vector(bias), a=a, b=b, c=c, model="improved"
    )


def _room_outputs(rows: ThermalRows, room_degc: float) -> Floats:
    """Return the mean output [P, 3] of each level within half a segment of room temperature."""
    near = np.abs(rows.temperature_degc - room_degc) < 0.5 * SEGMENT_DEGC
    means = np.empty((rows.levels, 3))
    for level in range(rows.levels):
        own = near & (rows.level == level)
        if not own.any():
            raise CalibrationError(
                f"position {level} was not held within {0.5 * SEGMENT_DEGC:g} degC of "
                f"{room_degc:g} degC: let the chamber run through room temperature in each"
            )
        means[level] = rows.output[own].mean(axis=0)
    return means


def _solve(design: Floats, output: Floats, needed: str) -> Floats:
    length = np.linalg.norm(design, axis=0)
    if not (length > 0.0).all():
        raise CalibrationError(f"a temperature segment is empty: the run needs {needed}")
    weights, _, rank, _ = np.linalg.lstsq(design / length, output, rcond=1e-9)
    if rank < design.shape[1]:
        raise CalibrationError(f"the run does not tell the coefficients apart: it needs {needed}")
    return np.asarray((weights.T / length).T, np.float64)
