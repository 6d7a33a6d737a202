"""Classes: expected losses against fits of a recording without noise; a flight that only warms."""

import copy

import numpy as np
import pytest

from ahrs_service.app.diagnose.recorded_columns import read_columns
from ahrs_service.app.prove.blind_files import case_bytes
from ahrs_service.blind.making.case import Request, make
from ahrs_service.diagnosis.diagnose import compare, diagnose
from ahrs_service.diagnosis.hypotheses.candidates import library_of
from ahrs_service.diagnosis.hypotheses.hypothesis import extend
from ahrs_service.diagnosis.hypotheses.model import added_rows, bare, settle
from ahrs_service.diagnosis.judgement.classes import ALIKE, expected_losses

NAMES = ("gyro_thermal_rate", "gyro_thermal_bias", "gyro_current_coupling")


def recorded(folder, **request):
    path = folder / "hidden.tlog"
    path.write_bytes(case_bytes(make(Request("hidden", "flight", 3511, 120, **request))))
    return read_columns(path)


def test_expected_losses_are_those_of_a_recording_without_noise(tmp_path):
    residual = compare(recorded(tmp_path, effects=("gyro_thermal_rate",), level=1))
    library, empty = library_of(residual, NAMES), bare(residual)
    named = {c.name: c for c in library.candidates if c.effect is not None}
    model = extend(residual, library, empty, named["gyro_thermal_rate"], has_noise=False).model
    losses = expected_losses(residual, library, empty, model, 0)
    silent = copy.copy(residual)
    silent.rows = added_rows(residual, model.terms)
    start = settle(silent, (), empty.noise)
    fits = {
        name: extend(silent, library, start, candidate, has_noise=False).model.log_likelihood
        for name, candidate in named.items()
    }
    assert losses["gyro_thermal_rate"] == 0.0
    for name in NAMES:
        lost = fits["gyro_thermal_rate"] - fits[name]
        assert losses[name] == pytest.approx(lost, rel=0.02, abs=0.05)
    assert losses["gyro_thermal_bias"] < ALIKE < losses["gyro_current_coupling"]


def test_what_a_flight_that_only_warms_cannot_part_is_answered_by_the_class(tmp_path):
    (finding,) = diagnose(recorded(tmp_path, effects=("gyro_thermal_rate",), level=1)).findings
    assert "gyro_thermal_rate" in finding.alike
    assert len(finding.alike) > 1
    assert all("thermal" in name or "warm" in name for name in finding.alike)


def test_hysteresis_needs_a_temperature_that_reverses(tmp_path):
    residual = compare(recorded(tmp_path))
    assert np.all(np.diff(residual.columns.temperature_degc) > -0.1)
    assert "warming and cooling" in library_of(residual).refused["gyro_thermal_hysteresis"]
