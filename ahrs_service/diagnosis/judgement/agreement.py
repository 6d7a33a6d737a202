"""Whether the parts of a recording agree on parameters fitted to all of it."""

from typing import Final

import numpy as np
from scipy.stats import chi2

from ahrs_service.diagnosis.hypotheses.candidates import Dependence
from ahrs_service.diagnosis.hypotheses.likelihood import solve
from ahrs_service.diagnosis.hypotheses.model import Model, free_numbers
from ahrs_service.diagnosis.input.misfit import Residual
from ahrs_service.records import Floats

_BLOCKS: Final = 12  # A choice: 11 degrees of freedom for each number
_SURE: Final = 1e-3
"""A choice: with noise as modelled, one term in a thousand is called inconsistent."""
_EXCITED: Final = 0.01
"""A choice: least share of a parameter's information that counts, an eighth of an even share."""


def scatter_of_term(residual: Residual, model: Model, place: int) -> float:
    """Return by how much blocks of the recording disagree on the parameters of a term."""
    numbers = free_numbers(model.terms)
    first = model.base.shape[2] - len(numbers)
    own = [first + n for n, number in enumerate(numbers) if number.term == place]
    return scatter(residual, model, own) if own else 1.0


def scatter_of_unknown(residual: Residual, model: Model, unknown: Dependence) -> float:
    """Return the same for an unknown dependence."""
    first = model.base.shape[2] - len(free_numbers(model.terms)) - len(model.unknown)
    own = [first + n for n, one in enumerate(model.unknown) if one == unknown]
    return scatter(residual, model, own)


def scatter(residual: Residual, model: Model, columns: list[int]) -> float:
    """Return by how much blocks of the recording disagree, 1 where they agree.

    `columns` of the model's base. With G_b the Gram matrix of these columns in block b after all
    others are projected out, and s_b their product with the innovations there (whose sum is zero),
    the sum of s_b' G_b^-1 s_b is chi-squared with (blocks - 1) K degrees of freedom if the noise
    is as modelled. Where it is larger than chance allows (one in a thousand), the ratio of the sum
    to the degrees of freedom is the ratio of true to modelled variances, as Birge's ratio for
    measurements that scatter more than their sigmas (Birge, Phys. Rev. 40, 207, 1932). Causes are
    noise that is not white, heavy tails, or parameters that vary in time.
    """
    rows = np.concatenate([model.base, model.misfit[:, :, None]], axis=2)
    white, _ = residual.whiten(model.noise, rows)
    flat = white.reshape(-1, white.shape[2])
    whole = flat.T @ flat + model.prior
    own = np.zeros(len(whole) - 1, np.bool_)
    own[columns] = True
    others = np.flatnonzero(~own)
    left = flat[:, -1] - flat[:, :-1] @ solve(whole[:-1, :-1], whole[:-1, -1])[0]
    _, inverse, _ = solve(whole[np.ix_(others, others)], whole[others, -1])
    shared = inverse @ whole[np.ix_(others, np.flatnonzero(own))]
    freed = (flat[:, :-1][:, own] - flat[:, others] @ shared).reshape(len(white), 6, -1)
    left = left.reshape(len(white), 6)
    blocks = np.array_split(np.flatnonzero(residual.missing == 0.0), _BLOCKS)
    grams = np.array([np.einsum("nij,nik->jk", freed[b], freed[b]) for b in blocks])
    scores = np.array([np.einsum("nij,ni->j", freed[b], left[b]) for b in blocks])
    return _ratio(grams, scores)


def _ratio(grams: Floats, scores: Floats) -> float:
    """Return the ratio of the scores' scatter [B, K] to their Gram matrices [B, K, K]."""
    total = grams.sum(axis=0)
    values, vectors = np.linalg.eigh(total)
    kept = values > values[-1] * 1e-9
    root = vectors[:, kept] / np.sqrt(values[kept])
    found, freedom = 0.0, -int(kept.sum())
    for gram, score in zip(grams, scores, strict=True):
        shares, axes = np.linalg.eigh(root.T @ gram @ root)
        excited = shares > _EXCITED
        found += float(np.sum((axes.T @ (root.T @ score))[excited] ** 2 / shares[excited]))
        freedom += int(excited.sum())
    if freedom < 1 or chi2.sf(found, freedom) > _SURE:
        return 1.0
    return max(1.0, found / freedom)
