"""Blocks that contradict each other, against the scatter that noise of known colour has."""

import numpy as np
import pytest
from scipy.signal import lfilter

from ahrs_service.diagnosis.judgement.agreement import _ratio

BLOCKS, LENGTH = 12, 2000


def ratio_of(noise, regressors):
    """The ratio for regressors [N, K] fitted to a noise [N] assumed white with sigma 1."""
    solution, *_ = np.linalg.lstsq(regressors, noise, rcond=None)
    left = noise - regressors @ solution
    pieces = np.array_split(np.arange(len(noise)), BLOCKS)
    grams = np.array([regressors[b].T @ regressors[b] for b in pieces])
    scores = np.array([regressors[b].T @ left[b] for b in pieces])
    return _ratio(grams, scores)


def test_white_noise_agrees_with_itself():
    rng = np.random.default_rng(1)
    runs = [
        ratio_of(rng.normal(size=BLOCKS * LENGTH), rng.normal(size=(BLOCKS * LENGTH, 3)))
        for _ in range(200)
    ]
    # One in a thousand each.
    assert sum(value > 1.0 for value in runs) <= 2


@pytest.mark.parametrize("memory", [0.6, 0.9])
def test_coloured_noise_scatters_by_its_variance_in_the_long_run(memory):
    rng = np.random.default_rng(2)
    constant = np.ones((BLOCKS * LENGTH, 1))
    runs = []
    for _ in range(60):
        white = rng.normal(size=BLOCKS * LENGTH)
        coloured = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white)
        runs.append(ratio_of(coloured, constant))
    # Of AR(1) noise of variance 1 a mean has the variance of white noise times (1 + a) / (1 - a).
    expected = (1.0 + memory) / (1.0 - memory)
    assert np.mean(runs) == pytest.approx(expected, rel=0.2)


def test_halves_of_opposite_sign_contradict_each_other():
    rng = np.random.default_rng(3)
    count = BLOCKS * LENGTH
    regressor = rng.normal(size=(count, 1))
    signs = np.where(np.arange(count) < count // 2, 1.0, -1.0)
    noise = rng.normal(size=count) + 0.1 * signs * regressor[:, 0]
    # The numbers of the blocks are +-0.1 with sigma LENGTH**-0.5, whose mean square over B - 1 is:
    expected = (BLOCKS - 1 + BLOCKS * 0.01 * LENGTH) / (BLOCKS - 1)
    assert ratio_of(noise, regressor) == pytest.approx(expected, rel=0.35)


def test_blocks_that_tell_nothing_do_not_count():
    rng = np.random.default_rng(4)
    count = BLOCKS * LENGTH
    regressor = np.zeros((count, 1))
    regressor[:LENGTH] = rng.normal(size=(LENGTH, 1))
    assert ratio_of(rng.normal(size=count), regressor) == 1.0
