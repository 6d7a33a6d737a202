"""The misfit of each channel against each covariate, and its range under noise alone."""

import math
from typing import Final

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import regimes
from ahrs_service.diagnosis.hypotheses.likelihood import solve
from ahrs_service.diagnosis.hypotheses.model import Model
from ahrs_service.diagnosis.hypotheses.score_test import surprise
from ahrs_service.diagnosis.input.misfit import CHANNELS, TRIADS, Residual, nuisance_rows
from ahrs_service.diagnosis.result import Covariate, Where
from ahrs_service.effects.base import Addition
from ahrs_service.records import Floats

_BINS: Final = 8
"""A choice: octiles; eight means show a curvature, each from an eighth of the samples."""
_UNITS: Final = {
    "temperature": "degC",
    "temperature slope": "degC/s",
    "rate": "rad/s",
    "acceleration": "m/s^2",
    "throttle": "1",
    "current": "A",
    "vibration": "m/s^2",
    "airspeed": "m/s",
    "roll": "rad",
    "pitch": "rad",
    "heading": "rad",
    "voltage": "V",
    "altitude": "m",
    "time": "s",
}


def _edges(values: Floats) -> Floats:
    """Return edges [B+1] of bins with about equal numbers of samples."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)))
    return edges if len(edges) > 2 else np.array([])


def _indicators(residual: Residual, channel: int, values: Floats, edges: Floats) -> Floats:
    """Return the rows [N, 6, B] of a unit offset of one channel in each bin of a covariate."""
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    columns = []
    for b in range(len(edges) - 1):
        added = np.zeros((len(values), 3))
        added[:, channel % 3] = place == b
        addition = Addition(gyro=added) if channel < 3 else Addition(accel=added)
        columns.append(residual.project(addition))
    return np.stack(columns, axis=2)


def against_covariates(residual: Residual, before: Model, after: Model) -> tuple[Covariate, ...]:
    """Return the misfit of every channel in bins of every covariate, lowest p-value first.

    Means by generalised least squares under the noise of `after`, with the biases fitted too:
    `null_std` is the 1-sigma of a mean under noise, wander and the reference's own error.
    """
    covariates = regimes(residual.columns) | {"time": residual.columns.time_s}
    explained = before.misfit - after.misfit
    base = nuisance_rows(residual)
    found = []
    for name, values in covariates.items():
        edges = _edges(values)
        if not len(edges):
            continue
        rows = [_indicators(residual, channel, values, edges) for channel in range(6)]
        targets = np.stack([before.misfit, explained], axis=2)
        gram, _ = residual.grams(np.concatenate([*rows, base, targets], axis=2))(after.noise)
        found += _of_covariate(gram, name, edges)
    return tuple(sorted(found, key=lambda item: item.p_value))


def _of_covariate(gram: Floats, name: str, edges: Floats) -> list[Covariate]:
    bins, count = len(edges) - 1, gram.shape[0] - 2
    first = count - 6
    _, inverse, _ = solve(gram[first:count, first:count], gram[first:count, -1])
    cross = gram[:, first:count]
    own = gram - cross @ inverse @ cross.T
    found = []
    for channel in range(6):
        part = slice(channel * bins, (channel + 1) * bins)
        # The common mean is not separable from the bias: a small ridge centres the means on zero.
        part_gram = own[part, part] + 1e-6 * np.trace(own[part, part]) / bins * np.eye(bins)
        mean, covariance, _ = solve(part_gram, own[part, -2])
        fitted, _, _ = solve(part_gram, own[part, -1])
        centred = np.eye(bins) - 1.0 / bins
        std = np.sqrt(np.maximum(np.diag(centred @ covariance @ centred.T), 0.0))
        value = surprise(0.5 * float(mean @ own[part, -2]), bins - 1)
        found.append(
            Covariate(
                TRIADS[channel],
                CHANNELS[channel],
                name,
                _UNITS[name],
                edges,
                mean - mean.mean(),
                std,
                fitted - fitted.mean(),
                math.exp(-min(value, 700.0)),
            )
        )
    return found


def where_largest(residual: Residual, added: Floats) -> tuple[Where, ...]:
    """Return the spans in which what a finding adds to rate and force [N, 6] is largest.

    Up to three spans of a twentieth of the recording or more in which its running rms exceeds
    its overall rms, each with the covariate that deviates most from its mean there.
    """
    scaled = (added - added.mean(axis=0)) / (added.std(axis=0) + 1e-30)
    size = np.sqrt(np.mean(scaled**2, axis=1))
    width = max(1, len(size) // 40)
    running = np.sqrt(np.convolve(size**2, np.ones(width) / width, mode="same"))
    high = running > np.sqrt(np.mean(size**2))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], high.astype(int), [0]])))
    spans = [(a, b) for a, b in edges.reshape(-1, 2) if b - a >= len(size) // 20]
    spans.sort(key=lambda span: -float(np.sum(running[span[0] : span[1]])))
    names = regimes(residual.columns)
    return tuple(
        Where(
            float(residual.time_s[a]),
            float(residual.time_s[b - 1]),
            _regime(residual, names, residual.time_s[a], residual.time_s[b - 1]),
        )
        for a, b in sorted(spans[:3])
    )


def _regime(residual: Residual, names: dict[str, Floats], t0_s: float, t1_s: float) -> str:
    time_s = residual.columns.time_s
    inside = (time_s >= t0_s) & (time_s <= t1_s)
    scores = {
        name: (values[inside].mean() - values.mean()) / (values.std() + 1e-30)
        for name, values in names.items()
    }
    name = max(scores, key=lambda key: abs(scores[key]))
    mean = names[name][inside].mean()
    unit = _UNITS[name]
    if unit.startswith("rad"):
        mean, unit = np.degrees(mean), unit.replace("rad", "deg")
    size = "high" if scores[name] > 0 else "low"
    return f"{size} {name}, {mean:.3g} {unit}".removesuffix(" 1")
