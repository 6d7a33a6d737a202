"""Gyros from a rate table: steady known rates, or an encoder that gives the rate at every instant.

The unit is mounted in several ways, so that the table's axis has another direction in it each
time. Steady rates: the means of the plateaus are N = K A + B (Liu et al., sec. 3). An encoder: K, B
and how late each recording is against its encoder, all at once; a lag left in would look like an
error of attitude that follows the rate (Liu et al., sec. 5: 2.6 deg at 200 deg/s are 13 ms).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.least_squares import gauss_newton
from ahrs_service.calibration.poses import Booleans, Stillness, find_runs, windows_of
from ahrs_service.calibration.triad import TriadFit, check_matrix, fit_triad, rms
from ahrs_service.calibration.verdict import TriadVerdict, Vector
from ahrs_service.errors import CalibrationError
from ahrs_service.records import Floats

_LARGEST_MISS: Final = 0.2
"""A choice: seven times a gyro's scale tolerance of 3 %; then the rate is another."""
_LEAST_RATE_RAD_S: Final = 0.05
"""A choice: 3 deg/s may be missed at any rate: room for the gyro's bias."""
_SAME_RATE_RAD_S: Final = 0.02  # A choice: 1 deg/s; a plateau ends where its mean moves by more
_LARGEST_CONDITION: Final = 20.0
"""A choice: the third direction lies some 3 deg (1/20) or more off the plane of two."""
_LEAST_SAMPLES: Final = 100
"""A choice: one second at 100 Hz; the unknowns are thirteen for one recording."""
_LAG_STEP_S: Final = 0.01  # A choice: grid of the first guess; the fit finds the lag itself
LARGEST_LAG_S: Final = 0.5
"""Furthest that the encoder's clock may be off [s]."""
_ADVICE: Final = (
    "mount the unit with its x, y and z axis along the table's in turn, and record each"
)


@dataclass(frozen=True, slots=True)
class Mounting:
    """One recording on the table: the table's axis in the unit, and the reference.

    `axis` [3] of any length, positive rates turn about it by the right hand; `time_s` [M] [s] on
    the clock of the columns but for a constant lag, `rate_rad_s` [M] [rad/s] of the table.
    """

    axis: Vector
    columns: ImuColumns
    time_s: Floats
    rate_rad_s: Floats

    @property
    def unit(self) -> Floats:
        """The axis with length 1 [3]."""
        return np.array(self.axis) / np.linalg.norm(self.axis)


def check_axes(axes: Floats) -> None:
    """Raise CalibrationError where the mountings' axes [M, 3] do not span all directions."""
    values = np.linalg.svd(axes, compute_uv=False) if len(axes) else np.zeros(1)
    if len(values) < 3 or values[2] * _LARGEST_CONDITION < values[0]:
        raise CalibrationError(
            f"{len(axes)} mountings do not turn the unit about three directions: {_ADVICE}"
        )


def plateaus(
    columns: ImuColumns, axis: Vector, rates_rad_s: Floats, stillness: Stillness | None = None
) -> tuple[Floats, Floats]:
    """Return true and measured rates [M, 3] of the steady turns and rests of one recording.

    `rates_rad_s` [R] are those that the table was set to; each plateau is the next of them.
    CalibrationError where one is a fifth off, or none is found.
    """
    unit = np.array(axis) / np.linalg.norm(axis)
    windows = windows_of(columns, stillness)
    steady = np.all(windows.gyro_scatter <= windows.gyro_limit, axis=1)
    known = np.append(rates_rad_s, 0.0)
    truth, measured = [], []
    for first, last in find_runs(steady, windows.gyro, _SAME_RATE_RAD_S):
        if last - first < 3:
            continue
        mean = windows.gyro[first + 1 : last - 1].mean(axis=0)
        along = float(mean @ unit)
        rate = float(known[np.argmin(np.abs(known - along))])
        miss = float(np.linalg.norm(mean - rate * unit))
        if miss > max(_LARGEST_MISS * abs(rate), _LEAST_RATE_RAD_S):
            given = ", ".join(f"{r:g}" for r in np.degrees(known))
            size = math.degrees(float(np.linalg.norm(mean)))
            raise CalibrationError(
                f"a steady turn of {size:.1f} deg/s, {math.degrees(along):.1f} deg/s of it about "
                f"the table's axis, is none of those given ({given} deg/s): check the "
                "axis, its sign, and the rates"
            )
        truth.append(rate * unit)
        measured.append(mean)
    if not any(np.any(row) for row in truth):
        raise CalibrationError(
            "no steady turn is in the recording: let the table keep each rate for three seconds"
        )
    return np.reshape(truth, (-1, 3)), np.reshape(measured, (-1, 3))


def fit_plateaus(truth: Floats, measured: Floats) -> TriadFit:
    """Return K and B of the gyros from steady rates [M, 3] of all mountings."""
    check_axes(truth)
    fit = fit_triad(np.concatenate([truth, np.ones((len(truth), 1))], axis=1), measured)
    check_matrix("gyro", fit, "the axis given for a mounting is not the one it had; check them")
    return fit


def judge_plateaus(truth: Floats, measured: Floats, fit: TriadFit) -> TriadVerdict:
    """Return the figures of the fit; each plateau is predicted by the others."""
    held_out = np.empty_like(truth)
    design = np.concatenate([truth, np.ones((len(truth), 1))], axis=1)
    for k in range(len(truth)):
        rest = np.arange(len(truth)) != k
        held_out[k] = fit_triad(design[rest], measured[rest]).compensate(measured[k : k + 1])[0]
    return _verdict(fit, truth, measured, truth, measured, held_out)


def fit_encoder(mountings: tuple[Mounting, ...]) -> tuple[TriadFit, Floats]:
    """Return K and B of the gyros, and how late each recording is [M] [s].

    Positive: the gyros' time stamps are later than the encoder's for the same moment.
    """
    check_axes(np.stack([mounting.unit for mounting in mountings]))
    start = np.concatenate([np.eye(3).ravel(), np.zeros(3), [_lag(m) for m in mountings]])
    fit = gauss_newton(_encoder_residuals(mountings), start)
    covariance = fit.covariance[:12, :12]
    matrix = fit.parameters[:9].reshape(3, 3)
    triad = TriadFit(matrix, fit.parameters[9:12], covariance, fit.sigma, fit.condition)
    check_matrix("gyro", triad, "the axis given for a mounting is not the one it had; check them")
    return triad, fit.parameters[12:]


def judge_encoder(mountings: tuple[Mounting, ...], fit: TriadFit, lags_s: Floats) -> TriadVerdict:
    """Return the figures of the fit; the second half of each recording is predicted by the first.

    The lag is taken out before and after, so that what is shown is the gain of K and B.
    """
    first, _ = fit_encoder(tuple(_half(mounting, 0) for mounting in mountings))
    truth, measured = _aligned(mountings, lags_s)
    later = tuple(_half(mounting, 1) for mounting in mountings)
    unseen_truth, unseen = _aligned(later, lags_s)
    return _verdict(fit, truth, measured, unseen_truth, unseen, first.compensate(unseen))


def _verdict(
    fit: TriadFit,
    truth: Floats,
    measured: Floats,
    unseen_truth: Floats,
    unseen: Floats,
    predicted: Floats,
) -> TriadVerdict:
    return TriadVerdict(
        triad="gyro",
        unit="rad/s",
        count=len(truth),
        rms_before=rms(measured - truth),
        rms_after=rms(fit.compensate(measured) - truth),
        condition=fit.condition,
        standard_errors=fit.standard_errors(),
        held_out_before=float(np.sqrt(np.mean((unseen - unseen_truth) ** 2))),
        held_out_after=float(np.sqrt(np.mean((predicted - unseen_truth) ** 2))),
    )


def _encoder_residuals(
    mountings: tuple[Mounting, ...],
) -> Callable[[Floats], tuple[Floats, Floats]]:
    """Return the function from K by rows, B and the lags to N - K u r(t - lag) - B, and J."""
    splines = [CubicSpline(m.time_s, m.rate_rad_s) for m in mountings]
    inside = [_inside(m) for m in mountings]

    def evaluate(parameters: Floats) -> tuple[Floats, Floats]:
        matrix, bias = parameters[:9].reshape(3, 3), parameters[9:12]
        residuals, jacobians = [], []
        for k, (m, spline, keep) in enumerate(zip(mountings, splines, inside, strict=True)):
            then_s = m.columns.time_s[keep] - parameters[12 + k]
            rate, slope = spline(then_s), spline(then_s, 1)
            response = matrix @ m.unit
            residuals.append(m.columns.gyro_rad_s[keep] - rate[:, None] * response - bias)
            jacobian = np.zeros((len(rate), 3, len(parameters)))
            for axis in range(3):
                jacobian[:, axis, 3 * axis : 3 * axis + 3] = -rate[:, None] * m.unit
                jacobian[:, axis, 9 + axis] = -1.0
                jacobian[:, axis, 12 + k] = slope * response[axis]
            jacobians.append(jacobian.reshape(-1, len(parameters)))
        return np.concatenate([r.ravel() for r in residuals]), np.concatenate(jacobians)

    return evaluate


def _inside(mounting: Mounting) -> Booleans:
    """Return which samples [N] lie within the reference, whatever the lag."""
    time_s, reference_s = mounting.columns.time_s, mounting.time_s
    keep: Booleans = (time_s > reference_s[0] + LARGEST_LAG_S) & (
        time_s < reference_s[-1] - LARGEST_LAG_S
    )
    if keep.sum() < _LEAST_SAMPLES:
        raise CalibrationError(
            f"the reference covers {reference_s[0]:.1f} to {reference_s[-1]:.1f} s, the recording "
            f"{time_s[0]:.1f} to {time_s[-1]:.1f} s: give the reference on the recording's clock"
        )
    return keep


def _lag(mounting: Mounting) -> float:
    """Return about how late the gyros are [s]: the shift at which they follow the encoder best."""
    keep = _inside(mounting)
    time_s = mounting.columns.time_s[keep]
    along = mounting.columns.gyro_rad_s[keep] @ mounting.unit
    spline = CubicSpline(mounting.time_s, mounting.rate_rad_s)
    lags = np.arange(-LARGEST_LAG_S, LARGEST_LAG_S, _LAG_STEP_S)
    misfits = [float(np.std(along - spline(time_s - lag))) for lag in lags]
    best = int(np.argmin(misfits))
    if best in (0, len(lags) - 1) or misfits[best] > 0.5 * float(np.std(along)):
        raise CalibrationError(
            "the gyros do not follow the reference at any lag of "
            f"{LARGEST_LAG_S:g} s or less: check its clock, its unit, and the axis and sign given"
        )
    return float(lags[best])


def _half(mounting: Mounting, part: int) -> Mounting:
    """Return the first (0) or second (1) half of the samples of a mounting."""
    count = len(mounting.columns.time_s)
    first, last = (0, count // 2) if part == 0 else (count // 2, count)
    return replace(mounting, columns=mounting.columns.part(first, last))


def _aligned(mountings: tuple[Mounting, ...], lags_s: Floats) -> tuple[Floats, Floats]:
    """Return true and measured rates [N, 3] of all mountings at the samples' own moments."""
    truth, measured = [], []
    for m, lag_s in zip(mountings, lags_s, strict=True):
        keep = _inside(m)
        rate = CubicSpline(m.time_s, m.rate_rad_s)(m.columns.time_s[keep] - lag_s)
        truth.append(rate[:, None] * m.unit)
        measured.append(m.columns.gyro_rad_s[keep])
    return np.concatenate(truth), np.concatenate(measured)
