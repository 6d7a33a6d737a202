"""What noise alone makes of the whole search.

A hypothesis' surprise is -log of its own chance; the search looks at a hundred forms of thirty
effects, of which many are alike. How many independent hypotheses they amount to is found by a
parametric bootstrap of the most surprising one: the targets b of all responses are drawn from
N(0, G), G their Gram matrix under the noise with the nuisances taken out, which is what the fitted
noise alone gives them, with all their correlations. Of 100 recordings of noise, hard ones among
them, the chances so found are uniform: see tests/benchmarks/mismatch_nulls.py.
"""

from typing import Final

import numpy as np
from scipy.stats import chi2

from ahrs_service.diagnosis.hypotheses.candidates import Library
from ahrs_service.diagnosis.hypotheses.model import Model
from ahrs_service.diagnosis.hypotheses.score_test import gain_of, grams
from ahrs_service.diagnosis.input.misfit import Residual
from ahrs_service.records import Floats

FALSE_ALARMS: Final = 0.005
"""Chance that noise alone raises a name. A quarter of what is asked: the rest is left to unknown
dependences and to numbers that are fitted closer than on the grid of the bootstrap. Of 136
recordings of noise two would be named at 0.01, none here."""

_DRAWS: Final = 300  # Their median tells the count to 8 %, and so the alarm to 0.08 nats
_SEED: Final = 1  # Any: fixed, so that a recording has one answer


def maxima(residual: Residual, library: Library, model: Model, draws: int = _DRAWS) -> Floats:
    """Return the surprise [draws] of the most surprising effect in each draw of the noise."""
    gram, _, share = grams(residual, model.noise, library, model.base, model.misfit)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / size[:, None] / size[None, :])
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    target = root @ np.random.default_rng(_SEED).normal(size=(len(root), draws))
    most = np.zeros(draws)
    for candidate in library.candidates:
        if candidate.effect is not None:
            gains = np.maximum(gain_of(candidate, gram, target, share), 0.0)
            most = np.maximum(most, -chi2.logsf(2.0 * gains, candidate.freedom))
    return most


def hypotheses(most: Floats) -> float:
    """Return how many independent hypotheses have maxima [draws] like these.

    The chance that the largest of n stays below s is (1 - exp(-s))^n; n by the median, which few
    draws tell, because the form of the tail is known: that of a single surprise.
    """
    return float(np.log(0.5) / np.log1p(-np.exp(-np.median(most))))


def alarm(count: float) -> float:
    """Return the surprise [nats] that noise exceeds with FALSE_ALARMS in so many hypotheses."""
    return float(-np.log(-np.expm1(np.log1p(-FALSE_ALARMS) / count)))


ALARM: Final = alarm(20.0)
"""Surprise [nats] from which a hypothesis is believed: 8.3. By the bootstrap of the maximum
(diagnosis.chance) a recording's library amounts to 14 to 27 independent hypotheses."""

UNKNOWN_ALARM: Final = 16.0
"""The same for a smooth unknown dependence: higher, because noise that goes with the motion (a
jittered reference) raises these tests, of which there are twenty of twelve numbers each. By how
much is a choice: twice ALARM, nearly."""


def over_the_search(surprise: float, count: float) -> float:
    """Return the chance that noise makes the best of `count` hypotheses as surprising as this."""
    return float(-np.expm1(count * np.log1p(-np.exp(-min(surprise, 700.0)))))
