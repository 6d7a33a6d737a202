"""Curves against scipy's piecewise polynomials, splines and Chebyshev series."""

import numpy as np
import pytest
from numpy.polynomial import Chebyshev
from scipy.interpolate import BSpline, PPoly, make_interp_spline

from ahrs_service.sensor.curve import Curve

BORDERS = np.linspace(-40.0, 70.0, 23)
GRID = np.linspace(-40.0, 70.0, 997)


def random(*shape):
    return np.random.default_rng(7).normal(size=shape)


def test_pieces_are_those_of_scipy():
    c = random(4, 22, 3)
    np.testing.assert_allclose(
        Curve.from_ppoly(BORDERS, c).at(GRID), PPoly(c, BORDERS)(GRID), rtol=1e-12
    )


def test_a_spline_is_met_exactly_and_its_repeated_knots_are_left_out():
    spline = make_interp_spline(BORDERS, random(23, 3))
    assert isinstance(spline, BSpline)
    knots = np.unique(spline.t)
    np.testing.assert_allclose(Curve.through(knots, spline).at(GRID), spline(GRID), atol=1e-12)
    column = make_interp_spline(BORDERS, random(23))
    pieces = PPoly.from_spline(column)
    assert len(pieces.x) > len(knots)
    curve = Curve.from_ppoly(pieces.x, pieces.c[..., None])
    assert len(curve.breaks_degc) == len(knots)
    np.testing.assert_allclose(curve.at(GRID)[:, 0], column(GRID), atol=1e-10)


def test_a_chebyshev_series_is_approached_with_the_fourth_power_of_the_segments():
    series = Chebyshev(random(9), domain=[-40.0, 70.0])
    errors = []
    for count in (12, 24, 48):
        curve = Curve.through(np.linspace(-40.0, 70.0, count), lambda t: series(t)[:, None])
        errors.append(np.abs(curve.at(GRID)[:, 0] - series(GRID)).max())
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 3.5).all(), (errors, rates)


def test_lines_meet_at_the_nodes_and_steps_jump():
    values = random(23, 3)
    lines = Curve.linear(BORDERS, values)
    for axis in range(3):
        np.testing.assert_allclose(
            lines.at(GRID)[:, axis], np.interp(GRID, BORDERS, values[:, axis]), atol=1e-12
        )
    steps = Curve.steps(BORDERS, values[:22])
    np.testing.assert_array_equal(steps.at(-35.0), values[1])
    np.testing.assert_array_equal(steps.at(np.nextafter(-35.0, -40.0)), values[0])
    np.testing.assert_array_equal(steps.at(70.0), values[21])


def test_beyond_the_borders_the_value_there_holds_and_nan_stays():
    curve = Curve.from_ppoly(BORDERS, random(4, 22, 3))
    np.testing.assert_array_equal(curve.at([-99.0, 99.0]), curve.at([-40.0, 70.0]))
    assert np.isnan(curve.at(np.nan)).all()


def test_more_borders_constants_and_factors_leave_the_rest():
    curve = Curve.from_ppoly(BORDERS, random(4, 22, 3))
    finer = curve.on(np.union1d(BORDERS, [-1.0, 0.3, 66.0]))
    assert len(finer.pieces) == 25
    np.testing.assert_allclose(finer.at(GRID), curve.at(GRID), rtol=1e-12, atol=1e-12)
    moved = curve.times((2.0, 0.0, -1.0)).plus((1.0, 2.0, 3.0))
    np.testing.assert_allclose(
        moved.at(GRID), curve.at(GRID) * (2.0, 0.0, -1.0) + (1.0, 2.0, 3.0), rtol=1e-12, atol=1e-12
    )
    assert Curve().times(2.0) == Curve()


@pytest.mark.parametrize(
    ("breaks", "pieces", "words"),
    [
        ((0.0, 1.0), (), "2 borders for 0 pieces"),
        ((0.0,), (((1.0,),),), "1 borders for 1 pieces"),
        ((1.0, 0.0), (((1.0,),),), "sort"),
        ((1.0, 1.0), (((1.0,),),), "once"),
        ((0.0, float("nan")), (((1.0,),),), "nan"),
        ((0.0, 1.0), (((1.0,) * 5,),), "1 to 4 coefficients"),
        ((0.0, 1.0), (((),),), "1 to 4 coefficients"),
        ((0.0, 1.0, 2.0), (((1.0,),), ((1.0,), (2.0,))), r"pieces\[1\] .*1 columns"),
        ((0.0, 1.0), (((float("inf"),),),), "finite"),
    ],
)
def test_a_wrong_curve_is_refused_in_a_sentence(breaks, pieces, words):
    with pytest.raises(ValueError, match=words):
        Curve(breaks, pieces)
