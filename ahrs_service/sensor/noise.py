"""What a sensor adds that no calibration takes away: noise and wandering bias."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt

from ahrs_service.kernel import kernel
from ahrs_service.records import Floats


@dataclass(frozen=True, slots=True)
class TriadNoise:
    """Noise of three gyros or accelerometers, in the unit of their output.

    `density` of the white noise [unit/sqrt(Hz)], `walk` of the bias [unit/s/sqrt(Hz)],
    `wander` 1-sigma [unit] and `wander_s` correlation time [s] of a first-order Gauss-Markov bias.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}
    density: Annotated[float, Ge(0.0)] = 0.0
    walk: Annotated[float, Ge(0.0)] = 0.0
    wander: Annotated[float, Ge(0.0)] = 0.0
    wander_s: Annotated[float, Gt(0.0)] = 100.0


@kernel
def _lag_rows(drive: Floats, keep: float, out: Floats) -> None:
    """Write x[n] = keep x[n-1] + drive[n], from x[0] = drive[0], for each column."""
    for j in range(drive.shape[1]):
        out[0, j] = drive[0, j]
        for i in range(1, drive.shape[0]):
            out[i, j] = keep * out[i - 1, j] + drive[i, j]


def first_order(drive: Floats, keep: float) -> Floats:
    """Return x [N, M] with x[n] = keep x[n-1] + drive[n] and x[0] = drive[0]."""
    out = np.empty(drive.shape)
    _lag_rows(np.ascontiguousarray(drive, np.float64), keep, out)
    return out


def gauss_markov(
    rng: np.random.Generator, shape: tuple[int, int], sigma: float, time_s: float, rate_hz: float
) -> Floats:
    """Return columns [N, M] of a stationary first-order Gauss-Markov process.

    Standard deviation `sigma`, correlation exp(-t / `time_s`), sampled at `rate_hz`.
    """
    keep = math.exp(-1.0 / (time_s * rate_hz))
    drive = rng.normal(0.0, sigma, shape)
    drive[1:] *= math.sqrt(1.0 - keep * keep)
    return first_order(drive, keep)


def sensor_noise(rng: np.random.Generator, count: int, rate_hz: float, noise: TriadNoise) -> Floats:
    """Return the noise [count, 3] of a triad sampled at `rate_hz`.

    White noise of density N has the standard deviation N sqrt(rate) (IEEE Std 952, annex C).
    """
    total = rng.normal(0.0, noise.density * math.sqrt(rate_hz), (count, 3))
    steps = rng.normal(0.0, noise.walk / math.sqrt(rate_hz), (count, 3))
    total += np.cumsum(steps, axis=0)
    total += gauss_markov(rng, (count, 3), noise.wander, noise.wander_s, rate_hz)
    return total
