"""The score of a blind set, against cases counted by hand and published intervals."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.blind.judging.scoring import Rate, judge, score

NULL = {"kind": "flight", "level": 1, "effects": []}


def truth(*effects, **rest):
    return {"kind": "bench", "level": 2, "effects": list(effects)} | rest


def hidden(name, params=None, **rest):
    return {"effect": name, "params": params or {}} | rest


def finding(name, *alike, gain=1.0, **parameters):
    return {
        "effect": name,
        "class": [name, *alike],
        "parameters": parameters,
        "holdout": {"log_likelihood_gain": gain},
    }


def report(*effects, unexplained=(), verdict=None):
    verdict = verdict or ("explained" if effects else "no_mismatch")
    return {"verdict": verdict, "effects": list(effects), "unexplained": list(unexplained)}


@pytest.mark.parametrize(
    ("hits", "total", "low", "high"),
    [
        # Newcombe, Statistics in Medicine 17 (1998) 857, table I, method 3.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_intervals_are_the_published_ones(hits, total, low, high):
    assert Rate(hits, total).interval() == pytest.approx((low, high), abs=5e-5)


@given(st.integers(1, 500), st.data())
def test_a_wilson_interval_holds_the_share(total, data):
    rate = Rate(data.draw(st.integers(0, total)), total)
    low, high = rate.interval()
    assert 0.0 <= low <= rate.share + 1e-12
    assert rate.share - 1e-12 <= high <= 1.0


def test_of_nothing_there_is_no_share():
    assert math.isnan(Rate.of([None, None]).share)
    assert Rate.of([True, None, False]) == Rate(1, 2)


def test_a_null_is_alarmed_by_a_name_and_by_something_unexplained():
    assert not judge("a", NULL, report()).alarm
    assert judge("a", NULL, report(finding("gyro_warm_up"))).alarm
    assert judge("a", NULL, report(verdict="unexplained")).alarm
    glitches = NULL | {"effects": [hidden("none", {"note": "reference glitches"})]}
    assert judge("a", glitches, report()).what == "null"
    assert judge("a", glitches, report()).note == "reference glitches"


def test_a_control_is_no_null():
    control = NULL | {"effects": [hidden("none", {"note": "time reversed"})]}
    rows = {row.title: row.rate for row in score([judge("a", control, report())])}
    assert rows["negative controls alarmed"] == Rate(0, 1)
    assert rows["nulls falsely alarmed"] == Rate(0, 0)


def test_the_first_name_or_its_class_is_right():
    t = truth(hidden("gyro_warm_up"))
    assert judge("a", t, report(finding("gyro_warm_up"))).first
    assert judge("a", t, report(finding("gyro_thermal_bias", "gyro_warm_up"))).first
    wrong = judge("a", t, report(finding("gyro_thermal_bias"), finding("gyro_warm_up")))
    assert not wrong.first
    assert wrong.found == 1
    assert wrong.extra
    assert not judge("a", t, report()).first


def test_what_an_effect_implies_is_neither_first_nor_wrong():
    t = truth(hidden("gyro_thermal_lag", implies=["gyro_thermal_bias"]))
    mark = judge("a", t, report(finding("gyro_thermal_bias"), finding("gyro_thermal_lag")))
    assert mark.first
    assert not mark.extra
    assert not judge("a", t, report(finding("gyro_thermal_bias"))).first


def test_a_known_effect_above_is_passed_over():
    t = truth(hidden("accel_warm_up"), hidden("accel_thermal_bias", known=True))
    mark = judge("a", t, report(finding("accel_thermal_bias"), finding("accel_warm_up")))
    assert (mark.what, mark.first, mark.extra) == ("concealed", True, False)
    assert not judge("a", t, report(finding("accel_thermal_bias"))).first


def test_outside_the_catalogue_every_name_is_wrong_and_the_covariate_counts():
    t = truth(hidden("unknown", {"depends_on": "airspeed"}))
    given = report(unexplained=[{"depends_on": ["airspeed", "throttle"]}], verdict="unexplained")
    mark = judge("a", t, given)
    assert (mark.what, mark.extra, mark.covariate) == ("outside", False, True)
    named = judge("a", t, report(finding("accel_current_coupling")))
    assert (named.extra, named.covariate) == (True, False)


def test_on_a_table_acceleration_is_attitude():
    t = truth(hidden("unknown", {"depends_on": "acceleration"}))
    given = report(unexplained=[{"depends_on": ["roll"]}], verdict="unexplained")
    assert judge("a", t, given).covariate
    assert not judge("a", t | {"kind": "copter"}, given).covariate


def test_an_inseparable_effect_wants_a_class():
    t = truth(hidden("gyro_warm_up"), inseparable=True)
    assert judge("a", t, report(finding("gyro_warm_up", "gyro_thermal_bias"))).classed
    assert not judge("a", t, report(finding("gyro_warm_up"))).classed


def test_intervals_are_counted_number_by_number():
    matrix = [[0.0, 1.0], [2.0, 0.0]]
    t = truth(hidden("gyro_misalignment", {"off_diagonal": matrix, "form": "any"}))
    # One of the two free numbers is 1.97 sigma off; the diagonal is no estimate.
    found = {"value": [[0.0, 1.0 + 0.197], [2.0, 0.0]], "std": [[0.0, 0.1], [0.1, 0.0]]}
    mark = judge("a", t, report(finding("gyro_misalignment", off_diagonal=found)))
    assert (mark.covered, mark.intervals) == (1, 2)


def test_a_thermal_polynomial_is_compared_about_the_same_temperature():
    params = {"linear": [1.0], "quadratic": [0.1], "reference_degC": 25.0}
    # About 35 degC the slope of (T - 25) + 0.1 (T - 25)^2 is 1 + 2 * 0.1 * 10 = 3.
    estimates = {
        "linear": {"value": [3.0], "std": [0.01]},
        "quadratic": {"value": [0.1], "std": [0.01]},
        "reference_degC": {"value": 35.0, "std": 0.0},
    }
    t = truth(hidden("gyro_thermal_bias", params))
    mark = judge("a", t, report(finding("gyro_thermal_bias", **estimates)))
    assert (mark.covered, mark.intervals) == (2, 2)


def test_a_loss_on_what_is_held_out_is_seen():
    t = truth(hidden("gyro_warm_up"))
    assert judge("a", t, report(finding("gyro_warm_up", gain=-0.1))).worse
    assert not judge("a", t, report(finding("gyro_warm_up", gain=0.1))).worse


def test_the_rows_of_a_set_counted_by_hand():
    t = truth(hidden("gyro_warm_up"))
    pair = truth(hidden("gyro_warm_up"), hidden("accel_warm_up"), level=1)
    marks = [
        judge("a", NULL, report()),
        judge("b", NULL, report(finding("gyro_warm_up"))),
        judge("c", t, report(finding("gyro_warm_up"))),
        judge("d", t, report(finding("gyro_thermal_rate"))),
        judge("e", pair, report(finding("accel_warm_up"))),
    ]
    rows = {row.title: (row.rate.hits, row.rate.total) for row in score(marks)}
    assert rows["right first, level 2"] == (1, 2)
    assert rows["right first, level 1"] == (1, 1)
    assert rows["both of a pair named"] == (1, 2)
    assert rows["nulls falsely alarmed"] == (1, 2)
    assert rows["wrong extra name"] == (1, 3)


def test_numbers_that_are_not_numpy_are_judged_too():
    t = truth(hidden("imu_time_offset", {"offset_s": 0.01, "meaning": "late"}))
    found = finding("imu_time_offset", offset_s={"value": np.float64(0.011), "std": 0.001})
    assert judge("a", t, report(found)).covered == 1
