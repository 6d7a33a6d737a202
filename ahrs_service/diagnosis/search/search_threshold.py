"""The significance of the best of many hypotheses: what noise alone gives the whole search.

The surprise of a hypothesis is -ln of its own p-value; the search tests a hundred forms of thirty
effects, many of them similar. The number of independent hypotheses is found by a parametric
bootstrap of the largest surprise: the targets b of all responses are drawn from N(0, G), G their
Gram matrix under the noise with the nuisances projected out, which is their distribution under the
fitted noise alone, with all correlations. Over 100 recordings of noise, difficult ones included,
the resulting p-values are uniform: see tests/benchmarks/mismatch_nulls.py.
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
"""Chance that noise alone gives a named effect. A quarter of the required 2 %: the rest is left for
unknown dependences and for parameters fitted finer than the grid of the bootstrap. Of 136
recordings of noise two would get a name at 0.01, none here."""

_DRAWS: Final = 300  # Their median gives the count to 8 %, and the threshold to 0.08 nats
_SEED: Final = 1  # Any: fixed to make the result of a recording reproducible


def maxima(residual: Residual, library: Library, model: Model, draws: int = _DRAWS) -> Floats:
    """Return the largest surprise [draws] of any effect in each draw of the noise."""
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
    """Return the number of independent hypotheses that have maxima [draws] like these.

    The chance that the largest of n stays below s is (1 - exp(-s))^n. n is taken from the median,
    which needs few draws, because the form of the tail is known: that of a single surprise.
    """
    return float(np.log(0.5) / np.log1p(-np.exp(-np.median(most))))


def alarm(count: float) -> float:
    """Return the surprise [nats] that noise exceeds with chance FALSE_ALARMS in `count` tests."""
    return float(-np.log(-np.expm1(np.log1p(-FALSE_ALARMS) / count)))


ALARM: Final = alarm(20.0)
"""Surprise [nats] from which a hypothesis is accepted: 8.3. By the bootstrap of the maximum
a recording's library amounts to 14 to 27 independent hypotheses."""

UNKNOWN_ALARM: Final = 16.0
"""The same for a smooth unknown dependence: higher, because noise that correlates with the motion
(a reference with time jitter) raises these tests, twenty with twelve parameters each. By how much
is a choice: nearly twice ALARM."""


def over_the_search(surprise: float, count: float) -> float:
    """Return the chance that under noise the best of `count` hypotheses has this surprise."""
    return float(-np.expm1(count * np.log1p(-np.exp(-min(surprise, 700.0)))))
