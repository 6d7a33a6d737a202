"""Whether the innovations of a model are white and Gaussian, as its noise model requires."""

from typing import Final

import numpy as np
from scipy.stats import chi2

from ahrs_service.diagnosis.hypotheses.likelihood import fit
from ahrs_service.diagnosis.hypotheses.model import Model
from ahrs_service.diagnosis.input.misfit import Residual
from ahrs_service.diagnosis.result import Whiteness
from ahrs_service.records import Floats

_LAGS: Final = 20  # A choice: two seconds of rows 0.1 s apart
_GLITCH_SIGMA: Final = 5.0
"""Of 8000 Gaussian innovations 0.005 lie beyond it: larger ones are glitches."""


def innovations(residual: Residual, model: Model) -> Floats:
    """Return the whitened innovations [N, 6] of a model, without rows that lack a reference."""
    found = fit(residual, model.noise, model.base, model.misfit, model.prior)
    rows = np.concatenate([model.base, model.misfit[:, :, None]], axis=2)
    white, _ = residual.whiten(model.noise, rows)
    left = white[:, :, -1] - white[:, :, :-1] @ found.coefficients
    return left[residual.missing == 0.0]


def whiteness(residual: Residual, model: Model) -> Whiteness:
    """Return the p-values of the Ljung-Box and Jarque-Bera tests per channel."""
    # Where a channel was not measured its innovation is zero.
    left = [column[column != 0.0] for column in innovations(residual, model).T]
    return Whiteness(
        tuple(_ljung_box(column) for column in left),
        tuple(_jarque_bera(column) for column in left),
    )


def _ljung_box(x: Floats) -> float:
    """Ljung and Box 1978: n (n + 2) sum r_k^2 / (n - k) is chi-squared of the lags."""
    count, energy = len(x), float(x @ x)
    shares = [float(x[k:] @ x[:-k]) / energy for k in range(1, _LAGS + 1)]
    total = sum(r * r / (count - k) for k, r in enumerate(shares, start=1))
    return float(chi2.sf(count * (count + 2.0) * total, _LAGS))


def _jarque_bera(x: Floats) -> float:
    x = (x - x.mean()) / x.std()
    x = x[np.abs(x) < _GLITCH_SIGMA]
    skew, tails = np.mean(x**3), np.mean(x**4) - 3.0
    return float(chi2.sf(len(x) / 6.0 * (skew**2 + tails**2 / 4.0), 2))
