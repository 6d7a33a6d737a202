"""Replay: the same bytes as live, what the files written hold, and how bad input is told."""

import csv
import json
import pickle

import numpy as np
import pyarrow.parquet
import pytest

from ahrs_service.app import cli, config_file
from ahrs_service.app.replay_log import replay_log
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.estimator import Estimator
from ahrs_service.records import ESTIMATE_DTYPE, READING_DTYPE, Phase, empty
from ahrs_service.rotation import euler_columns
from ahrs_service.settings import GateSettings, Settings
from links.errors import RecordingError
from links.mavlink_codec import Decoder, Encoder, dialect
from links.readings import from_message
from links.session_marks import MarkKind, mark_messages
from links.tlog import read_tlog, tlog_record

BOOT_US = 1_700_000_000_000_000
AUTOPILOT = 3


def roll_of(t_s):
    return 0.4 * np.sin(0.8 * t_s)


def imu_message(t_us, t_s):
    roll, rate = roll_of(t_s), 0.32 * np.cos(0.8 * t_s)
    g = STANDARD_GRAVITY_M_S2
    accel = (0.0, -g * np.sin(roll), -g * np.cos(roll))
    return dialect.MAVLink_highres_imu_message(
        t_us, *accel, rate, 0.0, 0.0, *([0.0] * 6), 25.0, 0x103F
    )


def frames_of(seconds=12.0, rate_hz=100.0, clock_us=lambda t_us: t_us, skip=lambda t_s: False):
    """(receipt [us], frame) of a vehicle that rolls to and fro and tells its true attitude."""
    encoder = Encoder(7, 1)
    ground = Encoder(255, 190)
    frames = []
    for n in range(round(seconds * rate_hz)):
        t_s = n / rate_hz
        t_us = round(1e6 * t_s) + 1_000_000
        received_us = (BOOT_US + t_us) & ~3
        if n % round(rate_hz) == 0:
            heart = dialect.MAVLink_heartbeat_message(1, AUTOPILOT, 0, 0, 4, 3)
            frames.append((received_us, encoder.pack(heart)))
            frames.append(
                (received_us, ground.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
            )
        if not skip(t_s):
            stamp_us = clock_us(t_us)
            frames.append((received_us, encoder.pack(imu_message(stamp_us, t_s))))
            if n % 5 == 0:
                attitude = (stamp_us // 1000, roll_of(t_s), 0.0, 0.0, 0.0, 0.0, 0.0)
                message = dialect.MAVLink_attitude_message(*attitude)
                frames.append((received_us, encoder.pack(message)))
    return frames


def write(path, frames):
    path.write_bytes(b"".join(tlog_record(*one) for one in frames))
    return path


@pytest.fixture
def flight(tmp_path):
    return write(tmp_path / "flight.tlog", frames_of())


def live_digest(frames, settings=None):
    """What the service computes when the frames come one by one."""
    estimator, decoder = Estimator(settings or Settings()), Decoder()
    rows = empty(READING_DTYPE, 1)
    for received_us, frame in frames:
        for message, _ in decoder.feed(frame):
            if from_message(message, received_us * 1000, rows):
                estimator.take(rows)
    return estimator.digest.hexdigest()


def real_frames(path):
    tlog = read_tlog(path)
    return [
        (
            int(row["received_us"]) & ~3,
            tlog.data[row["offset"] : row["offset"] + row["length"]].tobytes(),
        )
        for row in tlog.frames
    ]


def test_replay_equals_live_bit_for_bit(flight):
    assert replay_log(flight).summary.digest == live_digest(frames_of())


@pytest.mark.parametrize(
    "name", ["bench_apm_2014_handtumble.tlog", "copter_cuav_2021-12-02_mission_1hz.tlog"]
)
def test_replay_equals_live_bit_for_bit_on_real_recordings(name, shared):
    path = shared / "flights" / name
    assert replay_log(path).summary.digest == live_digest(real_frames(path))


def test_the_summary_tells_the_truth(flight):
    summary = replay_log(flight).summary
    assert summary.sources == {"HIGHRES_IMU": 1200}
    assert summary.imu_rate_hz == pytest.approx(100.0, rel=1e-6)
    assert summary.duration_s == pytest.approx(11.99)
    assert summary.message_counts == {"HEARTBEAT": 24, "HIGHRES_IMU": 1200, "ATTITUDE": 240}
    assert summary.reference == "ATTITUDE"
    # A fixed wing that rolls in place and never flies.
    assert summary.comparison.roll.max < np.radians(4.0)
    assert summary.comparison.roll.max > 0.0
    assert summary.heading == "free"
    assert np.isnan(summary.temperature_min_degc)
    assert "25.0 to 25.0 degC" in " ".join(summary.warnings)
    assert summary.foreign == 12
    assert sum(summary.gate_time.values()) == pytest.approx(1.0)


def test_highres_temperature_is_taken_when_told(flight):
    settings = config_file.load(None, ["intake.temperature_source=highres_imu"])
    summary = replay_log(flight, settings).summary
    assert summary.temperature_min_degc == summary.temperature_max_degc == 25.0
    assert summary.temperature_origin == "HIGHRES_IMU"
    assert summary.warnings == ()


def test_gaps_and_clock_jumps_are_counted(tmp_path):
    def rebooted(t_us):
        return t_us if t_us < 9_000_000 else t_us - 8_000_000

    frames = frames_of(16.0, clock_us=rebooted, skip=lambda t_s: 4.0 <= t_s < 6.0)
    summary = replay_log(write(tmp_path / "bad.tlog", frames)).summary
    assert summary.flags["gap"] == 1
    assert summary.flags["clock_jump"] == 1
    # the jump itself is no time that passed
    assert summary.duration_s == pytest.approx(15.98, abs=0.05)
    assert summary.comparison.compared > 150


def test_damage_is_counted_and_survived(flight):
    data = bytearray(flight.read_bytes())
    data[20_000:20_200] = bytes(200)
    flight.write_bytes(data[:-10])
    summary = replay_log(flight).summary
    assert summary.damaged
    assert summary.samples > 1190


def test_low_rate_is_warned_of_with_its_consequence(tmp_path):
    path = write(tmp_path / "slow.tlog", frames_of(30.0, 2.0))
    (warning,) = [one for one in replay_log(path).summary.warnings if "Hz" in one]
    assert "2.0 Hz" in warning
    assert "means nothing in manoeuvres" in warning


def test_a_result_can_be_pickled(flight):
    result = replay_log(flight)
    again = pickle.loads(pickle.dumps(result))
    assert again.estimates.tobytes() == result.estimates.tobytes()
    assert again.summary.to_plain() == result.summary.to_plain()


def test_the_share_done_rises_to_one(flight):
    told = []
    replay_log(flight, advance=lambda stage, share: told.append((stage, share)))
    for stage in ("reading", "estimating"):
        shares = [share for name, share in told if name == stage]
        assert shares == sorted(shares)
        assert shares[-1] == 1.0


# -- marks of the service's own recordings -------------------------------------------------------


def marked(kind, data, received_us):
    encoder = Encoder(7, 191)
    return [(received_us, encoder.pack(message)) for message in mark_messages(kind, data)]


STRICT = Settings(gate=GateSettings(rate_rad_s=0.01))


def test_recorded_settings_hold_from_their_place_on(tmp_path):
    frames = frames_of()
    half = len(frames) // 2
    first = marked(MarkKind.SETTINGS, config_file.to_json(Settings()), frames[0][0])
    mark = marked(MarkKind.SETTINGS, config_file.to_json(STRICT), frames[half][0])
    path = write(tmp_path / "own.tlog", [*first, *frames[:half], *mark, *frames[half:]])
    estimator, decoder = Estimator(Settings()), Decoder()
    rows = empty(READING_DTYPE, 1)
    for n, (received_us, frame) in enumerate(frames):
        if n == half:
            estimator.configure(STRICT)
        for message, _ in decoder.feed(frame):
            if from_message(message, received_us * 1000, rows):
                estimator.take(rows)
    result = replay_log(path)
    assert result.summary.digest == estimator.digest.hexdigest()
    assert result.summary.digest != live_digest(frames)
    assert result.settings == STRICT
    assert result.summary.settings_origin == "those of the recording"


def test_marks_in_a_recording_that_is_not_ours_are_passed_over(tmp_path):
    """A ground station records what anybody sends: it must not change what a replay gives."""
    frames = frames_of()
    mark = marked(MarkKind.SETTINGS, config_file.to_json(STRICT), frames[1][0])
    path = write(tmp_path / "theirs.tlog", [*frames[:1], *mark, *frames[1:]])
    assert replay_log(path).summary.digest == live_digest(frames)
    other = Encoder(7, 66)
    forged = [
        (frames[2][0], other.pack(message))
        for message in mark_messages(MarkKind.SETTINGS, config_file.to_json(STRICT))
    ]
    first = marked(MarkKind.SETTINGS, config_file.to_json(Settings()), frames[0][0])
    path = write(tmp_path / "ours.tlog", [*first, *frames[:2], *forged, *frames[2:]])
    assert replay_log(path).summary.digest == live_digest(frames)


def test_settings_given_win_over_the_recorded(tmp_path):
    frames = frames_of()
    mark = marked(MarkKind.SETTINGS, config_file.to_json(STRICT), frames[0][0])
    path = write(tmp_path / "own.tlog", [*mark, *frames])
    assert replay_log(path, Settings()).summary.digest == live_digest(frames)
    assert replay_log(path).summary.digest == live_digest(frames, STRICT)


def test_a_rotated_file_goes_on_from_the_recorded_state(tmp_path):
    frames = frames_of()
    half = len(frames) // 2
    first = replay_log(write(tmp_path / "whole.tlog", frames))
    before = replay_log(write(tmp_path / "before.tlog", frames[:half]))
    estimator = Estimator(Settings())
    estimator.take(before.recording.readings)
    mark = marked(MarkKind.STATE, estimator.save(), frames[half][0])
    after = replay_log(write(tmp_path / "after.tlog", [*mark, *frames[half:]]))
    joined = before.estimates.tobytes() + after.estimates.tobytes()
    assert joined == first.estimates.tobytes()


def test_a_state_of_another_version_is_refused_with_what_to_do(tmp_path):
    mark = marked(MarkKind.STATE, b"old" * 20, BOOT_US)
    path = write(tmp_path / "old.tlog", [*mark, *frames_of()])
    with pytest.raises(RecordingError, match=r"old\.tlog.*another layout.*--config"):
        replay_log(path)


# -- files written -------------------------------------------------------------------------------


def replay(*words):
    return cli.main(["replay", *map(str, words)])


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


# -- what the user is told -----------------------------------------------------------------------


def test_the_table_shows_the_digest_and_the_errors(flight, capsys):
    assert replay(flight) == 0
    shown = capsys.readouterr().out
    assert f"estimates sha256 {replay_log(flight).summary.digest}\n" in shown
    for part in ("HIGHRES_IMU", "100.0 Hz", "roll, whole", "pitch, steady", "open", "free"):
        assert part in shown


@pytest.mark.parametrize("name", ["a.zip", "a.mat", "a.csv.gz", "a.tlog", "a.ulg", "a.bin"])
def test_what_cannot_be_read_is_refused_in_one_sentence(name, flight, tmp_path, capsys):
    bad = tmp_path / name
    bad.write_bytes(b"PK\x03\x04" + bytes(3000))
    assert replay(bad, flight) == 1
    captured = capsys.readouterr()
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("refused:")
    assert name in line
    assert "Traceback" not in captured.err
    assert "estimates sha256" in captured.out


def test_a_log_without_imu_is_refused_with_what_it_has(tmp_path, capsys):
    frames = [one for one in frames_of() if one[1][7] != 105]
    path = write(tmp_path / "blind.tlog", frames)
    assert replay(path) == 1
    message = capsys.readouterr().err
    assert "no IMU" in message
    assert "ATTITUDE 240" in message


def test_a_vehicle_that_is_not_there_is_refused_with_the_setting(flight, capsys):
    assert replay(flight, "--set", "intake.system=42") == 1
    assert "intake.system = 42" in capsys.readouterr().err


def test_wrong_settings_are_wrong_usage(flight, capsys):
    assert replay(flight, "--set", "gate.no_such=1") == 2
    assert "gate.no_such" in capsys.readouterr().err


def test_the_recording_is_never_overwritten(flight, capsys):
    before = flight.read_bytes()
    assert replay(flight, "--tlog", flight) == 1
    assert flight.read_bytes() == before
    assert "is the recording itself" in capsys.readouterr().err


def test_an_output_that_cannot_be_written_is_told(flight, tmp_path, capsys):
    assert replay(flight, "--csv", tmp_path / "none" / "out.csv") == 1
    message = capsys.readouterr().err
    assert message.startswith("failed:")
    assert "out.csv" in message
