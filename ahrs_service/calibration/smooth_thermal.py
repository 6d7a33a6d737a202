"""The smooth thermal fit: curves as flexible as held-out data bear, and the thermometer's lag.

First the curves' structure at the thermometer's own temperature, then the lag, then the structure
once more at the temperature that acts.
"""

from dataclasses import dataclass

import numpy as np

from ahrs_service.calibration.coloured import inflation
from ahrs_service.calibration.smooth_choice import FOLDS, HeldOut, choose_structure, level_outputs
from ahrs_service.calibration.smooth_drift import Curves, Problem, Scale
from ahrs_service.calibration.thermal_lag import Lag, estimate_lag
from ahrs_service.calibration.thermal_records import curve_of, matrix_rows, sum_of
from ahrs_service.calibration.thermal_rows import ThermalRows
from ahrs_service.calibration.triad import vector
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import TriadCalibration


@dataclass(frozen=True, slots=True)
class SmoothFit:
    """What was found: curves, lag, held-out figures, residual [N, 3] of all rows.

    `inflation` [3] of the variance by the residual's colour.
    """

    rows: ThermalRows
    curves: Curves
    lag: Lag
    held_out: HeldOut
    residual: Floats
    inflation: Floats


def fit_smooth(
    rows: ThermalRows, zero_degc: float, folds: int = FOLDS, with_lag: bool = True
) -> SmoothFit:
    """Fit curves and lag to `rows`; all drift is zero at `zero_degc`, which must be inside."""
    structure, _ = choose_structure(rows, zero_degc, folds)
    lag = Lag()
    if with_lag:
        lag = estimate_lag(rows, structure, zero_degc, level_outputs(rows))
    acting = rows.at_element(lag.lag_s)
    structure, validated = choose_structure(acting, zero_degc, folds)
    problem = Problem(
        acting, structure, zero_degc, level_outputs(acting), np.zeros(len(rows), np.int64)
    )
    curves = problem.fit()
    # The levels' means of first sight carry some drift; the fitted ones do not.
    problem = Problem(acting, structure, zero_degc, curves.levels, np.zeros(len(rows), np.int64))
    curves = problem.fit()
    residual = problem.residual(curves)
    colour = np.array([inflation(residual[:, i]) for i in range(3)])
    return SmoothFit(acting, curves, lag, validated, residual, colour)


def smooth_calibration(fit: SmoothFit, matrix: Floats, bias: Floats) -> TriadCalibration:
    """Return the triad's calibration for `matrix` K and `bias` B of the zero temperature.

    Of N = u + c(T) + b(T) u with u = K A + B follow dK = b K and the drift c + b B.
    """
    curves = fit.curves
    drift, matrix_drift = curve_of(curves.bias_basis, curves.bias), Curve()
    if curves.structure.kind is not Scale.NONE:
        scale = curves.scale.reshape(-1, 3, 3)
        matrix_drift = curve_of(curves.scale_basis, (scale @ matrix).reshape(-1, 9))
        drift = sum_of(drift, curve_of(curves.scale_basis, scale @ bias))
    return TriadCalibration(
        matrix=matrix_rows(matrix),
        bias=vector(bias),
        c=drift,
        matrix_drift=matrix_drift,
        thermal_lag_s=fit.lag.lag_s,
        model="smooth",
    )
