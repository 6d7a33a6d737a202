"""Temperature bases against scipy's evaluation and the properties of any spline basis."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PPoly

from ahrs_service.calibration.thermal.basis import LADDER, Basis, segments
from ahrs_service.calibration.thermal.drift_records import columns_of, curve_of, sum_of

INSIDE = np.linspace(-40.0, 70.0, 301)


@pytest.mark.parametrize("order", LADDER)
def test_the_functions_sum_to_one_and_hold_their_value_outside(order):
    basis = Basis(-40.0, 70.0, *order)
    assert basis.values(INSIDE).sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    assert basis.values(np.array([-80.0, 200.0])) == pytest.approx(
        basis.values(np.array([-40.0, 70.0]))
    )


@pytest.mark.parametrize("order", LADDER[1:])
@pytest.mark.parametrize("zero", [-40.0, 25.0, 70.0])
def test_zeroed_curves_are_zero_there_and_otherwise_complete(order, zero):
    basis = Basis(-40.0, 70.0, *order)
    zeroed = basis.zeroed(INSIDE, zero)
    assert basis.zeroed(np.array([zero]), zero) == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.matrix_rank(zeroed) == basis.size - 1
    weights = np.random.default_rng(1).normal(size=(basis.size - 1, 2))
    coefficients = basis.coefficients_of_zeroed(weights, zero)
    assert basis.values(INSIDE) @ coefficients == pytest.approx(zeroed @ weights, abs=1e-10)


@given(st.sampled_from(LADDER), st.integers(0, 99), st.floats(-60.0, 90.0))
def test_a_curve_of_the_calibration_is_the_spline(order, seed, degc):
    basis = Basis(-38.7, 71.3, *order)
    coefficients = np.random.default_rng(seed).normal(size=(basis.size, 3))
    curve = curve_of(basis, coefficients)
    expected = basis.values(np.array([degc])) @ coefficients
    assert curve.at(np.array([degc])) == pytest.approx(expected, abs=1e-9)


def test_polynomials_have_the_form_of_scipy():
    basis = Basis(-10.0, 50.0, 3, 6)
    coefficients = np.random.default_rng(2).normal(size=(basis.size, 2))
    pieces = PPoly(basis.polynomials(coefficients), basis.breaks)
    inside = np.linspace(-10.0, 49.9, 200)
    assert pieces(inside) == pytest.approx(basis.values(inside) @ coefficients, abs=1e-10)


def test_all_orders_together_fit_the_kernels_table():
    """Curves of any orders share their borders: one triad's never exceed the 64 segments."""
    rng = np.random.default_rng(3)
    bases = [Basis(-39.93, 70.07, *order) for order in LADDER]
    parts = [(basis, rng.normal(size=(basis.size, 1))) for basis in bases]
    curve = columns_of(parts)
    assert len(curve.pieces) == 32
    total = sum_of(curve, curve).at(INSIDE)
    alone = [basis.values(INSIDE) @ coefficients for basis, coefficients in parts]
    assert total == pytest.approx(2.0 * np.hstack(alone), abs=1e-9)


def test_the_papers_segments():
    assert segments() == 22
    assert segments(20.0, 21.0) == 1
