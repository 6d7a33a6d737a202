"""The examples of docstrings run as written, in a folder with a flight and a bench."""

import doctest
import importlib

import pytest

from ahrs_service.app.prove.blind_files import case_bytes
from ahrs_service.app.simulate.command import RECORDED_RATES_HZ, write_tlog
from ahrs_service.blind.making.case import Request, make
from ahrs_service.simulation.scenario import make_flight

MODULES = (
    "ahrs_service.app.diagnose.recording_diagnosis",
    "ahrs_service.app.estimate.arrays",
    "ahrs_service.app.files.calibration_file",
    "ahrs_service.app.files.config_file",
    "ahrs_service.diagnosis.result",
    "ahrs_service.errors",
    "ahrs_service.estimator",
    "ahrs_service.flat_columns",
    "ahrs_service.links.logs.recording",
    "ahrs_service.links.logs.recording_formats",
    "ahrs_service.sensor.parameters",
    "ahrs_service.settings",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the examples read; bench.tlog holds a scale error of the gyro."""
    folder = tmp_path_factory.mktemp("examples")
    write_tlog(folder / "flight.tlog", make_flight("flight", 20.0, seed=1), RECORDED_RATES_HZ)
    bench = Request("bench", "bench", 5, 40, level=3, effects=("gyro_scale_factor",))
    (folder / "bench.tlog").write_bytes(case_bytes(make(bench)))
    (folder / "unit.toml").write_text('serial = "A0042"\n[gyro]\nbias = [0.01, 0.0, -0.02]\n')
    (folder / "service.toml").write_text("[fusion]\ndeclination_deg = 4.5\n")
    return folder


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name, folder, monkeypatch):
    monkeypatch.chdir(folder)
    outcome = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert outcome.attempted > 0
    assert outcome.failed == 0
