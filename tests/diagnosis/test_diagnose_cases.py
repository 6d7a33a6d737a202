"""Shared recordings whose truth is known: a null, and one effect of the easier kind."""

import json
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.diagnosis.diagnose import compare, diagnose
from ahrs_service.diagnosis.input.bench_misfit import BenchResidual
from ahrs_service.diagnosis.input.flight_misfit import FlightResidual
from ahrs_service.diagnosis.result import as_json

CASES = Path(__file__).resolve().parents[3] / "shared" / "mismatch" / "cases"


def case(name):
    path = CASES / f"{name}.tlog"
    if not path.exists():
        pytest.skip(f"needs ../shared/mismatch/cases/{name}.tlog")
    truth = json.loads(path.with_name(f"{name}.truth.json").read_text())
    return read_columns(path), truth["effects"]


def test_a_bench_and_a_flight_are_separated():
    assert isinstance(compare(case("accel_lever_arm_bench")[0]), BenchResidual)
    assert isinstance(compare(case("null_flight")[0]), FlightResidual)


def test_a_null_flight_raises_no_alarm_and_is_white():
    found = diagnose(case("null_flight")[0])
    assert found.verdict == "no_mismatch"
    assert found.findings == ()
    assert min(found.whiteness.ljung_box) > 1e-3
    assert min(found.whiteness.normality) > 1e-3
    assert 0.02 < found.noise["reference_velocity_m_s"] < 0.04
    report = as_json(found)
    assert report["schema"] == "ahrs-mismatch/1"
    json.dumps(report)


def test_a_lever_arm_is_named_measured_and_gains_on_blocks_held_out():
    recorded, (effect,) = case("accel_lever_arm_bench")
    found = diagnose(recorded)
    assert [finding.effect for finding in found.findings] == ["accel_lever_arm"]
    (finding,) = found.findings
    assert finding.alike == ("accel_lever_arm",)
    arm = finding.parameters["arm_m"]
    errors = (np.array(arm.value) - effect["params"]["arm_m"]) / np.array(arm.std)
    assert np.all(np.abs(errors) < 4.0)
    assert finding.holdout.log_likelihood_gain > 1000.0
    assert max(finding.holdout.rms_after) < 0.1 * min(finding.holdout.rms_before)
    json.dumps(as_json(found))
