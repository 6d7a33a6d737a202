"""The examples of docstrings and README run as they stand, beside a flight and a bench."""

import doctest
import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.app.prove.blind_files import case_bytes
from ahrs_service.app.simulate.command import RECORDED_RATES_HZ, write_tlog
from ahrs_service.blind.case import Request, make
from ahrs_service.simulation.scenario import make_flight

README = Path(__file__).resolve().parents[1] / "README.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
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
    rows = make_flight("flight", 20.0, seed=1, rate_hz=100.0).rows
    arrays = {"gyr": rows["gyro_rad_s"], "acc": rows["accel_m_s2"], "mag": rows["mag_ut"]}
    np.savez(folder / "samples.npz", **arrays)
    return folder


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name, folder, monkeypatch):
    monkeypatch.chdir(folder)
    outcome = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert outcome.attempted > 0
    assert outcome.failed == 0


def blocks():
    return BLOCK.findall(README.read_text(encoding="utf-8"))


@pytest.mark.parametrize("number", range(len(blocks())))
def test_the_readmes_python_runs(number, folder, monkeypatch):
    """Block after block as one program, as a reader types them."""
    monkeypatch.chdir(folder)
    names = {"__name__": "readme"}
    for block in blocks()[: number + 1]:
        exec(compile(block, str(README), "exec"), names)
