"""The baselines: stepwise regression with F-test or BIC, and the lasso.

All choose among the catalogue's regressors for the naive residual and assume white noise and
independent points (Klein and Morelli 2006, ch. 5; Tibshirani 1996).
"""

from typing import Any, Final

import numpy as np
from scipy.stats import f as f_distribution

from ahrs_service.blind.judging.naive import Regression
from ahrs_service.blind.making.naming import report
from ahrs_service.records import Floats

ALARM: Final = 0.02
"""Share of nulls that may raise an alarm: divided by the number of effects (Bonferroni)."""

_MOST: Final = 8  # A choice: limit on effects; no recording of a set hides more than two
_LAMBDAS: Final = 30  # A choice: penalties over three decades, a step of 27 % (1000^(1/29))
_SWEEPS: Final = 200  # A choice: limit on sweeps of the lasso's coordinate descent


class _Moments:
    """Inner products of residual and regressors: all that the selection needs."""

    def __init__(self, regression: Regression) -> None:
        self.names = list(regression.blocks)
        matrix = np.concatenate(list(regression.blocks.values()), axis=1)
        self.scale = np.linalg.norm(matrix, axis=0)
        matrix = matrix / self.scale
        self.gram = matrix.T @ matrix
        self.inner = matrix.T @ regression.residual
        self.energy = float(regression.residual @ regression.residual)
        self.count = len(regression.residual)
        widths = [block.shape[1] for block in regression.blocks.values()]
        starts = np.concatenate([[0], np.cumsum(widths)])
        self.places = {
            name: np.arange(starts[n], starts[n + 1]) for n, name in enumerate(self.names)
        }

    def rest(self, chosen: list[str]) -> float:
        """Return the residual's energy with the chosen effects fitted."""
        if not chosen:
            return self.energy
        at = np.concatenate([self.places[name] for name in chosen])
        solved = np.linalg.lstsq(self.gram[np.ix_(at, at)], self.inner[at], rcond=1e-10)[0]
        return max(self.energy - float(self.inner[at] @ solved), 1e-12 * self.energy)

    def width(self, chosen: list[str]) -> int:
        """Return the number of regressors of the chosen effects."""
        return sum(len(self.places[name]) for name in chosen)


def stepwise_f(regression: Regression) -> dict[str, Any]:
    """Add the effect of the smallest p-value while it is below `ALARM` / number of effects."""
    moments = _Moments(regression)
    chosen: list[str] = []
    while len(chosen) < _MOST:
        before = moments.rest(chosen)
        scores = {}
        for name in moments.names:
            if name not in chosen:
                after, width = moments.rest([*chosen, name]), moments.width([name])
                free = moments.count - moments.width(chosen) - width - 6
                ratio = (before - after) / width / (after / free)
                scores[name] = (float(f_distribution.sf(ratio, width, free)), -ratio)
        if not scores:
            break
        best = min(scores, key=lambda name: scores[name])
        if scores[best][0] * len(moments.names) >= ALARM:
            break
        chosen.append(best)
    return report(chosen)


def stepwise_bic(regression: Regression) -> dict[str, Any]:
    """Add the effect that lowers n ln(RSS / n) + p ln n most, as long as one does."""
    moments = _Moments(regression)
    chosen: list[str] = []

    def criterion(names: list[str]) -> float:
        fit = moments.count * np.log(moments.rest(names) / moments.count)
        return float(fit + moments.width(names) * np.log(moments.count))

    while len(chosen) < _MOST:
        left = [name for name in moments.names if name not in chosen]
        best = min(left, key=lambda name: criterion([*chosen, name]), default=None)
        if best is None or criterion([*chosen, best]) >= criterion(chosen):
            break
        chosen.append(best)
    return report(chosen)


def lasso(regression: Regression) -> dict[str, Any]:
    """Coordinate descent for decreasing penalties; the fit with the smallest BIC is used."""
    moments = _Moments(regression)
    weights = np.zeros(len(moments.inner))
    largest = float(np.abs(moments.inner).max())
    best, best_weights = moments.count * np.log(moments.energy / moments.count), weights.copy()
    for penalty in largest * np.geomspace(1.0, 1e-3, _LAMBDAS):
        _descend(moments, weights, float(penalty))
        left = moments.energy - 2.0 * weights @ moments.inner + weights @ moments.gram @ weights
        criterion = moments.count * np.log(max(left, 1e-12) / moments.count)
        criterion += np.count_nonzero(weights) * np.log(moments.count)
        if criterion < best:
            best, best_weights = criterion, weights.copy()
    sizes = {
        name: float(np.linalg.norm(best_weights[place])) for name, place in moments.places.items()
    }
    return report(sorted((name for name in sizes if sizes[name] > 0.0), key=lambda n: -sizes[n]))


def _descend(moments: _Moments, weights: Floats, penalty: float) -> None:
    """Minimise half the squared misfit plus `penalty` times the sum of |weights|, in place."""
    slack = moments.inner - moments.gram @ weights
    for _ in range(_SWEEPS):
        moved = 0.0
        for j in range(len(weights)):
            pull = slack[j] + weights[j]
            new = np.sign(pull) * max(abs(pull) - penalty, 0.0)
            if new != weights[j]:
                slack -= moments.gram[:, j] * (new - weights[j])
                moved = max(moved, abs(new - weights[j]))
                weights[j] = new
        if moved < 1e-4 * penalty:
            break


BASELINES: Final = {
    "F-test": stepwise_f,
    "BIC": stepwise_bic,
    "lasso": lasso,
}
"""Title to choice."""
