"""The seed's error budget (Liu et al., sec. 4) and the gate it feeds."""

import math

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2 as G
from ahrs_service.fusion.gating import (
    angular_acceleration_limit,
    motion_reasons,
    norm_limit_from_acceleration,
    norm_limit_from_tilt,
    rate_limit,
)
from ahrs_service.records import Gate


@pytest.mark.parametrize("tilt_deg", [0.5, 2.0, 10.0])
def test_tilt_budget_is_the_norm_of_a_force_tilted_by_it(tilt_deg):
    tilt = math.radians(tilt_deg)
    horizontal = G * math.tan(tilt)
    assert norm_limit_from_tilt(tilt) == pytest.approx(math.hypot(G, horizontal) - G, rel=1e-9)


def test_tilt_budget_follows_the_remark_on_small_widths():
    # A norm gate of width eps admits a tilt error of about sqrt(2 eps / g).
    eps = norm_limit_from_tilt(0.02)
    assert math.sqrt(2 * eps / G) == pytest.approx(0.02, rel=1e-3)


def test_acceleration_budget_matches_the_formula_by_hand():
    # a_a = 1: ((1 + g)^2 - g^2) / 3 = (1 + 2 g) / 3 = 6.87110; twice that + 1/3 = 14.07553.
    assert norm_limit_from_acceleration(1.0) == pytest.approx(math.sqrt(14.07553), rel=1e-5)
    assert norm_limit_from_acceleration(1.0, 0.2) == pytest.approx(3.951736, rel=1e-5)


def test_rate_budget_takes_the_larger_radius():
    assert rate_limit(0.5, 50.0, 0.1) == pytest.approx(0.1)
    assert rate_limit(0.5, 0.05, 0.5, 0.03) == pytest.approx(1.03)


def test_angular_acceleration_budget_is_tangential_over_the_arm():
    assert angular_acceleration_limit(0.3, (0.3, 5.0, 0.4)) == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("metrics", "reasons"),
    [
        ((0.1, 0.1, 0.1), Gate.OPEN),
        ((1.1, 0.1, 0.1), Gate.NORM),
        ((0.1, 1.1, 0.1), Gate.RATE),
        ((0.1, 0.1, 1.1), Gate.ANGULAR_ACCELERATION),
        ((1.1, 1.1, 1.1), Gate.NORM | Gate.RATE | Gate.ANGULAR_ACCELERATION),
        ((math.nan, 0.1, 0.1), Gate.NORM),
    ],
)
def test_every_limit_has_its_reason(metrics, reasons):
    assert motion_reasons(np.array(metrics), 1.0, 1.0, 1.0) == reasons
