"""Uncertainty of a model's parameters, beyond that of one noise model and one response form.

The covariance of a fit is valid for the fitted noise, if the noise is of that kind, and for the
fitted form of the response. Three things make it larger:

- the noise itself is estimated from the data: `marginal_covariance`;
- noise of another kind, or parameters that vary in time: parts of the recording then disagree by
  more than the noise allows, `covariance_by_blocks`;
- the true form differs from the model's: another filter order explains as much, or the
  parameter states by how much forms of one kind differ (`Parameter.form_share`).

Of 300 parameters fitted to single effects of all kinds, 92.7 % lay within 1.96 sigma of the first
covariance, 93.0 % with the posterior of the noise, and 94.7 % with the larger of that and the
blocks'. Parameters chosen by a search err by more: `CHOSEN`.
"""

from typing import Final

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import Term
from ahrs_service.diagnosis.hypotheses.likelihood import Fit, Posterior, solve
from ahrs_service.diagnosis.hypotheses.model import Model, free_numbers, settle
from ahrs_service.diagnosis.input.misfit import Residual
from ahrs_service.records import Floats

_AWAY: Final = np.sqrt(3.0)  # Outer points of three-point Gauss-Hermite quadrature [sigma]
_SIDE: Final = 1.0 / 6.0  # and their weight

CHOSEN: Final = 1.1
"""Calibrated on 497 parameters found by whole searches in 242 blind recordings: 62 and 91 % of them
lay within 1 and 1.96 sigma without it, 68 and 94 % with it."""

_BLOCKS: Final = 20
"""Of 10, 20 and 30 blocks, the number for which the rms error was 1.00 sigma."""


def variances(residual: Residual, model: Model) -> Floats:
    """Return the variances [P] of the free parameters, in the order of `free_numbers`."""
    numbers = free_numbers(model.terms)
    if not numbers:
        return np.zeros(0)
    alone = np.diag(marginal_covariance(residual, model))
    total = np.maximum(alone, np.diag(covariance_by_blocks(residual, model)))
    values = _values(model)
    shares = np.array([number.parameter.form_share for number in numbers])
    form = (shares * values) ** 2 + _between_orders(residual, model)
    return np.asarray(CHOSEN**2 * total + form)


def _values(model: Model) -> Floats:
    return np.array(
        [
            float(model.terms[number.term].values[number.parameter.name][number.index])
            for number in free_numbers(model.terms)
        ]
    )


def _rows(model: Model) -> Floats:
    return np.concatenate([model.base, model.misfit[:, :, None]], axis=2)


def marginal_covariance(residual: Residual, model: Model) -> Floats:
    """Return the covariance [P, P] with the noise's own uncertainty, by the law of total variance.

        Cov(x) = E[Cov(x | noise)] + Cov(E[x | noise])

    over the noise's posterior. This is approximated by a Gaussian about the fitted noise with its
    information matrix (Laplace); along each principal axis it is integrated by three-point
    Gauss-Hermite quadrature (Abramowitz, Stegun, table 25.10), weighted by the true posterior.
    """
    count = len(free_numbers(model.terms))
    posterior = Posterior(residual, _rows(model), model.prior)
    here, _, information = posterior.slope(model.noise)
    low, high = np.array(residual.noise_bounds()).T
    middle = posterior.cost(model.noise)[1]
    values, vectors = np.linalg.eigh(information)
    inner = middle.covariance[-count:, -count:]
    total = inner.copy()
    for axis in (_AWAY * vectors / np.sqrt(values)).T:
        points = [(1.0 - 2.0 * _SIDE, middle)]
        for moved in (model.noise + axis, model.noise - axis):
            cost, found = posterior.cost(np.clip(moved, low, high))[:2]
            weight = _SIDE * np.exp(min(here - cost, 0.0) + 0.5 * _AWAY**2)
            points.append((weight, found))
        total += _spread(points, count) - inner
    return np.asarray(total)


def _spread(points: list[tuple[float, Fit]], count: int) -> Floats:
    """Return the covariance of the last `count` coefficients over weighted points."""
    weights = np.array([weight for weight, _ in points])
    weights /= weights.sum()
    means = np.array([found.coefficients[-count:] for _, found in points])
    inner = np.array([found.covariance[-count:, -count:] for _, found in points])
    apart = means - weights @ means
    return np.asarray(np.tensordot(weights, inner, axes=1) + (weights * apart.T) @ apart)


def covariance_by_blocks(residual: Residual, model: Model) -> Floats:
    """Return the covariance [P, P] estimated from the scatter between parts of the recording.

    A (sum of s_b s_b') A n / (n - 1), A the covariance under the noise, s_b the score of block b;
    valid for any noise within blocks (Liang, Zeger 1986; the factor Cameron, Miller 2015).
    """
    count = len(free_numbers(model.terms))
    white, _ = residual.whiten(model.noise, _rows(model))
    flat = white.reshape(-1, white.shape[2])
    gram = flat.T @ flat + model.prior
    coefficients, inverse, _ = solve(gram[:-1, :-1], gram[:-1, -1])
    left = white[:, :, -1] - white[:, :, :-1] @ coefficients
    blocks = np.array_split(np.flatnonzero(residual.missing == 0.0), _BLOCKS)
    scores = np.array([np.einsum("nck,nc->k", white[b, :, :-1], left[b]) for b in blocks])
    moves = (scores @ inverse)[:, -count:]
    return np.asarray(moves.T @ moves * _BLOCKS / (_BLOCKS - 1))


def _between_orders(residual: Residual, model: Model) -> Floats:
    """Return what other integer orders of a term's form add to the variances [P].

    Each is fitted under the same noise; the squared difference of its parameters is weighted by
    its relative likelihood.
    """
    added = np.zeros(len(free_numbers(model.terms)))
    for place, term in enumerate(model.terms):
        for other in _other_orders(term):
            terms = (*model.terms[:place], other, *model.terms[place + 1 :])
            found = settle(residual, terms, model.noise, model.unknown, model.unknown_rows)
            gain = np.clip(found.log_likelihood - model.log_likelihood, -700.0, 700.0)
            added += (_values(found) - _values(model)) ** 2 / (1.0 + np.exp(-gain))
    return added


def _other_orders(term: Term) -> list[Term]:
    return [
        Term(term.effect, {**term.values, parameter.name: np.asarray(value)})
        for parameter in term.effect.parameters
        if parameter.is_whole
        for value in parameter.grid
        if value != float(term.values[parameter.name])
    ]
