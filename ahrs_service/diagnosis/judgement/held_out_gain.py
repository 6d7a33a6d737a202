"""The gain of findings on parts of the recording that they were not fitted to."""

import math
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from ahrs_service.diagnosis.hypotheses.likelihood import solve
from ahrs_service.diagnosis.hypotheses.model import Model, added_body, derivative, free_numbers
from ahrs_service.diagnosis.input.misfit import Residual, bias_rows
from ahrs_service.diagnosis.result import FreeRun, Holdout, Vector
from ahrs_service.records import Floats
from ahrs_service.rotation import rotate_columns

Places = npt.NDArray[np.intp]

_BLOCKS: Final = 6  # A choice: each fit uses five sixths of the recording, less the gaps
_GAP_S: Final = 5.0  # About one correlation time of the reference's error (first guesses 6 and 4 s)
_SLOW_HZ: Final = 0.05  # A choice: the slow part of a residual is its mean over 20 s
_STAYS: Final = 1e-6  # A choice: the prior's sigma as a share of the limit, which fixes the limit
_LEAST_SIZE: Final = 1e-12  # A choice: avoids a division by zero
_FREE_RUN_S: Final = 60.0  # A choice: a minute, as the report calls it
_FREE_RUN_STARTS: Final = 200
"""A choice: if they were independent, their rms would be known to 5 % (1 / sqrt(2 * 200))."""


def _folds(residual: Residual) -> list[tuple[Places, Places]]:
    """Return, per contiguous block, the rows held out and the rows fitted, with a gap between."""
    edges = np.linspace(residual.time_s[0], residual.time_s[-1] + 1e-9, _BLOCKS + 1)
    there = residual.missing == 0.0
    folds = []
    for low, high in pairwise(edges):
        test = (residual.time_s >= low) & (residual.time_s < high)
        near = (residual.time_s >= low - _GAP_S) & (residual.time_s < high + _GAP_S)
        folds.append((np.flatnonzero(test & there), np.flatnonzero(~near & there)))
    return folds


def _slow(residual: Residual, values: Floats) -> Floats:
    step_s = (residual.time_s[-1] - residual.time_s[0]) / (len(residual.time_s) - 1)
    width = max(1, min(len(values), round(1.0 / (_SLOW_HZ * step_s))))
    return np.asarray(uniform_filter1d(values, width, axis=0, mode="nearest"))


def _rms(values: Floats) -> Vector:
    x, y, z = np.sqrt(np.mean(values**2, axis=0))
    return float(x), float(y), float(z)


def _white(residual: Residual, model: Model, base: Floats, rows: Floats) -> Floats:
    stack = np.concatenate([base, rows[:, :, None]], axis=2)
    white, _ = residual.whiten(model.noise, stack)
    return white


def _fitted(white: Floats, rows: Places, prior: Floats) -> Floats:
    part = white[rows].reshape(-1, white.shape[2])
    gram = part.T @ part + prior
    return solve(gram[:-1, :-1], gram[:-1, -1])[0]


def _sizes(model: Model) -> Floats:
    """Return the prior [B+1, B+1] of a model's parameters: sigma is their size in the whole fit.

    Centred on zero for linear parameters, on the fitted value for nonlinear ones. Blocks without
    information on a parameter (for a warm-up, all but the first) then predict zero for it rather
    than an arbitrary value. A saturation limit is fixed at the fitted value: its response has a
    kink there, and a block that only comes close to it does not determine it.
    """
    prior, numbers = np.zeros_like(model.prior), free_numbers(model.terms)
    last = len(prior) - 1
    for place, number in enumerate(numbers, start=last - len(numbers)):
        values = np.asarray(model.terms[number.term].values[number.parameter.name])
        now = 0.0 if number.is_form else float(values[number.index])
        size = float(np.sqrt(np.mean(values**2)))
        if model.terms[number.term].effect.is_limit:
            size *= _STAYS
        row = np.array([1.0, -now]) / max(size, _LEAST_SIZE)
        prior[np.ix_([place, last], [place, last])] += np.outer(row, row)
    return prior


def _loss(white: Floats, rows: Places, coefficients: Floats) -> float:
    left = white[rows][:, :, -1] - white[rows][:, :, :-1] @ coefficients
    return 0.5 * float(np.sum(left**2))


def held_out(
    residual: Residual, before: Model, after: Model, triad: str, has_fixed: bool = False
) -> Holdout:
    """Return what `after` gains over `before` block by block, each block left out of its fit.

    Both are fitted to the other blocks under the noise of `after` and scored by the innovations of
    the block. Nonlinear parameters are refitted with the linear ones, by their derivatives; with
    `has_fixed` no parameter of `after` is.
    """
    count = bias_rows(residual).shape[2]
    numbers = [] if has_fixed else free_numbers(after.terms)
    first = after.base.shape[2] - len(numbers)
    slopes = [derivative(residual, after.terms, n, in_body=True) for n in numbers]
    body_slopes = np.stack(slopes, axis=2) if slopes else np.empty((*residual.body.shape, 0))
    white_before = _white(residual, after, before.base, before.misfit)
    white_after = _white(residual, after, after.base, after.misfit)
    left_before = residual.body - added_body(residual, before.terms)
    left_after = residual.body - added_body(residual, after.terms)
    prior_before = _sizes(before)
    prior_after = np.zeros_like(after.prior) if has_fixed else _sizes(after)
    gain = 0.0
    for test, train in _folds(residual):
        if not len(test) or not len(train):
            continue
        short, long = (
            _fitted(white, train, prior)
            for white, prior in ((white_before, prior_before), (white_after, prior_after))
        )
        gain += _loss(white_before, test, short) - _loss(white_after, test, long)
        left_before[test] -= short[:count]
        left_after[test] -= long[:count] + body_slopes[test] @ long[first:]
    there = residual.missing == 0.0
    part = slice(3, 6) if triad == "accel" else slice(0, 3)
    slow = [_slow(residual, left[there])[:, part] for left in (left_before, left_after)]
    return Holdout(
        gain,
        _rms(left_before[there][:, part]),
        _rms(left_after[there][:, part]),
        _rms(slow[0]),
        _rms(slow[1]),
    )


def _bias(model: Model, residual: Residual) -> Floats:
    white = _white(residual, model, model.base, model.misfit)
    there = np.flatnonzero(residual.missing == 0.0)
    return _fitted(white, there, np.zeros_like(model.prior))[:6]


def free_run(residual: Residual, before: Model, after: Model) -> FreeRun | None:
    """Return the attitude error after 60 s of integrating the gyro alone, rms over many starts."""
    time_s = residual.time_s
    step_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    length = round(_FREE_RUN_S / step_s)
    if length >= len(time_s):
        return None
    columns = residual.columns
    nearest = np.clip(np.searchsorted(columns.time_s, time_s), 0, len(columns.time_s) - 1)
    attitude = columns.ned_from_body[nearest]
    starts = np.unique(np.linspace(0, len(time_s) - length - 1, _FREE_RUN_STARTS).astype(int))
    errors = []
    for model in (before, after):
        left = residual.body - added_body(residual, model.terms) - _bias(model, residual)
        left[residual.missing != 0.0] = 0.0
        angle = np.cumsum(rotate_columns(attitude, left[:, :3]) * step_s, axis=0)
        drift = np.linalg.norm(angle[starts + length] - angle[starts], axis=1)
        errors.append(math.degrees(float(np.sqrt(np.mean(drift**2)))))
    return FreeRun(*errors)
