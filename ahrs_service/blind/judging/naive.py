"""The naive residual and the catalogue's regressors, for the baselines.

The reference is differentiated sample by sample and assumed exact, the noise white. This is the
obvious method, kept to show what it costs.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.effects.base import Addition, Columns, Effect, Values
from ahrs_service.effects.catalogue import EFFECTS
from ahrs_service.records import Floats

BLOCK: Final = 5
"""Reference samples per point of the residual: 10 Hz for a reference at 50 Hz."""

_CHANNELS: Final = 6  # Three gyros and three accelerometers


@dataclass(frozen=True, slots=True)
class Regression:
    """Residual [M] and one block of regressors [M, k] per effect id.

    M = 6 channels times points; each channel is centred and divided by its residual's spread.
    """

    residual: Floats
    blocks: dict[str, Floats]


def regression(recorded: Recorded) -> Regression:
    """Return the naive regression of a recording."""
    columns, gyro, accel = _columns(recorded)
    residual = _points(gyro - columns.rate_rad_s, accel - columns.force_m_s2)
    residual -= residual.mean(axis=0)
    spread = residual.std(axis=0)
    spread[spread == 0.0] = 1.0
    blocks = {}
    for name, effect in EFFECTS.items():
        needed = [n for n in effect.needs if not columns.knows(n)]
        if needed:
            continue
        found = [_regressor(columns, effect, values, step) for values, step in _probes(effect)]
        kept = [((x - x.mean(axis=0)) / spread).ravel() for x in found]
        kept = [x for x in kept if np.isfinite(x).all() and np.ptp(x) > 1e-12]
        if kept:
            blocks[name] = np.stack(kept, axis=1)
    return Regression((residual / spread).ravel(), blocks)


def _columns(recorded: Recorded) -> tuple[Columns, Floats, Floats]:
    """Return the columns of the reference's intervals, and the mean sensor readings there."""
    ends = recorded.attitude.time_s
    ends = ends[(ends >= recorded.imu_time_s[0]) & (ends <= recorded.imu_time_s[-1])]
    ends = ends[: (len(ends) - 1) // BLOCK * BLOCK + 1]
    at = np.searchsorted(recorded.attitude.time_s, ends)
    attitude = Rotation.from_quat(recorded.attitude.values[at], scalar_first=True)
    step = np.diff(ends)[:, None]
    rate = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / step
    velocity = np.stack([_interp(ends, recorded, n) for n in range(3)], axis=1)
    pull = np.diff(velocity, axis=0) / step - np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
    middle = attitude[:-1] * Rotation.from_rotvec(0.5 * rate * step)
    time_s = 0.5 * (ends[1:] + ends[:-1])
    temperature = recorded.temperature_degc.at(time_s)
    vibration = [recorded.vibration_m_s2.values[:, n] for n in range(3)]
    shake = np.mean(vibration, axis=0) if len(recorded.vibration_m_s2) else np.empty(0)
    columns = Columns(
        time_s,
        time_s,
        rate,
        middle.inv().apply(pull),
        np.gradient(rate, time_s, axis=0),
        temperature,
        np.gradient(_smooth(temperature), time_s),
        np.interp(time_s, recorded.vibration_m_s2.time_s, shake)
        if len(shake)
        else np.full(len(time_s), np.nan),
        recorded.current_a.at(time_s),
        recorded.throttle.at(time_s),
        recorded.airspeed_m_s.at(time_s),
        middle.as_quat(scalar_first=True),
    )
    means = [
        _means(recorded.imu_time_s, u, ends) for u in (recorded.gyro_rad_s, recorded.accel_m_s2)
    ]
    return columns, means[0], means[1]


def _interp(time_s: Floats, recorded: Recorded, axis: int) -> Floats:
    series = recorded.velocity_ned_m_s
    return np.interp(time_s, series.time_s, series.values[:, axis])


def _smooth(values: Floats, reach: int = 101) -> Floats:
    """Mean over `reach` points: reported temperatures have a resolution of 0.01 degC."""
    padded = np.pad(values, reach // 2, mode="edge")
    return np.convolve(padded, np.full(reach, 1.0 / reach), mode="valid")


def _means(time_s: Floats, values: Floats, ends: Floats) -> Floats:
    """Mean [K, 3] of linearly interpolated samples over the intervals between `ends` [K + 1]."""
    steps = 0.5 * np.diff(time_s)[:, None] * (values[1:] + values[:-1])
    area = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])
    at = np.stack([np.interp(ends, time_s, area[:, n]) for n in range(values.shape[1])], axis=1)
    return np.asarray(np.diff(at, axis=0) / np.diff(ends)[:, None], np.float64)


def _points(gyro: Floats, accel: Floats) -> Floats:
    """Means over `BLOCK` intervals of all six channels [K, 6]."""
    both = np.concatenate([gyro, accel], axis=1)
    return np.asarray(both.reshape(-1, BLOCK, _CHANNELS).mean(axis=1), np.float64)


def _probes(effect: Effect) -> list[tuple[dict[str, Floats], float]]:
    """Parameters at which the effect's response is a regressor, with the step used.

    One for every linear parameter, with nonlinear parameters in the middle of their grids; effects
    without linear parameters give one for every third value of their grid.
    """
    base = effect.neutral()
    for p in effect.parameters:
        if p.grid:
            base[p.name] = np.full(p.shape, p.grid[len(p.grid) // 2])
    probes = []
    for p in effect.parameters:
        for entry in p.entries() if p.step else ():
            values = base[p.name].copy()
            values[entry] += p.step
            probes.append((base | {p.name: values}, p.step))
    if not probes:
        searched = next(p for p in effect.parameters if p.grid)
        probes = [
            (base | {searched.name: np.full(searched.shape, v)}, 1.0) for v in searched.grid[1::3]
        ]
    return probes


def _regressor(columns: Columns, effect: Effect, values: Values, step: float) -> Floats:
    if effect.is_limit:
        # The grid is given as shares of the largest reading.
        name = effect.limited_by
        values = {name: values[name] * np.abs(effect.ideal(columns)).max()}
    added: Addition = effect.add(columns, values)
    none = np.zeros_like(columns.rate_rad_s)
    parts = [none if part is None else part / step for part in (added.gyro, added.accel)]
    return _points(parts[0], parts[1])
