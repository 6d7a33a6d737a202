"""The misfit against everything it may depend on: bin means, and what chance makes of them.

What noise alone gives is read from the recording itself: the residual that the findings leave is
given random phases, many times, which keeps its own colour and takes away what it depends on
(Theiler et al., Physica D 58, 1992). The sum of squared bin means in units of that spread is
compared with a gamma distribution of the mean and variance that the drawn residuals have.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.stats import gamma

from ahrs_service.diagnosis.recorded import Recorded, Series
from ahrs_service.diagnosis.residual import CHANNELS
from ahrs_service.diagnosis.result import Covariate, ResidualSeries
from ahrs_service.records import Floats
from ahrs_service.rotation import euler_columns

BINS: Final = 12
_DRAWS: Final = 99
_LEAST_ROWS: Final = 20 * BINS
_LEAST_SPREAD: Final = 1e-9


def against_covariates(recorded: Recorded, series: ResidualSeries) -> tuple[Covariate, ...]:
    """Return the residual [N, 6] of `series` against each covariate, the most telling first.

    The constant bias is left out; bins hold like numbers of instants.
    """
    if len(series.time_s) < _LEAST_ROWS:
        return ()
    left = series.after - series.after.mean(axis=0)
    drawn = _drawn(left)
    before = series.before - series.after.mean(axis=0)
    found: list[Covariate] = []
    for name, unit, values, channels in _covariates(recorded, series.time_s):
        if np.isfinite(values).all() and np.ptp(values) > _LEAST_SPREAD:
            found += _against(name, unit, values, before, left, drawn, channels)
    return tuple(sorted(found, key=lambda item: (item.p_value, -_size(item))))


def _size(item: Covariate) -> float:
    return float(np.abs(item.mean / item.null_std).max())


def _covariates(
    recorded: Recorded, time_s: Floats
) -> Iterator[tuple[str, str, Floats, tuple[int, ...]]]:
    """Yield name, unit, values [N] and the channels that may follow it."""
    every = tuple(range(6))
    shaken = recorded.vibration_m_s2
    level = Series(shaken.time_s, shaken.values.mean(axis=1)) if len(shaken) else shaken
    temperature = recorded.temperature_degc.at(time_s)
    yield "time since power-on", "s", time_s, every
    yield "temperature", "°C", temperature, every
    yield "temperature slope", "°C/s", np.gradient(temperature, time_s), every
    yield "vibration", "m/s²", level.at(time_s), every
    yield "current", "A", recorded.current_a.at(time_s), every
    yield "throttle", "1", recorded.throttle.at(time_s), every
    yield "airspeed", "m/s", recorded.airspeed_m_s.at(time_s), every
    for axis, letter in enumerate("xyz"):
        own = (axis, axis + 3)
        rate = np.interp(time_s, recorded.imu_time_s, recorded.gyro_rad_s[:, axis])
        force = np.interp(time_s, recorded.imu_time_s, recorded.accel_m_s2[:, axis])
        yield f"rate {letter}", "rad/s", rate, own
        yield f"acceleration {letter}", "m/s²", force, own
    attitude = recorded.attitude
    q = np.stack([np.interp(time_s, attitude.time_s, c) for c in attitude.values.T], axis=1)
    roll, pitch, _ = np.degrees(euler_columns(q / np.linalg.norm(q, axis=1, keepdims=True))).T
    yield "roll", "°", roll, every
    yield "pitch", "°", pitch, every


def _drawn(left: Floats) -> Floats:
    """Return residuals [draws, N, 6] of the same spectra with random phases, equal each time."""
    rng = np.random.default_rng(1)
    spectrum = np.fft.rfft(left, axis=0)
    turns = rng.uniform(0.0, 2.0 * np.pi, (_DRAWS, *spectrum.shape))
    return np.fft.irfft(np.abs(spectrum) * np.exp(1j * turns), n=len(left), axis=1)


def _edges(values: Floats) -> Floats:
    """Return borders of bins: like numbers in each, or one for each of a few values."""
    steps = np.unique(values)
    if len(steps) <= BINS:
        return np.concatenate([steps[:1], 0.5 * (steps[1:] + steps[:-1]), steps[-1:]])
    borders = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    return borders if len(borders) > 3 else np.linspace(steps[0], steps[-1], BINS + 1)


def _against(
    name: str,
    unit: str,
    values: Floats,
    before: Floats,
    left: Floats,
    drawn: Floats,
    channels: tuple[int, ...],
) -> Iterator[Covariate]:
    edges = _edges(values)
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    member = np.zeros((len(edges) - 1, len(values)))
    member[which, np.arange(len(values))] = 1.0
    member /= np.maximum(member.sum(axis=1, keepdims=True), 1.0)
    moved = np.stack([member @ one for one in drawn])
    spread = np.maximum(moved.std(axis=0), np.finfo(np.float64).tiny)
    chance = np.square(moved / spread).sum(axis=1)
    mean = member @ before
    fitted = member @ (before - left)
    power = np.square(mean / spread).sum(axis=0)
    for channel in channels:
        expected, variance = chance[:, channel].mean(), chance[:, channel].var()
        shape = expected**2 / max(variance, np.finfo(np.float64).tiny)
        p_value = gamma.sf(power[channel], shape, scale=expected / shape)
        yield Covariate(
            CHANNELS[channel],
            name,
            unit,
            edges,
            mean[:, channel],
            spread[:, channel],
            fitted[:, channel],
            float(p_value),
        )
