"""Intervals that know that the noise is fitted: against quadrature, coverage, contradictions."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from ahrs_service.diagnosis.hypotheses.candidates import Term
from ahrs_service.diagnosis.hypotheses.likelihood import Posterior, fit, fit_noise
from ahrs_service.diagnosis.hypotheses.model import Model
from ahrs_service.diagnosis.judgement.uncertainty import (
    CHOSEN,
    covariance_by_blocks,
    marginal_covariance,
    variances,
)
from ahrs_service.diagnosis.noise_model.kalman import whiten_channel
from ahrs_service.effects.catalogue import EFFECTS

STEP_S, TIME_S = 1.0, 30.0
TRUE = np.log([1.0, 1.0])
EFFECT = EFFECTS["gyro_scale_factor"]


@dataclass
class Wandering:
    """Six channels of white noise and wander of known time: two noise parameters for all."""

    rows: np.ndarray
    noise_names: tuple[str, ...] = ("white", "wander")
    missing: np.ndarray = field(init=False)

    def __post_init__(self):
        self.missing = np.zeros(len(self.rows))

    def first_noise(self):
        return TRUE

    def noise_bounds(self):
        return [(-5.0, 5.0), (-5.0, 5.0)]

    def whiten(self, noise, rows):
        white, wander = np.exp(2.0 * noise)
        out, log_variance = np.empty(rows.shape), np.empty(rows.shape[:2])
        for n in range(6):
            part, into = np.ascontiguousarray(rows[:, n]), np.empty((len(rows), rows.shape[2]))
            logs, keep = np.empty(len(rows)), float(np.exp(-STEP_S / TIME_S))
            whiten_channel(part, self.missing, white, wander, keep, into, logs)
            out[:, n], log_variance[:, n] = into, logs
        return out, log_variance

    def grams(self, rows):
        def gram(noise):
            white, log_variance = self.whiten(noise, rows)
            flat = white.reshape(-1, rows.shape[2])
            return flat.T @ flat, float(log_variance.sum())

        return gram


def responses(count):
    """Return a bias of each channel, and a slope of each of the first three [N, 6, 9]."""
    base = np.zeros((count, 6, 9))
    for n in range(6):
        base[:, n, n] = 1.0
    for n in range(3):
        base[:, n, 6 + n] = np.linspace(-1.0, 1.0, count)
    return base


def draw(rng, count):
    """Return white noise and wander [N, 6]."""
    keep = np.exp(-STEP_S / TIME_S)
    wander = np.zeros((count, 6))
    wander[0] = rng.normal(size=6)
    for n in range(1, count):
        wander[n] = keep * wander[n - 1] + np.sqrt(1.0 - keep**2) * rng.normal(size=6)
    return wander + rng.normal(size=(count, 6))


def fitted(rows):
    """Return residual and model: bias and slopes fitted with the noise."""
    residual, base, prior = Wandering(rows), responses(len(rows)), np.zeros((10, 10))
    noise = fit_noise(residual, base, rows, prior, TRUE)
    found = fit(residual, noise, base, rows, prior)
    term = Term(EFFECT, EFFECT.neutral())
    empty = np.empty((*rows.shape, 0))
    model = Model(
        (term,), (), empty, noise, 0.0, found.covariance[6:, 6:], rows, base, prior
    )  # fmt: skip
    return residual, model, found


def test_the_covariance_is_that_of_a_quadrature_over_the_noise():
    residual, model, _ = fitted(draw(np.random.default_rng(5), 40))
    rows = np.concatenate([model.base, model.misfit[:, :, None]], axis=2)
    posterior = Posterior(residual, rows, model.prior)
    costs, means, inner = [], [], []
    for white in model.noise[0] + np.linspace(-0.5, 0.5, 41):
        for wander in model.noise[1] + np.linspace(-2.5, 2.5, 61):
            cost, found = posterior.cost(np.array([white, wander]))[:2]
            costs.append(cost)
            means.append(found.coefficients[6:])
            inner.append(found.covariance[6:, 6:])
    weights = np.exp(min(costs) - np.array(costs))
    weights /= weights.sum()
    apart = np.array(means) - weights @ np.array(means)
    expected = np.tensordot(weights, inner, axes=1) + (weights * apart.T) @ apart
    np.testing.assert_allclose(
        np.diag(marginal_covariance(residual, model)), np.diag(expected), rtol=0.1
    )


def test_a_noise_that_is_known_adds_nothing():
    residual, model, _ = fitted(draw(np.random.default_rng(6), 3000))
    found = marginal_covariance(residual, model)
    np.testing.assert_allclose(np.diag(found), np.diag(model.covariance), rtol=0.1)


def test_intervals_hold_the_truth_as_often_as_they_say():
    rng, inside = np.random.default_rng(7), []
    for _ in range(150):
        residual, model, found = fitted(draw(rng, 40))
        sigma = np.sqrt(np.diag(marginal_covariance(residual, model)))
        inside += list(np.abs(found.coefficients[6:]) < 1.96 * sigma)
    # Of 450 at 95 % three sigma are 3.1 %.
    assert np.mean(inside) == pytest.approx(0.95, abs=0.031)


def test_without_contradiction_blocks_tell_the_same_and_with_it_more():
    rng, ratios = np.random.default_rng(8), {}
    for name, size in (("alike", 1.0), ("louder", 3.0)):
        found = []
        for _ in range(30):
            rows = draw(rng, 300)
            # Noise of three times the size in the last fifth, which determines the slopes most.
            rows[240:] *= size
            residual, model, _ = fitted(rows)
            blocks = np.diag(covariance_by_blocks(residual, model))
            found.append(blocks / np.diag(model.covariance))
        ratios[name] = np.mean(found)
    assert ratios["alike"] == pytest.approx(1.0, abs=0.25)
    assert ratios["louder"] > 1.3


def test_a_form_that_nature_rounds_off_widens_by_its_share():
    rows = draw(np.random.default_rng(9), 60)
    residual, model, _ = fitted(rows)
    effect = EFFECTS["gyro_thermal_hysteresis"]
    term = Term(effect, {**effect.neutral(), "half_amplitude": np.array([1.0, -2.0, 0.0])})
    # The width's column makes four of the base's last numbers, the half amplitudes first.
    column = np.random.default_rng(10).normal(size=(60, 6, 1))
    base = np.concatenate([model.base, column], axis=2)
    model = replace(model, terms=(term,), base=base, prior=np.zeros((11, 11)))
    plain = np.maximum(
        np.diag(marginal_covariance(residual, model)),
        np.diag(covariance_by_blocks(residual, model)),
    )
    share = next(p.form_share for p in effect.parameters if p.name == "half_amplitude")
    added = variances(residual, model) - CHOSEN**2 * plain
    np.testing.assert_allclose(
        added, [share**2, 4.0 * share**2, 0.0, 0.0], rtol=1e-6, atol=1e-12
    )  # fmt: skip
