"""What the files hold that a replay writes."""

import csv
import json

import numpy as np
import pyarrow.parquet
import pytest

from ahrs_service.app.files import config_file
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.records import ESTIMATE_DTYPE, Phase
from ahrs_service.rotation import euler_columns
from tests.app.replay.conftest import frames_of, replay, write


def test_tlog_keeps_every_frame_and_adds_ours_behind_its_sample(flight, tmp_path):
    out = tmp_path / "out.tlog"
    assert replay(flight, "--tlog", out, "--set", "publish.attitude_rate_hz=10") == 0
    tlog = read_tlog(out)
    ours = (tlog.frames["sysid"] == 7) & (tlog.frames["compid"] == 191)
    kept = [
        tlog.data[row["offset"] - 8 : row["offset"] + row["length"]].tobytes()
        for row in tlog.frames[~ours]
    ]
    assert b"".join(kept) == flight.read_bytes()
    table = tlog.tables[7, 191, "ATTITUDE"]
    result = replay_log(flight)
    running = result.estimates[result.estimates["phase"] == Phase.RUNNING]
    assert len(table) == pytest.approx(10 * np.ptp(running["time_ns"]) * 1e-9, abs=1.01)
    by_stamp = {int(row["time_ns"]) // 1_000_000: row for row in running}
    for row in table:
        source = by_stamp[int(row["time_boot_ms"])]
        euler = euler_columns(source["ned_from_body"][None])[0]
        assert row["roll"] == pytest.approx(euler[0], rel=1e-6)
        assert row["rollspeed"] == np.float32(source["rate_rad_s"][0])
        before = tlog.frames[row["frame_index"] - 1]
        assert before["received_us"] == row["received_us"] == int(source["received_ns"]) // 1000


def test_tlog_carries_every_message_that_is_switched_on(flight, tmp_path):
    out = tmp_path / "out.tlog"
    rates = {"attitude_rate_hz": 0, "attitude_quaternion_rate_hz": 20, "named_value_rate_hz": 1}
    words = [word for name, hz in rates.items() for word in ("--set", f"publish.{name}={hz}")]
    assert replay(flight, "--tlog", out, *words) == 0
    tables = read_tlog(out).tables
    assert (7, 191, "ATTITUDE") not in tables
    steps = np.diff(tables[7, 191, "ATTITUDE_QUATERNION"]["time_boot_ms"].astype(int))
    assert set(steps) == {50}
    assert len(tables[7, 191, "NAMED_VALUE_FLOAT"]) > 20


def test_replay_of_a_replays_tlog_gives_the_same_estimates(flight, tmp_path):
    out = tmp_path / "out.tlog"
    assert replay(flight, "--tlog", out) == 0
    assert replay_log(out).summary.digest == replay_log(flight).summary.digest


def test_pymavlink_reads_the_tlog_with_our_attitude(flight, tmp_path):
    from pymavlink import mavutil

    out = tmp_path / "out.tlog"
    assert replay(flight, "--tlog", out) == 0
    log = mavutil.mavlink_connection(str(out))
    seen = 0
    while (message := log.recv_match(type="ATTITUDE")) is not None:
        seen += message.get_srcComponent() == 191
    log.close()
    assert seen == len(read_tlog(out).tables[7, 191, "ATTITUDE"])
    assert seen > 500


@pytest.mark.parametrize("name", ["px4_fmuv6c_quad_222hz.ulg", "bench_cuavv5_2021-12-08.bin"])
def test_other_logs_become_a_tlog_that_replays_alike(name, shared, tmp_path):
    path, out = shared / "flights" / name, tmp_path / "out.tlog"
    assert replay(path, "--tlog", out) == 0
    log, tlog = replay_log(path), replay_log(out)
    np.testing.assert_array_equal(tlog.estimates["time_ns"], log.estimates["time_ns"])
    ours, theirs = tlog.estimates["ned_from_body"], log.estimates["ned_from_body"]
    assert np.abs((ours * theirs).sum(axis=1)).min() > 1.0 - 5e-6
    assert tlog.summary.comparison.roll.sigma == pytest.approx(
        log.summary.comparison.roll.sigma, abs=1e-3
    )


def test_all_files_are_the_same_every_time(flight, tmp_path):
    kinds = ("tlog", "csv", "parquet", "json")
    for turn in ("a", "b"):
        words = [word for kind in kinds for word in (f"--{kind}", tmp_path / f"{turn}.{kind}")]
        assert replay(flight, *words) == 0
    for kind in kinds:
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


def test_parquet_holds_every_column_and_says_what_made_it(flight, tmp_path):
    out = tmp_path / "out.parquet"
    assert replay(flight, "--parquet", out, "--set", "gate.norm_m_s2=0.25") == 0
    table = pyarrow.parquet.read_table(out)
    settings = config_file.load(None, ["gate.norm_m_s2=0.25"])
    result = replay_log(flight, settings)
    for name in ESTIMATE_DTYPE.names:
        column = result.estimates[name]
        if column.ndim == 1:
            np.testing.assert_array_equal(table[name].to_numpy(), column)
    for i, axis in enumerate("wxyz"):
        np.testing.assert_array_equal(
            table[f"ned_from_body_{axis}"].to_numpy(), result.estimates["ned_from_body"][:, i]
        )
    np.testing.assert_array_equal(
        table["gyro_bias_rad_s_y"].to_numpy(), result.estimates["gyro_bias_rad_s"][:, 1]
    )
    metadata = pyarrow.parquet.read_metadata(out).metadata
    assert metadata[b"ahrs_service.estimates_sha256"].decode() == result.summary.digest
    assert config_file.from_json(metadata[b"ahrs_service.settings"], "file") == settings


def test_csv_reads_back_to_the_last_bit(flight, tmp_path):
    out = tmp_path / "out.csv"
    assert replay(flight, "--csv", out) == 0
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    estimates = replay_log(flight).estimates
    assert len(rows) == len(estimates)
    for n in (0, 300, len(rows) - 1):
        assert int(rows[n]["time_ns"]) == estimates["time_ns"][n]
        assert float(rows[n]["ned_from_body_x"]) == estimates["ned_from_body"][n, 1]
        assert float(rows[n]["rate_rad_s_x"]) == estimates["rate_rad_s"][n, 0]


def test_rrd_is_written(flight, tmp_path):
    out = tmp_path / "out.rrd"
    assert replay(flight, "--rrd", out) == 0
    assert out.read_bytes()[:3] == b"RRF"


def test_json_is_strict_and_complete(flight, tmp_path):
    out = tmp_path / "out.json"
    assert replay(flight, "--json", out) == 0
    (plain,) = json.loads(out.read_text(), parse_constant=pytest.fail)
    assert plain["log"] == "flight.tlog"
    assert plain["temperature_min_degc"] is None
    assert plain["comparison"]["roll"]["count"] > 0


def test_several_logs_write_into_a_folder_by_name(flight, tmp_path):
    (tmp_path / "more").mkdir()
    same_name = write(tmp_path / "more" / "flight.tlog", frames_of(8.0))
    out = tmp_path / "made" / "here"
    assert replay(flight, same_name, "--csv", out) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "flight.tlog-2.csv",
        "flight.tlog.csv",
    ]


def test_a_folder_stands_for_its_logs(flight, tmp_path, capsys):
    write(tmp_path / "other.tlog", frames_of(8.0))
    (tmp_path / "notes.txt").write_text("no log")
    assert replay(tmp_path) == 0
    shown = capsys.readouterr().out
    assert "all logs" in shown
    assert shown.count("estimates sha256") == 2
