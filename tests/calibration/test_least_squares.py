"""The solvers against scipy, and the covariances against scatter."""

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares

from ahrs_service.calibration.least_squares import gauss_newton, linear_fit
from ahrs_service.calibration.multi_pose import norm_residuals
from ahrs_service.errors import CalibrationError


def curve(parameters, t, y):
    a, b = parameters
    decay = np.exp(-b * t)
    return a * decay - y, np.stack([decay, -a * t * decay], axis=1)


def test_gauss_newton_finds_what_scipy_finds():
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 3.0, 40)
    y = 2.0 * np.exp(-0.7 * t) + rng.normal(0.0, 0.05, 40)
    ours = gauss_newton(lambda p: curve(p, t, y), np.array([1.0, 1.0]))
    theirs = least_squares(
        lambda p: curve(p, t, y)[0],
        [1.0, 1.0],
        jac=lambda p: curve(p, t, y)[1],
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert ours.parameters == pytest.approx(theirs.x, rel=1e-8)
    hessian = theirs.jac.T @ theirs.jac
    variance = 2.0 * theirs.cost / (40 - 2) * np.linalg.inv(hessian)
    assert ours.covariance == pytest.approx(variance, rel=1e-6)


def test_the_norm_fit_finds_what_scipy_finds_without_a_jacobian():
    rng = np.random.default_rng(2)
    up = rng.normal(size=(20, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    force = 9.8 * up @ (np.eye(3) + 0.03 * rng.normal(size=(3, 3))).T + rng.normal(0, 0.1, 3)
    force += rng.normal(0.0, 0.01, force.shape)
    start = np.array([1.0, 1.0, 1.0, 0, 0, 0, 0, 0, 0])
    evaluate = norm_residuals(force, 9.8)
    ours = gauss_newton(evaluate, start)
    theirs = least_squares(lambda p: evaluate(p)[0], start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert ours.parameters == pytest.approx(theirs.x, abs=1e-6)


def test_gauss_newton_converges_quadratically_without_noise():
    t = np.linspace(0.0, 3.0, 40)
    y = 2.0 * np.exp(-0.7 * t)
    seen = []

    def evaluate(p):
        seen.append(np.abs(p - [2.0, 0.7]).max())
        return curve(p, t, y)

    gauss_newton(evaluate, np.array([1.8, 0.6]))
    errors = [error for error in seen if 1e-12 < error < 0.05]
    assert len(errors) >= 2
    for before, after in itertools.pairwise(errors):
        assert after < 3.0 * before**2


def test_a_linear_fit_says_what_it_cannot_know():
    design = np.stack([np.ones(5), np.zeros(5)], axis=1)
    fit = linear_fit(design, np.arange(5.0))
    assert np.isinf(fit.standard_errors).all()
    assert np.isinf(fit.condition)
    exact = linear_fit(np.eye(2), np.array([1.0, 2.0]))
    assert exact.parameters == pytest.approx([1.0, 2.0])
    assert np.isinf(exact.standard_errors).all()


def test_a_fit_that_does_not_settle_is_refused():
    def evaluate(p):
        # Decreases for ever: there is no minimum.
        return np.array([np.exp(-p[0])]), np.array([[-np.exp(-p[0])]])

    with pytest.raises(CalibrationError, match="does not settle"):
        gauss_newton(evaluate, np.array([0.0]))
