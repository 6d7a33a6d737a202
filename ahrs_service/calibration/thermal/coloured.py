"""What residuals say when neighbours in time are alike: errors of a fit, heating against cooling.

Least squares takes every row for a new witness. A slow wander of the bias makes many rows say the
same; the covariance then grows by 1 + 2 sum rho, rho the autocorrelation of the residual.
"""

from dataclasses import dataclass

import numpy as np

from ahrs_service.records import Floats


def inflation(residual: Floats) -> float:
    """Return 1 + 2 sum rho of a residual [N] in order of time, at least 1.

    The sum ends where the lag exceeds five times the sum itself (Sokal, Monte Carlo Methods in
    Statistical Mechanics, sec. 3), since beyond it adds noise alone.
    """
    count = len(residual)
    if count < 4:
        return 1.0
    centred = residual - residual.mean()
    spectrum = np.abs(np.fft.rfft(centred, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[: count // 2]
    if not correlation[0] > 0.0:
        return 1.0
    sums = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
    beyond = np.arange(len(sums)) >= 2.5 * sums
    stop = int(np.argmax(beyond)) if beyond.any() else len(sums) - 1
    return max(1.0, float(sums[stop]))


@dataclass(frozen=True, slots=True)
class Hysteresis:
    """Heating minus cooling of a residual at like temperatures.

    `temperature_degc` [M] middles of the bins that saw both, `difference` [M, 3] in the residual's
    unit, `sigma` [M, 3] its standard error.
    """

    temperature_degc: Floats
    difference: Floats
    sigma: Floats

    @property
    def largest(self) -> Floats | None:
        """Largest difference per axis [3], None where no bin saw both directions."""
        if not len(self.difference):
            return None
        largest: Floats = np.abs(self.difference).max(axis=0)
        return largest


def hysteresis(
    temperature_degc: Floats,
    rate_degc_s: Floats,
    residual: Floats,
    bins: int = 12,
    least_rows: int = 5,
) -> Hysteresis:
    """Compare the residual [N, 3] of heating and cooling in `bins` equal bins of temperature.

    `rate_degc_s` [N] of the temperature; rows slower than a tenth of the usual rate count as
    neither. A bin needs `least_rows` of each.
    """
    speed = np.abs(rate_degc_s)
    moving = speed > 0.1 * np.median(speed[speed > 0.0]) if (speed > 0.0).any() else speed > 0.0
    edges = np.linspace(temperature_degc.min(), temperature_degc.max(), bins + 1)
    place = np.clip(np.searchsorted(edges, temperature_degc, "right") - 1, 0, bins - 1)
    middles, differences, sigmas = [], [], []
    for n in range(bins):
        parts = [residual[moving & (place == n) & up] for up in (rate_degc_s > 0, rate_degc_s < 0)]
        if min(len(part) for part in parts) < least_rows:
            continue
        middles.append(0.5 * (edges[n] + edges[n + 1]))
        differences.append(parts[0].mean(axis=0) - parts[1].mean(axis=0))
        sigmas.append(np.sqrt(sum(_variance_of_mean(part) for part in parts)))
    shape = (-1, residual.shape[1])
    return Hysteresis(np.array(middles), np.reshape(differences, shape), np.reshape(sigmas, shape))


def _variance_of_mean(rows: Floats) -> Floats:
    spread = rows.var(axis=0, ddof=1) / len(rows)
    return np.array([spread[i] * inflation(rows[:, i]) for i in range(rows.shape[1])])
