"""The seed's error budget (Liu et al., sec. 4) and the gate it feeds."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.app.files.config_file import from_json, load, to_json
from ahrs_service.constants import STANDARD_GRAVITY_M_S2 as G
from ahrs_service.errors import ConfigError
from ahrs_service.fusion.gating import (
    angular_acceleration_limit,
    in_force,
    limits,
    motion_reasons,
    norm_limit_from_acceleration,
    norm_limit_from_tilt,
    rate_limit,
)
from ahrs_service.pipeline import parameters
from ahrs_service.records import Gate
from ahrs_service.settings import FusionSettings, GateBudget, GateSettings, Settings


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


def budget(**values):
    return limits(Settings(gate_budget=GateBudget(**values)))


def test_a_norm_gate_admits_a_horizontal_acceleration_of_sqrt_2_g_eps():
    """The remark: norm(f) admits far more than the budget from which the width was made."""
    for eps in (0.01, 0.1, 0.3):
        admitted = math.sqrt(2.0 * G * eps)
        for share, reason in ((0.98, Gate.OPEN), (1.02, Gate.NORM)):
            norm_error = math.hypot(G, share * admitted) - G
            assert motion_reasons(np.array([norm_error, 0.0, 0.0]), eps, 1.0, 1.0) == reason
        assert math.atan(admitted / G) == pytest.approx(math.sqrt(2.0 * eps / G), rel=0.03)


def test_the_papers_width_for_one_degree_lets_thirty_degrees_through():
    # a_a = g tan(1 deg) = 0.171176: W_fx^2 = W_fy^2 = 1.128893, W_fz^2 = 0.009767, eps = 1.505827.
    width = budget(acceleration_m_s2=0.171176).norm_m_s2
    assert width == pytest.approx(math.sqrt(2 * 1.128893 + 0.009767), rel=1e-5)
    across = math.sqrt((G + width) ** 2 - G**2)
    assert math.degrees(math.atan(across / G)) == pytest.approx(29.9, abs=0.05)


def test_without_a_budget_the_explicit_limits_hold():
    gate = GateSettings(norm_m_s2=0.7, rate_rad_s=0.4, angular_acceleration_rad_s2=3.0)
    assert limits(Settings(gate=gate)) == gate


def test_each_budget_sets_its_own_limit_and_leaves_the_others():
    # Norm as above for 1 m/s^2; rate sqrt(0.5 / 50) = 0.1; angular 0.3 / hypot(0.3, 0.4) = 0.6.
    default = GateSettings()
    change = dataclasses.replace
    assert budget(acceleration_m_s2=1.0, norm_sigma_m_s2=0.2) == change(
        default, norm_m_s2=pytest.approx(3.951736, rel=1e-5)
    )
    assert budget(tilt_deg=10.0) == change(default, norm_m_s2=pytest.approx(0.151280, rel=1e-4))
    assert budget(centripetal_m_s2=0.5, turn_radius_m=50.0, rate_sigma_rad_s=0.02) == change(
        default, rate_rad_s=pytest.approx(0.12)
    )
    assert budget(
        tangential_m_s2=0.3, arm_m=(0.3, 9.0, 0.4), angular_acceleration_sigma_rad_s2=0.1
    ) == change(default, angular_acceleration_rad_s2=pytest.approx(0.7))


def test_a_sensor_farther_out_than_the_turn_is_wide_counts_by_its_arm():
    # norm(L) = sqrt(1 + 4 + 4) = 3, so sqrt(12 / 3) = 2.
    assert budget(centripetal_m_s2=12.0, turn_radius_m=1.0, arm_m=(1.0, 2.0, 2.0)).rate_rad_s == 2.0


@given(
    acceleration=st.floats(0.01, 5.0),
    more=st.floats(0.01, 5.0),
    radius=st.floats(1.0, 500.0),
    sigma=st.floats(0.0, 1.0),
)
def test_a_larger_budget_or_more_noise_opens_the_gate_and_a_wider_turn_closes_it(
    acceleration, more, radius, sigma
):
    def of(a, r, s):
        return budget(
            acceleration_m_s2=a,
            centripetal_m_s2=a,
            turn_radius_m=r,
            norm_sigma_m_s2=s,
            rate_sigma_rad_s=s,
        )

    base, larger = of(acceleration, radius, sigma), of(acceleration + more, radius, sigma)
    assert larger.norm_m_s2 > base.norm_m_s2
    assert larger.rate_rad_s > base.rate_rad_s
    assert of(acceleration, radius + more, sigma).rate_rad_s < base.rate_rad_s
    noisy = of(acceleration, radius, sigma + more)
    assert noisy.norm_m_s2 - base.norm_m_s2 == pytest.approx(more)
    assert noisy.rate_rad_s - base.rate_rad_s == pytest.approx(more)


def test_limits_of_limits_are_the_same():
    settings = Settings(gate_budget=GateBudget(tilt_deg=3.0, centripetal_m_s2=1, turn_radius_m=40))
    gate = limits(settings)
    assert limits(dataclasses.replace(settings, gate=gate)) == gate


def test_a_budget_is_a_setting_and_travels_with_the_recording(tmp_path):
    path = tmp_path / "seed.toml"
    path.write_text(
        "[gate_budget]\nacceleration_m_s2 = 0.2\ncentripetal_m_s2 = 0.2\nturn_radius_m = 60.0\n"
        "tangential_m_s2 = 0.2\narm_m = [0.1, 0.0, 0.0]\n"
    )
    settings = load(path, ["gate_budget.rate_sigma_rad_s=0.03"])
    assert settings.gate_budget == GateBudget(
        acceleration_m_s2=0.2,
        centripetal_m_s2=0.2,
        turn_radius_m=60.0,
        tangential_m_s2=0.2,
        arm_m=(0.1, 0.0, 0.0),
        rate_sigma_rad_s=0.03,
    )
    assert from_json(to_json(settings), "recording") == settings
    assert limits(settings).angular_acceleration_rad_s2 == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["acceleration_m_s2=0.2", "tilt_deg=1"], ["acceleration_m_s2 = 0.2", "tilt_deg = 1"]),
        (["centripetal_m_s2=0.2"], ["centripetal_m_s2 = 0.2", "turn_radius_m"]),
        (["tangential_m_s2=0.2", "arm_m=[0, 1, 0]"], ["tangential_m_s2 = 0.2", "arm_m", "1.0"]),
        (["tilt_deg=61"], ["gate_budget.tilt_deg", "61", "60"]),
        (["acceleration_m_s2=0"], ["gate_budget.acceleration_m_s2", "greater than 0"]),
        (["tilt=1"], ["gate_budget.tilt", "no such field", "tilt_deg"]),
    ],
)
def test_a_budget_from_which_no_limit_follows_is_refused(overrides, words):
    with pytest.raises(ConfigError) as caught:
        load(overrides=[f"gate_budget.{override}" for override in overrides])
    for word in words:
        assert word in str(caught.value)


def test_a_budget_holds_in_the_gated_mode_alone():
    budget = GateBudget(tilt_deg=3.0)
    gated = Settings(gate_budget=budget, fusion=FusionSettings(mode="gated"))
    assert in_force(gated) == limits(gated) != gated.gate
    assert parameters(gated)["gate_norm_m_s2"][0] == in_force(gated).norm_m_s2
    by_velocity = Settings(gate_budget=budget)
    assert in_force(by_velocity) == by_velocity.gate
    assert parameters(by_velocity)["gate_norm_m_s2"][0] == by_velocity.gate.norm_m_s2
