"""replay --smooth and estimate --offline."""

import csv
import json

import numpy as np
import pyarrow.parquet
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.rotation import euler_columns
from ahrs_service.simulation.scenario import make_flight


def replay(*arguments):
    return main(["replay", *map(str, arguments)])


def test_replay_compares_both_and_writes_the_smoothed(simulated_tlog, tmp_path, capsys):
    outs = {kind: tmp_path / f"out.{kind}" for kind in ("json", "parquet", "csv", "tlog")}
    options = [part for kind, out in outs.items() for part in (f"--{kind}", out)]
    assert replay(simulated_tlog, "--smooth", *options) == 0
    shown = capsys.readouterr().out
    causal = replay_log(simulated_tlog)
    result = replay_log(simulated_tlog, smooth=True)
    digest = causal.summary.digest
    assert f"estimates sha256 {digest}\n" in shown
    assert "smoothed: error against" in shown
    (summary,) = json.loads(outs["json"].read_text())
    assert summary["smoothed"] is True
    before, after = summary["comparison"], summary["smoothed_comparison"]
    assert after["tilt"]["rms"] < 0.9 * before["tilt"]["rms"]
    assert (result.estimates["ned_from_body"] != causal.estimates["ned_from_body"]).any()
    table = pyarrow.parquet.read_table(outs["parquet"])
    assert table.schema.metadata[b"ahrs_service.smoothed"] == b"yes"
    assert table.schema.metadata[b"ahrs_service.estimates_sha256"].decode() == digest
    roll = euler_columns(result.estimates["ned_from_body"])[:, 0]
    np.testing.assert_array_equal(table["roll_rad"].to_numpy(), roll)
    with outs["csv"].open() as file:
        written = [float(row["roll_rad"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(written, roll, rtol=1e-12)
    tables = read_tlog(outs["tlog"]).tables
    (ours,) = (rows for key, rows in tables.items() if key[1:] == (191, "ATTITUDE"))
    stamps = result.estimates["time_ns"] // 1_000_000
    place = np.searchsorted(stamps, ours["time_boot_ms"])
    np.testing.assert_allclose(ours["roll"], roll[place], atol=2e-3)


def test_replay_without_it_says_nothing_of_it(simulated_tlog, tmp_path, capsys):
    out = tmp_path / "out.json"
    assert replay(simulated_tlog, "--json", out) == 0
    assert "smoothed" not in capsys.readouterr().out
    (summary,) = json.loads(out.read_text())
    assert summary["smoothed"] is False
    assert summary["smoothed_comparison"] is None


def test_the_table_over_several_logs_has_both(simulated_tlog, tmp_path, capsys):
    other = tmp_path / "other.tlog"
    other.write_bytes(simulated_tlog.read_bytes())
    assert replay(simulated_tlog, other, "--smooth") == 0
    table = capsys.readouterr().out.split("all logs")[1]
    assert table.count("smooth") == 2


@pytest.fixture(scope="module")
def columns():
    """A simulated flight as the fields of IN, and its truth."""
    rows = make_flight("flight", 60.0, seed=1, rate_hz=100.0).rows
    fields = {
        "imu_gyr": rows["gyro_rad_s"],
        "imu_acc": rows["accel_m_s2"],
        "imu_mag": rows["mag_ut"].astype(np.float64),
        "sampling_rate": 100.0,
    }
    return fields, rows


def estimate(folder, fields, *options):
    source, out = folder / "in.npz", folder / "out.npz"
    np.savez(source, **fields)
    arguments = ["--in", str(source), "--out", str(out), "--profile", "fixed_wing"]
    assert main(["estimate", *arguments, *options]) == 0
    with np.load(out) as file:
        return dict(file)


def test_offline_gives_the_same_fields_closer_to_the_truth(columns, tmp_path):
    fields, rows = columns
    causal = estimate(tmp_path, fields)
    smoothed = estimate(tmp_path, fields, "--offline")
    assert {name: array.shape for name, array in smoothed.items()} == {
        name: array.shape for name, array in causal.items()
    }
    np.testing.assert_array_equal(smoothed["gate"], causal["gate"])
    truth = euler_columns(rows["ned_from_body"])[300:, :2]
    for name in ("quat", "quat9"):
        before, after = (
            np.sqrt(np.mean((euler_columns(out[name])[300:, :2] - truth) ** 2))
            for out in (causal, smoothed)
        )
        assert after < 0.8 * before
    assert smoothed["sigma_deg"][:, :2].mean() < causal["sigma_deg"][:, :2].mean()


def test_offline_in_another_frame_is_the_same_attitude(columns, tmp_path):
    fields, _ = columns
    flip = np.array([1.0, -1.0, -1.0])
    turned = {name: fields[name] * flip for name in ("imu_gyr", "imu_acc", "imu_mag")}
    frd = estimate(tmp_path, fields, "--offline")
    flu = estimate(tmp_path, fields | turned, "--offline", "--frame", "flu")
    # Turned half round about x on both sides: w, x stay, y and z change sign.
    again = flu["quat"] * np.array([1.0, 1.0, -1.0, -1.0])
    again *= np.sign((again * frd["quat"]).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(again, frd["quat"], atol=1e-9)


def test_offline_takes_one_sample_and_samples_of_nothing(columns, tmp_path):
    fields, _ = columns
    one = {name: fields[name][:1] for name in ("imu_gyr", "imu_acc")} | {"sampling_rate": 100.0}
    assert estimate(tmp_path, one, "--offline")["quat"].shape == (1, 4)
    nothing = {name: np.full((50, 3), np.nan) for name in ("imu_gyr", "imu_acc")}
    quat = estimate(tmp_path, nothing | {"sampling_rate": 100.0}, "--offline")["quat"]
    np.testing.assert_array_equal(quat, np.tile([1.0, 0.0, 0.0, 0.0], (50, 1)))
