"""The ideal motion and the covariates that effects depend on, on the grid of a comparison."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, savgol_filter, sosfiltfilt, spectrogram
from scipy.stats import chi2

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.diagnosis.input.reference import Reference, body_vectors
from ahrs_service.effects.base import Columns
from ahrs_service.records import Floats

GRAVITY_NED: Final = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
"""Gravity [3] [m/s^2] in axes north, east, down; standard, not local."""

MOTION_HZ: Final = 7.0
"""Rotation of vehicles of these sizes is below this, motor vibration above."""

REFERENCE_HZ: Final = 3.0
"""The same for a reference with a noisy derivative: hard manoeuvres are below this."""

_SLOPE_S: Final = 8.0
"""Span of the parabolas that give the temperature's slope: with 0.01 degC steps at 10 Hz its error
is 1e-4 degC/s, and at the ends, where a warm-up is steepest, it has no bias."""

_SMOOTH_S: Final = 0.5
"""Width over which airspeed and current are smoothed to reduce their noise."""


def _smoothed(series: Series, width_s: float) -> Series:
    if len(series) < 3:
        return series
    step_s = (series.time_s[-1] - series.time_s[0]) / (len(series) - 1)
    values = gaussian_filter1d(series.values, width_s / step_s, axis=0, mode="nearest")
    return Series(series.time_s, values)


def _slope(series: Series) -> Series:
    if len(series) < 5:
        return series
    step_s = (series.time_s[-1] - series.time_s[0]) / (len(series) - 1)
    width = min(2 * round(0.5 * _SLOPE_S / step_s) + 1, (len(series) - 1) | 1)
    slope = savgol_filter(series.values, max(width, 3), 2, deriv=1, delta=step_s, mode="interp")
    return Series(series.time_s, slope)


def _vibration(series: Series) -> Series:
    """Return one vibration level for the board: the mean of its three axes."""
    if not len(series):
        return series
    return _smoothed(Series(series.time_s, series.values.mean(axis=1)), _VIBRATION_S)


def _altitude(velocity: Series) -> Series:
    """Return the height above the start: the reference's vertical speed integrated."""
    if not len(velocity):
        return velocity
    climbed = cumulative_trapezoid(-velocity.values[:, 2], velocity.time_s, initial=0.0)
    return Series(velocity.time_s, climbed)


_VIBRATION_S: Final = 0.15
"""The same for vibration, which follows the motors within tenths of a second."""

_SCATTER_S: Final = 0.5
"""A choice: sigma of a Gaussian window, about a second wide."""
_MOVING_SHARE: Final = 0.9
"""Of real motion 97 % and more of the power is in both (see `moving`); a choice below that."""
_SLOWER_HZ: Final = (REFERENCE_HZ, 1.0, 0.5)
"""A choice: cutoffs tried below MOTION_HZ, first that of a noisy reference."""
_FLOOR_HZ: Final = (REFERENCE_HZ, 20.0)
"""Between motion, slower than REFERENCE_HZ, and the airframe's vibration; 20 Hz is a choice."""
_FLOOR_SEGMENT_S: Final = 4.0  # A choice: 68 frequencies, 0.25 Hz apart, lie between 3 and 20 Hz
_FLOOR_QUANTILE: Final = 0.1
"""A choice: the lowest seven of 68; chi-squared corrects the low bias."""


def covariates(
    recorded: Recorded, time_s: Floats, rate: Floats, force: Floats, attitude: Floats
) -> Columns:
    """Return the columns of a motion at `time_s` [N] with the other recorded quantities."""
    spline = CubicSpline(time_s, rate)
    return Columns(
        time_s=time_s,
        since_power_on_s=time_s,
        rate_rad_s=rate,
        force_m_s2=force,
        angular_acceleration_rad_s2=spline(time_s, 1),
        temperature_degc=recorded.temperature_degc.at(time_s),
        temperature_slope_degc_s=_slope(recorded.temperature_degc).at(time_s),
        vibration_m_s2=_vibration(recorded.vibration_m_s2).at(time_s),
        current_a=_smoothed(recorded.current_a, _SMOOTH_S).at(time_s),
        throttle=_smoothed(recorded.throttle, _SMOOTH_S).at(time_s),
        airspeed_m_s=_smoothed(recorded.airspeed_m_s, _SMOOTH_S).at(time_s),
        ned_from_body=attitude,
        supply_v=_smoothed(recorded.supply_v, _SMOOTH_S).at(time_s),
        altitude_m=_altitude(recorded.velocity_ned_m_s).at(time_s),
    )


def slow_motion(
    time_s: Floats, values: Floats, at_s: Floats, cutoff_hz: float = MOTION_HZ
) -> Floats:
    """Return `values` [N, M] low-passed at the cutoff without delay, at `at_s`."""
    rate_hz = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    if rate_hz > 2.5 * cutoff_hz:
        sections = butter(6, cutoff_hz, fs=rate_hz, output="sos")
        values = sosfiltfilt(sections, values, axis=0)
    return np.asarray(CubicSpline(time_s, values)(at_s))


def ends(readings: Floats) -> tuple[Floats, Floats]:
    """Return the largest of |readings| [M], and how many are within a factor 1e-5 of it."""
    sizes = np.abs(readings)
    largest = sizes.max(axis=0)
    return largest, np.sum(sizes >= largest * (1.0 - 1e-5), axis=0).astype(np.float64)


def scatter(time_s: Floats, readings: Floats, slow: Floats, at_s: Floats) -> Floats:
    """Return the 1-sigma [N, M] of `readings` about `slow` over a second, at `at_s`."""
    step_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    square = gaussian_filter1d((readings - slow) ** 2, _SCATTER_S / step_s, axis=0, mode="nearest")
    sigma = np.sqrt(np.maximum(square, 0.0))
    return np.column_stack([np.interp(at_s, time_s, column) for column in sigma.T])


def density(time_s: Floats, readings: Floats) -> float:
    """Return the white noise density [unit/sqrt(Hz), two-sided] of readings [N, 3].

    The floor of their spectrum between motion, which is slower, and vibration, which is faster:
    the 10 % quantile between 3 and 20 Hz, divided by that of chi-squared with two degrees of
    freedom per axis. Of the spectra of 4 s each, again the 10 % quantile: hard motion hides the
    floor.
    """
    rate_hz = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    length = int(_FLOOR_SEGMENT_S * rate_hz)
    frequency_hz, _, power = spectrogram(
        readings, rate_hz, "hann", length, length // 2, detrend="constant", axis=0
    )
    band = (frequency_hz > _FLOOR_HZ[0]) & (frequency_hz < min(_FLOOR_HZ[1], 0.4 * rate_hz))
    if not band.any():
        return math.nan
    freedom = 2 * readings.shape[1]
    floors = np.quantile(power[band].mean(axis=1), _FLOOR_QUANTILE, axis=0)
    floors *= freedom / chi2.ppf(_FLOOR_QUANTILE, freedom)
    return float(np.sqrt(0.5 * np.quantile(floors, _FLOOR_QUANTILE)))


def motion_of_reference(reference: Reference, like: Columns) -> Columns:
    """Return `like` with rate and force of the reference alone: noisier, but independent."""
    time_s = reference.time_s
    spline = CubicSpline(time_s, reference.ned_from_body)
    q, q_dot = spline(time_s), spline(time_s, 1)
    rate = 2.0 * _vector_part(q, q_dot)
    acceleration = CubicSpline(time_s, reference.velocity_ned_m_s)(time_s, 1)
    force = body_vectors(reference.ned_from_body, acceleration - GRAVITY_NED)
    rate, force = (
        slow_motion(time_s, values, like.time_s, REFERENCE_HZ) for values in (rate, force)
    )
    return replace(
        like,
        rate_rad_s=rate,
        force_m_s2=force,
        angular_acceleration_rad_s2=CubicSpline(like.time_s, rate)(like.time_s, 1),
    )


def moving(read: Columns, seen: Columns) -> Columns:
    """Return the motion `read` by the IMU at the frequencies where the reference has `seen` it too.

    Noise in a reading used as a regressor would explain itself, as a scale factor of 1. Of real
    motion 97 % and more of the power is in both. Where vibration is as large as the motion the axis
    is low-passed to where the two agree; an axis on which they never agree is assumed at rest.
    """
    time_s = read.time_s
    rate, force = (
        np.stack([_followed(time_s, *axis) for axis in zip(here.T, there.T, strict=True)], axis=1)
        for here, there in (
            (read.rate_rad_s, seen.rate_rad_s),
            (read.force_m_s2, seen.force_m_s2),
        )
    )
    slope = CubicSpline(time_s, rate)(time_s, 1)
    return replace(read, rate_rad_s=rate, force_m_s2=force, angular_acceleration_rad_s2=slope)


def _followed(time_s: Floats, here: Floats, there: Floats) -> Floats:
    """Return `here` [N] at the highest cutoff at which `there` [N] agrees, else its mean."""
    apart = there - there.mean()
    for cutoff_hz in (MOTION_HZ, *_SLOWER_HZ):
        slower = here if cutoff_hz == MOTION_HZ else slow_motion(time_s, here, time_s, cutoff_hz)
        if np.mean((slower - slower.mean()) * apart) > _MOVING_SHARE * slower.var():
            return slower
    return np.full(len(here), here.mean())


def _vector_part(q: Floats, q_dot: Floats) -> Floats:
    """Return the vector part of conj(q) q_dot [N, 3]."""
    w, v = q[:, :1], q[:, 1:]
    return np.asarray(w * q_dot[:, 1:] - q_dot[:, :1] * v - np.cross(v, q_dot[:, 1:]))
