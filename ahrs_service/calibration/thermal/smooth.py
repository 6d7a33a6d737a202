"""The smooth thermal fit: curves as flexible as held-out data bear, and the thermometer's lag.

First the structures of the axes at the thermometer's own temperature, then the lag, then the
structures once more at the element temperature.
"""

from dataclasses import dataclass, replace

import numpy as np

from ahrs_service.calibration.thermal.coloured import inflation
from ahrs_service.calibration.thermal.drift_records import columns_of, matrix_rows, sum_of
from ahrs_service.calibration.thermal.lag import Lag, estimate_lag
from ahrs_service.calibration.thermal.rows import ThermalRows
from ahrs_service.calibration.thermal.smooth_choice import Choice, level_outputs
from ahrs_service.calibration.thermal.smooth_drift import AxisCurves, AxisProblem, Structure
from ahrs_service.calibration.triad import vector
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import TriadCalibration

Axes = tuple[AxisCurves, AxisCurves, AxisCurves]
Structures = tuple[Structure, Structure, Structure]


@dataclass(frozen=True, slots=True)
class SmoothFit:
    """Curves of the three axes, lag, and how well they do.

    `rows` at the element temperature; `residual` [N, 3] of all rows; `inflation` [3] of the
    variance by the residual's colour.
    """

    rows: ThermalRows
    axes: Axes
    lag: Lag
    residual: Floats
    inflation: Floats

    def bias_sigma(self, temperature_degc: Floats) -> Floats:
        """Return the standard error of the bias's drift [N, 3], colour counted in."""
        sigmas = [axis.bias_sigma(temperature_degc) for axis in self.axes]
        return np.stack(sigmas, axis=1) * np.sqrt(self.inflation)

    @property
    def structures(self) -> Structures:
        """The structures of the axes."""
        x, y, z = (axis.structure for axis in self.axes)
        return x, y, z


def fit_smooth(rows: ThermalRows, zero_degc: float, with_lag: bool = True) -> SmoothFit:
    """Fit curves and lag to `rows`; all drift is zero at `zero_degc`, which must be inside."""
    structures, rms = choose(rows, zero_degc)
    lag, acting = Lag(), rows
    if with_lag:
        lag = estimate_lag(rows, structures, zero_degc, level_outputs(rows))
    if lag.is_reported:
        lagged = rows.at_element(lag.lag_s)
        others, lagged_rms = choose(lagged, zero_degc, structures)
        # What the residual of the fit speaks for must hold for rows held out, too.
        if np.log(lagged_rms / rms).sum() < 0.0:
            structures, acting = others, lagged
        else:
            lag = replace(lag, lag_s=0.0, is_reported=False)
    curves, residual = fit_curves(acting, structures, zero_degc)
    colour = np.array([inflation(residual[:, i]) for i in range(3)])
    return SmoothFit(acting, curves, lag, residual, colour)


def choose(
    rows: ThermalRows, zero_degc: float, start: Structures | None = None
) -> tuple[Structures, Floats]:
    """Return the structures that held-out blocks speak for, and the RMS residual there [3].

    From `start` one iteration of the choice is enough, from nothing it takes two.
    """
    chosen, rms = [], []
    for axis in range(3):
        choice = Choice(rows, axis, zero_degc)
        begin, passes = (Structure(), 2) if start is None else (start[axis], 1)
        chosen.append(choice.structure(begin, passes))
        rms.append(choice.rms(chosen[-1]))
    x, y, z = chosen
    return (x, y, z), np.maximum(rms, 1e-300)


def fit_curves(rows: ThermalRows, structures: Structures, zero_degc: float) -> tuple[Axes, Floats]:
    """Return the curves of given structures and what they leave of the rows [N, 3].

    The rows are fitted twice: the levels' means of first sight carry some drift, the fitted do not.
    """
    levels = level_outputs(rows)
    for _ in range(2):
        problems = [
            AxisProblem(rows, n, one, zero_degc, levels) for n, one in enumerate(structures)
        ]
        curves = [problem.fit() for problem in problems]
        levels = np.stack([one.levels for one in curves], axis=1)
    rests = [problem.residual(one) for problem, one in zip(problems, curves, strict=True)]
    x, y, z = curves
    return (x, y, z), np.stack(rests, axis=1)


def smooth_calibration(
    fitted: Axes, matrix: Floats, bias: Floats, lag_s: float = 0.0, model: str = "smooth"
) -> TriadCalibration:
    """Return the triad's calibration for `matrix` K and `bias` B of the zero temperature.

    Of N = u + c(T) + b(T) u with u = K A + B follow dK = b K and the drift c + b B.
    """
    scales = [axis.scale for axis in fitted]
    drift = columns_of([(axis.bias_basis, axis.bias[:, None]) for axis in fitted])
    matrix_drift = Curve()
    if any(np.any(scale) for scale in scales):
        bases = [axis.scale_basis for axis in fitted]
        matrix_drift = columns_of(
            [(basis, scale @ matrix) for basis, scale in zip(bases, scales, strict=True)]
        )
        lever = [(basis, scale @ bias[:, None]) for basis, scale in zip(bases, scales, strict=True)]
        drift = sum_of(drift, columns_of(lever))
    return TriadCalibration(
        matrix=matrix_rows(matrix),
        bias=vector(bias),
        c=drift,
        matrix_drift=matrix_drift,
        thermal_lag_s=lag_s,
        model=model,
    )
