"""DataFlash: equal to pymavlink's reader field for field, whole under damage."""

import struct
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.records import ImuSource, Kind
from links.dataflash import read_dataflash
from links.dataflash_tables import DataFlashFile, read_tables
from links.errors import RecordingError
from links.recording_formats import read_recording

LOGS = [
    "bench_cuavv5_2021-12-08.bin",
    "bench_matekh743_2021_isbd2khz_warmup.bin",
    "copter_pixhawk_log0036_crash_temp.bin",
    "plane_erle_2014-12-05_10hz.bin",
]
COMPARED = ("IMU", "ATT", "MAG", "GPS", "XKF1", "NKF1", "EKF1", "AHR2", "PARM", "CTUN", "ISBD")


def fmt(number: int, name: str, letters: str, columns: str) -> bytes:
    length = 3 + struct.calcsize("<" + letters.translate(str.maketrans("cCeEL", "hHiIi")))
    body = (number, length, name.encode(), letters.encode(), columns.encode())
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *body)


def imu(time_us: int, gyro: float = 0.1, temperature: float = 31.5) -> bytes:
    values = (time_us, gyro, 0.2, 0.3, 0.0, 0.0, -9.8, temperature)
    return b"\xa3\x95\x90" + struct.pack("<Q7f", *values)


IMU_FORMAT = fmt(0x90, "IMU", "Qfffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T")
IMU_RECORDS = [imu(1_000_000 + 20_000 * n, 0.001 * n) for n in range(200)]


def log_of(data: bytes, folder: Path) -> DataFlashFile:
    path = folder / "log.bin"
    path.write_bytes(data)
    return read_tables(path)


@pytest.mark.parametrize("name", LOGS)
def test_every_field_equals_pymavlinks_reader(name, shared):
    from pymavlink.DFReader import DFReader_binary

    path = shared / "flights" / name
    log = read_tables(path)
    peer = DFReader_binary(str(path))
    seen = defaultdict(list)
    while (message := peer.recv_match(type=list(COMPARED))) is not None:
        seen[message.get_type()].append(message)
    assert {"IMU", "ATT"} <= seen.keys()
    for kind, messages in seen.items():
        table = log.table(kind)
        assert len(table) == len(messages), kind
        for n in range(0, len(messages), max(1, len(messages) // 200)):
            assert_equal(log, kind, table[n : n + 1], messages[n])


def assert_equal(log, kind, row, message):
    for field in message.get_fieldnames():
        theirs = getattr(message, field)
        if isinstance(theirs, str):
            assert row[field][0].split(b"\0")[0].decode("latin-1") == theirs
        elif hasattr(theirs, "__len__"):
            assert row[field][0].tolist() == list(theirs)
        else:
            ours = float(log.column(row, kind, field)[0])
            assert ours == theirs or (np.isnan(ours) and np.isnan(theirs)), (kind, field)


def test_readings_carry_the_first_imu_with_its_own_temperature(shared):
    recording = read_dataflash(shared / "flights" / "copter_pixhawk_log0036_crash_temp.bin")
    readings = recording.readings
    assert readings["kind"][0] == Kind.HEARTBEAT
    assert readings["autopilot"][0] == 3
    samples = readings[readings["kind"] == Kind.IMU]
    assert len(samples) == 3755
    assert set(samples["source"]) == {ImuSource.DATAFLASH}
    # the manifest of the recordings gives this span for the first IMU
    assert samples["temperature_degc"].min() == pytest.approx(28.3, abs=0.05)
    assert samples["temperature_degc"].max() == pytest.approx(35.6, abs=0.05)
    assert np.linalg.norm(samples["accel_m_s2"][:100].mean(axis=0)) == pytest.approx(9.8, abs=0.3)
    assert np.isfinite(samples["mag_ut"][:, 0]).sum() > 1400
    assert recording.references[0].name == "ATT"
    assert "IMU2" in " ".join(recording.notes)


def test_old_logs_stamp_in_milliseconds_and_have_no_temperature(shared):
    recording = read_dataflash(shared / "flights" / "plane_erle_2014-12-05_10hz.bin")
    samples = recording.readings[recording.readings["kind"] == Kind.IMU]
    assert np.median(np.diff(samples["time_ns"])) == 100_000_000
    assert np.isnan(samples["temperature_degc"]).all()
    rolls = recording.references[0].ned_from_body
    np.testing.assert_allclose(np.linalg.norm(rolls, axis=1), 1.0)


def test_a_cut_record_does_not_swallow_the_next(tmp_path):
    for cut in range(1, len(IMU_RECORDS[0])):
        records = [*IMU_RECORDS[:50], IMU_RECORDS[50][:cut], *IMU_RECORDS[51:]]
        log = log_of(IMU_FORMAT + b"".join(records), tmp_path)
        times = set(log.table("IMU")["TimeUS"].tolist())
        assert {1_000_000 + 20_000 * n for n in range(200) if n != 50} <= times, cut
        assert len(times) == 199
        assert log.damaged == {"bytes skipped": cut}


@settings(max_examples=30, deadline=None)
@given(junk=st.binary(min_size=1, max_size=300), at=st.integers(0, 199))
def test_records_outside_junk_are_all_found(junk, at, tmp_path_factory):
    data = IMU_FORMAT + b"".join([*IMU_RECORDS[:at], junk, *IMU_RECORDS[at:]])
    log = log_of(data, tmp_path_factory.mktemp("junk"))
    times = log.table("IMU")["TimeUS"].tolist()
    assert {1_000_000 + 20_000 * n for n in range(200)} <= set(times)


def test_instance_0_is_taken_and_zero_temperature_is_none(tmp_path):
    letters, columns = "QBfffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T"
    data = fmt(0x90, "IMU", letters, columns)
    for n in range(20):
        body = struct.pack("<QB7f", 10_000 * n, n % 2, n % 2, 0, 0, 0, 0, -9.8, 0.0)
        data += b"\xa3\x95\x90" + body
    (tmp_path / "two.bin").write_bytes(data)
    samples = read_dataflash(tmp_path / "two.bin").readings[1:]
    assert len(samples) == 10
    assert (samples["gyro_rad_s"][:, 0] == 0.0).all()
    assert np.isnan(samples["temperature_degc"]).all()


def test_a_log_without_imu_says_what_it_has_instead(tmp_path):
    data = fmt(0x91, "BARO", "Qff", "TimeUS,Alt,Press")
    data += b"\xa3\x95\x91" + struct.pack("<Qff", 1, 2.0, 3.0)
    path = tmp_path / "baro.bin"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"baro\.bin.*no IMU records.*it has BARO;"):
        read_dataflash(path)


@pytest.mark.parametrize("data", [b"", b"\xa3", b"\xa3\x95\x80", bytes(1000), b"IMU, 1, 2\n" * 50])
def test_what_is_no_dataflash_is_refused(data, tmp_path):
    path = tmp_path / "other.bin"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"other\.bin: not an ArduPilot DataFlash"):
        read_dataflash(path)


@pytest.mark.parametrize("name", ["flight.zip", "flight.mat", "flight.csv.gz", "flight"])
def test_other_suffixes_are_refused_with_the_formats_known(name, tmp_path):
    (tmp_path / name).write_bytes(b"PK")
    with pytest.raises(RecordingError, match=rf"{name}.*\.tlog.*\.ulg.*\.bin"):
        read_recording(tmp_path / name)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"none\.bin: no such file"):
        read_recording(tmp_path / "none.bin")
