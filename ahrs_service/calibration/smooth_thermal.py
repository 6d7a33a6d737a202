"""The smooth thermal fit: curves as flexible as held-out data bear, and the thermometer's lag.

First the structures of the axes at the thermometer's own temperature, then the lag, then the
structures once more at the temperature that acts.
"""

from dataclasses import dataclass, replace

import numpy as np

from ahrs_service.calibration.coloured import inflation
from ahrs_service.calibration.smooth_choice import Choice, level_outputs
from ahrs_service.calibration.smooth_drift import AxisCurves, AxisProblem, Structure
from ahrs_service.calibration.thermal_lag import Lag, estimate_lag
from ahrs_service.calibration.thermal_records import columns_of, matrix_rows, sum_of
from ahrs_service.calibration.thermal_rows import ThermalRows
from ahrs_service.calibration.triad import vector
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import TriadCalibration

Axes = tuple[AxisCurves, AxisCurves, AxisCurves]


@dataclass(frozen=True, slots=True)
class SmoothFit:
    """Curves of the three axes, lag, and how well they do.

    `rows` at the temperature that acts; `held_out_before` [3] RMS of held-out rows about their
    level, `held_out_after` [3] with the curves; `residual` [N, 3] of all rows; `inflation` [3] of
    the variance by the residual's colour.
    """

    rows: ThermalRows
    axes: Axes
    lag: Lag
    held_out_before: Floats
    held_out_after: Floats
    residual: Floats
    inflation: Floats

    def bias_sigma(self, temperature_degc: Floats) -> Floats:
        """Return the standard error of the bias's drift [N, 3], colour counted in."""
        sigmas = [axis.bias_sigma(temperature_degc) for axis in self.axes]
        return np.stack(sigmas, axis=1) * np.sqrt(self.inflation)


def fit_smooth(rows: ThermalRows, zero_degc: float, with_lag: bool = True) -> SmoothFit:
    """Fit curves and lag to `rows`; all drift is zero at `zero_degc`, which must be inside."""
    chosen = _choose(rows, zero_degc, (Structure(),) * 3, passes=2)
    lag = Lag()
    if with_lag:
        lag = estimate_lag(rows, chosen.structures, zero_degc, level_outputs(rows))
    if lag.is_told:
        acting = rows.at_element(lag.lag_s)
        lagged = _choose(acting, zero_degc, chosen.structures, passes=1)
        # What the residual of the fit speaks for must hold for rows held out, too.
        if np.log(lagged.after / chosen.after).sum() < 0.0:
            chosen = lagged
        else:
            lag = replace(lag, lag_s=0.0, is_told=False)
    curves, residual = _fitted(chosen.rows, chosen.structures, zero_degc)
    colour = np.array([inflation(residual[:, i]) for i in range(3)])
    return SmoothFit(chosen.rows, curves, lag, chosen.before, chosen.after, residual, colour)


@dataclass(frozen=True, slots=True)
class _Chosen:
    """Rows, the structures chosen for the axes, RMS held-out residual [3] without and with them."""

    rows: ThermalRows
    structures: tuple[Structure, ...]
    before: Floats
    after: Floats


def _choose(
    rows: ThermalRows, zero_degc: float, start: tuple[Structure, ...], passes: int
) -> _Chosen:
    choices = [Choice(rows, axis, zero_degc) for axis in range(3)]
    structures = tuple(
        one.structure(begin, passes) for one, begin in zip(choices, start, strict=True)
    )
    before = [choice.rms(Structure()) for choice in choices]
    after = [choice.rms(one) for choice, one in zip(choices, structures, strict=True)]
    return _Chosen(rows, structures, np.array(before), np.maximum(after, 1e-300))


def _fitted(
    rows: ThermalRows, structures: tuple[Structure, ...], zero_degc: float
) -> tuple[Axes, Floats]:
    """Fit all rows twice: the levels' means of first sight carry some drift, the fitted do not."""
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


def smooth_calibration(fit: SmoothFit, matrix: Floats, bias: Floats) -> TriadCalibration:
    """Return the triad's calibration for `matrix` K and `bias` B of the zero temperature.

    Of N = u + c(T) + b(T) u with u = K A + B follow dK = b K and the drift c + b B.
    """
    scales = [axis.scale for axis in fit.axes]
    drift = columns_of([(axis.bias_basis, axis.bias[:, None]) for axis in fit.axes])
    matrix_drift = Curve()
    if any(np.any(scale) for scale in scales):
        bases = [axis.scale_basis for axis in fit.axes]
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
        thermal_lag_s=fit.lag.lag_s,
        model="smooth",
    )
