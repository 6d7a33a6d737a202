"""One vehicle and one IMU: every command takes the same samples of a recording with several.

The oracle is a recording of the one vehicle only.
"""

import json

import numpy as np
import pytest

from ahrs_service.adoption import of_vehicle
from ahrs_service.app.calibrate.capture import read_capture
from ahrs_service.app.cli import main
from ahrs_service.app.diagnose.loaded_recording import load
from ahrs_service.app.files import config_file
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.errors import RecordingError
from ahrs_service.estimator import Estimator
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.links.logs.session_marks import MarkKind, mark_messages
from ahrs_service.links.logs.tlog import tlog_record
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.links.simulated.autopilot import SimulatedAutopilot
from ahrs_service.links.simulated.autopilot_messages import UNIX_START_US
from ahrs_service.records import ImuSource
from ahrs_service.settings import IntakeSettings, Settings
from ahrs_service.simulation.scenario import make_flight

SECONDS = 20.0
RATES = {
    "HEARTBEAT": 1.0,
    "HIGHRES_IMU": 100.0,
    "SCALED_IMU": 5.0,
    "RAW_IMU": 20.0,
    "SIM_STATE": 20.0,
    "ATTITUDE": 20.0,
    "GPS_RAW_INT": 5.0,
    "VFR_HUD": 5.0,
    "VIBRATION": 2.0,
    "BATTERY_STATUS": 2.0,
}
TRIM = {1: 0.0, 2: 0.05}
BOARD = {1: bytes(range(1, 19)), 2: bytes(range(2, 20))}


def frames_of(system, scenario, seed, rates=RATES, hz=400.0):
    """(stamp [us], frame) of a flight, with trim, offset and number of the board printed early."""
    flight = make_flight(scenario, SECONDS, seed, hz)
    autopilot = SimulatedAutopilot(flight.rows, hz, rates, system=system)
    encoder = Encoder(system, 1)
    version = dialect.MAVLink_autopilot_version_message(
        0, 0, 0, 0, 0, b"\0" * 8, b"\0" * 8, b"\0" * 8, 0, 0, 0, BOARD[system]
    )
    printed = [
        dialect.MAVLink_param_value_message(b"AHRS_TRIM_X", TRIM[system], 9, 2, 0),
        dialect.MAVLink_param_value_message(b"INS_ACCOFFS_X", 0.1 * system, 9, 2, 1),
        version,
    ]
    frames = []
    while (now_s := autopilot.next_due()) < np.inf:
        # The second vehicle is switched on a moment later.
        stamp_us = (UNIX_START_US + round(now_s * 1e6) + 1000 * system) & ~3
        frames += [(stamp_us, frame) for frame in autopilot.due(now_s)]
        if printed:
            frames += [(stamp_us, encoder.pack(message)) for message in printed]
            printed = []
    return frames


def write(path, *vehicles):
    frames = sorted((one for frames in vehicles for one in frames), key=lambda one: one[0])
    path.write_bytes(b"".join(tlog_record(*one) for one in frames))
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Recordings: of both vehicles, and of each alone; the second's IMU is the faster."""
    folder = tmp_path_factory.mktemp("vehicles")
    first = frames_of(1, "flight", 1)
    second = frames_of(2, "rest", 2, RATES | {"HIGHRES_IMU": 200.0, "ATTITUDE": 50.0})
    alone = {n: write(folder / f"{n}.tlog", frames) for n, frames in ((1, first), (2, second))}
    return {"both": write(folder / "flight.tlog", first, second), **alone}


ASKED = [(None, 1), (IntakeSettings(system=1), 1), (IntakeSettings(system=2), 2)]


@pytest.mark.parametrize(("asked", "system"), ASKED)
def test_replay_estimates_one_vehicle(logs, asked, system):
    settings = None if asked is None else Settings(intake=asked)
    both, alone = replay_log(logs["both"], settings), replay_log(logs[system])
    assert both.vehicle == (system, 1)
    assert both.summary.digest == alone.summary.digest
    assert both.summary.reference == f"SIM_STATE of {system}/1"
    assert both.summary.comparison == alone.summary.comparison


@pytest.mark.parametrize(("asked", "system"), ASKED)
def test_diagnosis_and_simulation_take_all_columns_of_that_vehicle(logs, asked, system):
    both, alone = load(logs["both"], asked=asked), load(logs[system])
    for name in both.columns.__dataclass_fields__:
        if name == "name":
            continue
        ours, theirs = getattr(both.columns, name), getattr(alone.columns, name)
        if hasattr(ours, "time_s"):
            # The simulator's truth has no rates.
            assert len(ours) or name == "body_rate_rad_s", name
            np.testing.assert_array_equal(ours.time_s, theirs.time_s, name)
            ours, theirs = ours.values, theirs.values
        np.testing.assert_array_equal(ours, theirs, name)
    np.testing.assert_array_equal(both.position_ned_m.values, alone.position_ned_m.values)
    assert f"reference: SIM_STATE of {system}/1" in both.notes


@pytest.mark.parametrize(("asked", "system"), ASKED)
def test_calibration_takes_samples_parameters_and_board_of_that_vehicle(logs, asked, system):
    both, alone = read_capture(logs["both"], asked), read_capture(logs[system])
    for name in ("time_s", "gyro_rad_s", "accel_m_s2", "temperature_degc"):
        ours = getattr(both.columns, name)
        np.testing.assert_array_equal(ours, getattr(alone.columns, name), name)
    assert (both.compensated, both.unit) == (alone.compensated, alone.unit)
    assert both.unit == BOARD[system].hex()
    assert both.compensated


@pytest.mark.parametrize("system", [1, 2])
def test_all_commands_take_the_same_samples(logs, system):
    asked = IntakeSettings(system=system)
    result = replay_log(logs["both"], Settings(intake=asked))
    # Until the intake has seen ten of each message it takes the first that came.
    replayed = result.recording.readings[result.positions][10:]
    count = len(replayed)
    assert set(replayed["system"]) == {system}
    captured = read_capture(logs["both"], asked).columns
    assert len(captured.time_s) < count + 25
    np.testing.assert_array_equal(captured.gyro_rad_s[-count:], replayed["gyro_rad_s"])
    np.testing.assert_array_equal(captured.accel_m_s2[-count:], replayed["accel_m_s2"])
    loaded = load(logs["both"], asked=asked).columns
    # Diagnosis also uses samples before the first heartbeat.
    assert 0 <= len(loaded.imu_time_s) - len(captured.time_s) <= 1
    assert len(loaded.imu_time_s) == np.sum(
        of_vehicle(result.recording.readings, (system, 1))["source"] == ImuSource.HIGHRES_IMU
    )
    gyro, accel = loaded.gyro_rad_s[-count:], loaded.accel_m_s2[-count:]
    if TRIM[system] == 0.0:
        np.testing.assert_array_equal(gyro, replayed["gyro_rad_s"])
        np.testing.assert_array_equal(accel, replayed["accel_m_s2"])
    else:
        # Rotated about x into the vehicle's axes: the x axis stays.
        np.testing.assert_allclose(gyro[:, 0], replayed["gyro_rad_s"][:, 0])
        c, s = np.cos(TRIM[system]), np.sin(TRIM[system])
        y, z = replayed["accel_m_s2"][:, 1:].T
        np.testing.assert_allclose(accel[:, 1], c * y - s * z, atol=1e-12)


def said(capsys, *words):
    code = main([*map(str, words)])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_the_options_choose_the_vehicle(logs, capsys, tmp_path):
    outs = [tmp_path / "both" / "sim.tlog", tmp_path / "alone" / "sim.tlog"]
    for out, words in zip(outs, ((logs["both"], "--system", 2), (logs[2],)), strict=True):
        out.parent.mkdir()
        assert said(capsys, "simulate", "--from", *words, "--tlog", out)[0] == 0
    assert outs[0].read_bytes() == outs[1].read_bytes()
    found = []
    for words in (
        (logs["both"], "--system", 2),
        (logs["both"], "--set", "intake.system=2"),
        (logs[2],),
    ):
        code, out, _ = said(capsys, "calibrate", "noise", *words, "--json")
        assert code == 0
        found.append({**json.loads(out.splitlines()[-1])[0], "recording": ""})
    assert found[0] == found[1] == found[2]
    for command in (("diagnose",), ("calibrate", "allan"), ("simulate", "--tlog", "x", "--from")):
        code, _, err = said(capsys, *command, logs["both"], "--system", 3)
        assert code == 1
        assert "--system 3" in err


def test_a_recording_of_this_service_keeps_its_vehicle(logs, tmp_path):
    """The service was set to the second vehicle: who reads its recording takes that one too."""
    data = config_file.to_json(Settings(intake=IntakeSettings(system=2)))
    encoder = Encoder(2, 191)
    marks = [
        tlog_record(UNIX_START_US, encoder.pack(message))
        for message in mark_messages(MarkKind.SETTINGS, data)
    ]
    path = tmp_path / "own.tlog"
    path.write_bytes(b"".join(marks) + logs["both"].read_bytes())
    assert replay_log(path).summary.digest == replay_log(logs[2]).summary.digest
    alone = load(logs[2]).columns
    np.testing.assert_array_equal(load(path).columns.gyro_rad_s, alone.gyro_rad_s)
    assert read_capture(path).unit == BOARD[2].hex()
    assert read_capture(path, IntakeSettings(system=1)).unit == BOARD[1].hex()


def test_after_a_rotation_the_session_s_vehicle_is_kept(logs, tmp_path):
    """The file of a continued session begins with the state: the second vehicle is adopted."""
    estimator = Estimator(Settings())
    estimator.take(read_recording(logs[2]).readings[:100])
    encoder = Encoder(2, 191)
    messages = mark_messages(MarkKind.SETTINGS, config_file.to_json(Settings()))
    messages += mark_messages(MarkKind.STATE, estimator.save())
    marks = [tlog_record(UNIX_START_US, encoder.pack(message)) for message in messages]
    path = tmp_path / "own.tlog"
    path.write_bytes(b"".join(marks) + logs["both"].read_bytes())
    assert replay_log(path).vehicle == (2, 1)
    assert read_capture(path).unit == BOARD[2].hex()
    alone = load(logs[2]).columns
    np.testing.assert_array_equal(load(path).columns.gyro_rad_s, alone.gyro_rad_s)


@pytest.fixture(scope="module")
def two_imus(tmp_path_factory):
    """One vehicle with HIGHRES_IMU at 40 Hz and RAW_IMU, in coarse steps, at 100 Hz."""
    frames = frames_of(1, "flight", 3, RATES | {"HIGHRES_IMU": 40.0, "RAW_IMU": 100.0})
    return write(tmp_path_factory.mktemp("imus") / "imus.tlog", frames)


@pytest.mark.parametrize("source", ["auto", "HIGHRES_IMU", "RAW_IMU"])
def test_of_two_imus_all_take_the_same(two_imus, source):
    asked = IntakeSettings(imu_source=source)
    chosen = "RAW_IMU" if source == "auto" else source
    result = replay_log(two_imus, Settings(intake=asked))
    assert max(result.summary.sources, key=result.summary.sources.get) == chosen
    capture, columns = read_capture(two_imus, asked), load(two_imus, asked=asked).columns
    assert capture.source == chosen
    count = len(capture.columns.time_s)
    assert len(columns.gyro_rad_s) - count <= 1
    np.testing.assert_array_equal(capture.columns.gyro_rad_s, columns.gyro_rad_s[-count:])
    last = result.recording.readings[result.positions[-1000 if chosen == "RAW_IMU" else -400 :]]
    np.testing.assert_array_equal(columns.gyro_rad_s[-len(last) :], last["gyro_rad_s"])


def test_where_the_vehicle_is_not_heard_nothing_is_taken(two_imus):
    with pytest.raises(RecordingError, match="--system 9"):
        load(two_imus, asked=IntakeSettings(system=9))
    with pytest.raises(RecordingError, match="--system 9"):
        read_capture(two_imus, IntakeSettings(system=9))
