"""The rivals: their choices on known data, and the conditions of their optima."""

import numpy as np
import pytest

from ahrs_service.blind.judging.baselines import (
    ALARM,
    _descend,
    _Moments,
    lasso,
    stepwise_bic,
    stepwise_f,
)
from ahrs_service.blind.judging.naive import Regression

COUNT = 2000


def white(seed, strength=0.0):
    """White noise with, at a strength, one of twenty effects in it."""
    rng = np.random.default_rng(seed)
    blocks = {f"effect_{n}": rng.standard_normal((COUNT, 3)) for n in range(20)}
    residual = rng.standard_normal(COUNT)
    residual += strength * blocks["effect_7"] @ np.array([1.0, -0.5, 0.7])
    return Regression(residual, blocks)


def named(report):
    return [finding["effect"] for finding in report["effects"]]


@pytest.mark.parametrize("choose", [stepwise_f, stepwise_bic, lasso])
def test_a_planted_effect_comes_first(choose):
    assert named(choose(white(1, 0.2)))[0] == "effect_7"


def test_on_white_noise_the_f_test_alarms_as_seldom_as_it_says():
    alarms = sum(bool(named(stepwise_f(white(seed)))) for seed in range(150))
    # 150 draws at 2 %: more than 8 has a probability of 0.4 %.
    assert alarms <= 8
    assert ALARM == 0.02


def test_on_white_noise_bic_stays_silent():
    assert sum(bool(named(stepwise_bic(white(seed)))) for seed in range(20)) == 0


def test_the_lasso_meets_its_conditions_of_optimality():
    moments = _Moments(white(3, 0.1))
    weights = np.zeros(len(moments.inner))
    penalty = 0.3 * np.abs(moments.inner).max()
    _descend(moments, weights, penalty)
    slack = moments.inner - moments.gram @ weights
    inside = weights != 0.0
    assert 0 < inside.sum() < len(weights)
    assert slack[inside] == pytest.approx(penalty * np.sign(weights[inside]), rel=1e-3)
    assert np.abs(slack[~inside]).max() <= penalty
