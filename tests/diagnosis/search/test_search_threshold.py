"""Chances over a whole search against independent hypotheses, whose maximum is known."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import kstest

from ahrs_service.diagnosis.hypotheses.candidates import Candidate, Library
from ahrs_service.diagnosis.hypotheses.score_test import screen
from ahrs_service.diagnosis.search.search_threshold import (
    FALSE_ALARMS,
    alarm,
    hypotheses,
    maxima,
    over_the_search,
)
from ahrs_service.effects.catalogue import EFFECTS


@dataclass
class White:
    """Rows of unit white noise: only what a Gram matrix needs."""

    rows: np.ndarray

    def grams(self, rows):
        flat = rows.reshape(-1, rows.shape[2])
        return lambda noise: (flat.T @ flat, 0.0)


@dataclass
class Empty:
    """A model with only a column of ones."""

    base: np.ndarray
    misfit: np.ndarray
    noise: np.ndarray


def library_of(rows, repeats):
    """Return columns `rows` [N, 6, K] as hypotheses of one number each, `repeats` times all."""
    effect = EFFECTS["imu_time_offset"]
    count = rows.shape[2]
    candidates = [
        Candidate(str(n), effect.triad, effect, "", {}, slice(n, n + 1), 1)
        for n in range(repeats * count)
    ]
    return Library(candidates, np.concatenate([rows] * repeats, axis=2))


def empty(rows, misfit):
    return Empty(np.ones((*rows.shape[:2], 1)), misfit, np.zeros(1))


@pytest.mark.parametrize("repeats", [1, 3])
def test_independent_hypotheses_are_counted_and_repetitions_are_not(repeats):
    rng = np.random.default_rng(2)
    rows = 1e4 * rng.normal(size=(600, 6, 18))
    residual = White(rows)
    model = empty(rows, np.zeros(rows.shape[:2]))
    most = maxima(residual, library_of(rows, repeats), model, draws=4000)
    assert hypotheses(most) == pytest.approx(18.0, rel=0.08)


def test_the_chances_of_recordings_of_noise_are_uniform():
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(200, 6, 12)) * np.logspace(3, 15, 12)
    residual, library, chances = White(rows), library_of(rows, 2), []
    count = hypotheses(maxima(residual, library, empty(rows, np.zeros(rows.shape[:2])), draws=4000))
    for _ in range(400):
        model = empty(rows, rng.normal(size=rows.shape[:2]))
        gains = screen(residual, model.noise, library, model.base, model.misfit)
        chances.append(over_the_search(float(gains.surprise.max()), count))
    assert kstest(chances, "uniform").pvalue > 0.01


def test_the_alarm_is_the_surprise_of_its_chance():
    for count in (1.0, 14.0, 27.0):
        assert over_the_search(alarm(count), count) == pytest.approx(FALSE_ALARMS)
    assert over_the_search(1e4, 20.0) == pytest.approx(0.0, abs=1e-200)
