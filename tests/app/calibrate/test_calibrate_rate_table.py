"""`calibrate rate-table` on the simulated table, with steps and with an encoder."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.simulate.command import write_tlog
from ahrs_service.simulation.scenario import make_flight

RATES = {"HEARTBEAT": 1.0, "HIGHRES_IMU": 100.0, "SCALED_IMU": 2.0}
LATE_S = 0.013
SCENARIOS = {"x": "rate-table", "y": "rate-table-pitch", "z": "rate-table-heading"}


def run(capsys, *words):
    try:
        code = main(["calibrate", "rate-table", *map(str, words)])
    except SystemExit as ended:
        code = ended.code
    printed = capsys.readouterr()
    lines = [line for line in printed.out.splitlines() if line.startswith("{")]
    return (
        code,
        json.loads(lines[-1]) if lines else None,
        " ".join((printed.out + printed.err).split()),
    )


@pytest.fixture(scope="module")
def swings(tmp_path_factory):
    """The seed's swing in three mountings, and an encoder whose clock is 13 ms ahead."""
    folder = tmp_path_factory.mktemp("table")
    for axis, scenario in SCENARIOS.items():
        flight = make_flight(scenario, 40.0, rate_hz=200.0)
        write_tlog(folder / f"{axis}.tlog", flight, RATES)
        t = flight.rows["time_s"]
        rate = np.degrees(flight.rows["rate_rad_s"] @ np.eye(3)["xyz".index(axis)])
        angle = np.cumsum(rate) / 200.0 - 0.5 * rate / 200.0
        for name, values in (("rate_deg_s", rate), ("angle_deg", angle)):
            table = np.column_stack([t - LATE_S, values])
            path = folder / f"{axis}-{name}.csv"
            np.savetxt(path, table, "%.9f", ",", header=f"time_s,{name}", comments="")
    return folder


def runs(folder, name):
    return [
        word
        for axis in "xyz"
        for word in ("--run", axis, folder / f"{axis}.tlog", folder / f"{axis}-{name}.csv")
    ]


@pytest.mark.parametrize("name", ["rate_deg_s", "angle_deg"])
def test_an_encoder_gives_the_gyros_and_how_late_they_are(name, swings, capsys, tmp_path):
    out = tmp_path / "A1.toml"
    code, plain, said = run(capsys, *runs(swings, name), "--out", out, "--json")
    assert code == 0
    assert plain["usable"]
    truth = make_flight("rate-table", 1.0).calibration.gyro
    error = np.array(plain["found"]["gyro"]["matrix"]) - truth.matrix
    # What the warm-up of the scenario adds: up to 0.3 % of scale between 18 and 33 degC.
    assert np.abs(error).max() < 4e-3
    late_ms = [float(part) for part in said.split("against the encoder by ")[1].split(" ms")[:1]]
    assert late_ms == pytest.approx([1e3 * LATE_S], abs=0.2)
    assert out.exists()


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """A table that keeps -100, -50, 50 and 100 deg/s for four seconds each, in three mountings."""
    folder = tmp_path_factory.mktemp("steps")
    corners_s, rates = [0.0], [0.0]
    for rate in (0.0, -100.0, -50.0, 50.0, 100.0, 0.0):
        corners_s += [corners_s[-1] + 1.0, corners_s[-1] + 5.0]
        rates += [rate, rate]
    for k, axis in enumerate("xyz"):
        flight = make_flight("multi-pose", corners_s[-1], rate_hz=200.0, seed=k)
        rows = flight.rows.copy()
        rate = np.radians(np.interp(rows["time_s"], corners_s, rates))
        calibration = flight.calibration.gyro
        noise = np.random.default_rng(k).normal(0.0, 1e-3, (len(rows), 3))
        rows["gyro_rad_s"] = rate[:, None] * np.array(calibration.matrix)[:, k] + noise
        rows["gyro_rad_s"] += calibration.bias
        rows["accel_m_s2"] = [0.0, 0.0, -9.80665]
        rows["accel_m_s2"] += np.random.default_rng(k).normal(0.0, 0.02, (len(rows), 3))
        write_tlog(folder / f"{axis}.tlog", replace(flight, rows=rows), RATES)
    return folder


def test_steps_of_known_rate_give_the_gyros(steps, capsys):
    words = [w for axis in "xyz" for w in ("--run", axis, steps / f"{axis}.tlog")]
    code, plain, _ = run(capsys, "--rates=-100,-50,50,100", *words, "--json")
    assert code == 0
    truth = make_flight("multi-pose", 1.0).calibration.gyro
    assert plain["found"]["gyro"]["matrix"] == pytest.approx(np.array(truth.matrix), abs=3e-4)
    assert plain["found"]["gyro"]["bias"] == pytest.approx(truth.bias, abs=2e-4)
    assert plain["words"].startswith("use")


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["--rates=1,x", "--run", "x", "x.tlog"], 2, "--rates 1,x: give rates in deg/s"),
        (["--run", "x", "x.tlog"], 2, "AXIS RECORDING ENCODER.csv without"),
        (["--rates=100", "--run", "q", "x.tlog"], 2, "--run q: give the axis as x, y-, z"),
        (["--rates=30", "--run", "x", "x.tlog"], 1, "check the axis, its sign, and the rates"),
        (["--rates=-100,-50,50,100", "--run", "y", "x.tlog"], 1, "check the axis, its sign"),
        (["--rates=-100,-50,50,100", "--run", "x", "x.tlog"], 1, "mount the unit with its x, y"),
        (["--run", "x", "x.tlog", "absent.csv"], 2, "absent.csv: No such file"),
        (["--run", "x", "x.tlog", "empty.csv"], 2, "empty.csv: has the columns none; give time_s"),
        (["--run", "x", "x.tlog", "text.csv"], 2, "text.csv: could not convert"),
        (["--run", "x", "x.tlog", "short.csv"], 2, "short.csv: give four rows or more"),
        (["--run", "x", "x.tlog", "late.csv"], 1, "give the reference on the recording's clock"),
    ],
)
def test_what_cannot_be_used_is_reported(words, code, says, steps, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.tlog").write_bytes((steps / "x.tlog").read_bytes())
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "text.csv").write_text("time_s,rate_deg_s\n0,a\n")
    (tmp_path / "short.csv").write_text("time_s,rate_deg_s\n0,1\n1,2\n")
    late = "".join(f"{1000 + 0.1 * k},{math.sin(k)}\n" for k in range(100))
    (tmp_path / "late.csv").write_text(f"time_s,rate_deg_s\n{late}")
    if "late.csv" in words:
        words = [w for axis in "xyz" for w in ("--run", axis, "x.tlog", "late.csv")]
    got, _, said = run(capsys, *words)
    assert (got, says in said) == (code, True), said
