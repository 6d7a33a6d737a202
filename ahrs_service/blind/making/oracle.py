"""The gain of an oracle that knows an effect's exact shape and the noise spectra.

For Gaussian noise of density P the expected gain in log-likelihood is

    1/2 sum over axes, frequencies of |S(f)|^2 / P(f),

with S the effect's spectrum by the discrete cosine transform, whose even continuation has no
jump at the ends (a Fourier transform would have one). The turn-on bias is unknown: f = 0 is
excluded.
"""

import math
from typing import Any, Final

import numpy as np
from scipy.fft import dct

from ahrs_service.blind.making.naming import report
from ahrs_service.blind.making.physics import Hidden, Scene, Signals
from ahrs_service.blind.making.recording_noise import NoiseLaw
from ahrs_service.records import Floats

LEVEL_NATS: Final = {1: 1000.0, 2: 150.0, 3: 30.0}
"""Gain of the oracle at the three depths of concealment [nats]."""

_TOLERANCE: Final = 0.02
"""A choice: depth of concealment to 2 %, the size to 1 % (gain is proportional to its square)."""
_TRIALS: Final = 40  # A choice: limit on secant steps; in logarithms the function is nearly linear


def gain(signals: Signals, law: NoiseLaw, rate_hz: float) -> float:
    """Return the oracle's expected gain for signals of gyro and accelerometer [nats]."""
    count = len(signals[0])
    frequency = np.arange(count, dtype=np.float64) * (rate_hz / (2.0 * count))
    total = 0.0
    for values, psd in zip(
        signals, (law.gyro_psd(frequency), law.accel_psd(frequency)), strict=True
    ):
        if values.any():
            total += _information(values, psd, rate_hz)
    return total


def _information(values: Floats, psd: Floats, rate_hz: float) -> float:
    """Half the whitened energy of `values` [N, 3] under the one-sided densities [N, 3]."""
    power = dct(values, norm="ortho", axis=0)[1:] ** 2
    return float(0.5 * np.sum(power / (0.5 * rate_hz * psd[1:])))


def scaled_to(hidden: Hidden, scene: Scene, law: NoiseLaw, nats: float) -> float:
    """Return the size at which the oracle gains `nats`.

    Secant method in logarithms (gain is nearly proportional to the square of the size), each step
    at most a factor of ten. Raises ValueError where no size gives it.
    """
    size, slope = 1.0, 2.0
    previous: tuple[float, float] | None = None
    for _ in range(_TRIALS):
        found = gain(hidden.signals(scene, size), law, scene.rate_hz)
        if found > 0.0 and abs(found / nats - 1.0) < _TOLERANCE:
            return size
        if found <= 0.0:
            size *= 2.0
            continue
        if previous is not None and size != previous[0]:
            slope = math.log(found / previous[1]) / math.log(size / previous[0])
            slope = min(max(slope, 0.5), 8.0)
        previous = size, found
        size *= min(max((nats / found) ** (1.0 / slope), 0.1), 10.0)
    raise ValueError(f"{hidden.effect}: no size gives the oracle {nats:g} nats here")


ALARM_NATS: Final = math.log(32 / 0.02)
"""Log-likelihood above which the oracle names an effect: 2 % over the catalogue's 32."""


def share_of_gain(found: Signals, hidden: Signals, law: NoiseLaw, rate_hz: float) -> float:
    """Return the gain of a model `found` on new data as a share of the oracle's.

    With residual s - m the expected gain of the model m is 1/2 (|s|^2 - |s - m|^2) in the
    noise's metric, the oracle's 1/2 |s|^2.
    """
    missed = (hidden[0] - found[0], hidden[1] - found[1])
    return 1.0 - gain(missed, law, rate_hz) / gain(hidden, law, rate_hz)


def oracle_report(truth: dict[str, Any], rng: np.random.Generator) -> dict[str, Any] | None:
    """Return the oracle's report: its statistic is drawn from its exact distribution N(G, 2 G).

    On a null it tests the catalogue's shapes at level 3, one after another. None where the truth
    does not contain the oracle's gain.
    """
    effects = [entry for entry in truth["effects"] if entry["effect"] != "none"]
    if any("oracle_nats" not in entry for entry in effects):
        return None
    named = [entry for entry in effects if _believes(entry["oracle_nats"], rng, True)]
    if not effects:
        false = [n for n in range(32) if _believes(LEVEL_NATS[3], rng, False)]
        return report(["none"] * len(false))
    unknown = [e["params"]["depends_on"] for e in named if e["effect"] == "unknown"]
    answer = report([e["effect"] for e in named if e["effect"] != "unknown"])
    answer["unexplained"] = [{"depends_on": [word]} for word in unknown]
    for finding in answer["effects"] if truth.get("inseparable") else ():
        finding["class"] = [finding["effect"], "its like"]
    return answer


def _believes(nats: float, rng: np.random.Generator, is_there: bool) -> bool:
    mean = nats if is_there else -nats
    return bool(rng.normal(mean, math.sqrt(2.0 * nats)) > ALARM_NATS)
