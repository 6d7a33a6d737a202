"""DataFlash: equal to pymavlink's reader field for field, whole under damage."""

import struct
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.dataflash import read_dataflash
from ahrs_service.links.logs.dataflash_tables import DataFlashFile, read_tables
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import ImuSource, Kind
from ahrs_service.rotation import matrix, quaternion_columns
from tests.links.logs.dataflash_records import IMU_FORMAT, fmt, imu

LOGS = [
    "bench_cuavv5_2021-12-08.bin",
    "bench_matekh743_2021_isbd2khz_warmup.bin",
    "copter_pixhawk_log0036_crash_temp.bin",
    "plane_erle_2014-12-05_10hz.bin",
]
COMPARED = ("IMU", "ATT", "MAG", "GPS", "XKF1", "NKF1", "EKF1", "AHR2", "PARM", "CTUN", "ISBD")


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
    assert np.median(np.diff(samples["time_ns"])) == pytest.approx(1.0833 * 100e6, rel=1e-3)
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


EKF_FORMAT = fmt(0x92, "NKF1", "Qfff", "TimeUS,VN,VE,VD")
GPS_FORMAT = fmt(0x93, "GPS", "QBBfff", "TimeUS,I,Status,Spd,GCrs,VZ")
OLD_GPS_FORMAT = fmt(0x93, "GPS", "BIEEfI", "Status,TimeMS,Spd,GCrs,VZ,T")
PARM_FORMAT = fmt(0x94, "PARM", "QNf", "TimeUS,Name,Value")
OLD_PARM_FORMAT = fmt(0x94, "PARM", "Nf", "Name,Value")


def ekf(time_us: int, *velocity: float) -> bytes:
    return b"\xa3\x95\x92" + struct.pack("<Qfff", time_us, *velocity)


def gps(time_us: int, status: int, speed: float, course: float, vz: float, number=0) -> bytes:
    values = (time_us, number, status, speed, course, vz)
    return b"\xa3\x95\x93" + struct.pack("<QBBfff", *values)


def parm(name: str, value: float, time_us: int | None = 0) -> bytes:
    stamp = b"" if time_us is None else struct.pack("<Q", time_us)
    return b"\xa3\x95\x94" + stamp + struct.pack("<16sf", name.encode(), value)


def recording_of(folder: Path, *records: bytes):
    formats = [IMU_FORMAT, EKF_FORMAT, GPS_FORMAT, PARM_FORMAT]
    (folder / "log.bin").write_bytes(b"".join([*formats, *IMU_RECORDS, *records]))
    return read_dataflash(folder / "log.bin")


def of_kind(recording, kind: Kind):
    return recording.readings[recording.readings["kind"] == kind]


def test_the_first_receivers_velocity_stands_before_the_filters(tmp_path):
    recording = recording_of(
        tmp_path,
        ekf(5_000_000, 1.0, 2.0, 3.0),
        gps(5_000_000, 3, 10.0, 30.0, -1.5),
        gps(5_100_000, 3, 10.0, 30.0, -1.5, number=1),
        gps(5_200_000, 2, 10.0, 30.0, -1.5),
        gps(5_400_000, 4, 10.0, 120.0, 0.0),
    )
    rows = of_kind(recording, Kind.GPS)
    assert rows["received_ns"].tolist() == [5_000_000_000, 5_400_000_000]
    expected = [[8.660254, 5.0, -1.5], [-5.0, 8.660254, 0.0]]
    np.testing.assert_allclose(rows["velocity_ned_m_s"], expected, atol=1e-6)
    assert len(of_kind(recording, Kind.VELOCITY)) == 0


def test_old_gps_records_have_the_autopilots_time_in_another_field(tmp_path):
    records = b"".join(
        b"\xa3\x95\x93" + struct.pack("<BIIIfI", 3, 400_000_000, 1000, 9000, 0.0, 5000 + 200 * n)
        for n in range(3)
    )
    path = tmp_path / "old.bin"
    path.write_bytes(IMU_FORMAT + OLD_GPS_FORMAT + b"".join(IMU_RECORDS) + records)
    rows = of_kind(read_dataflash(path), Kind.GPS)
    assert rows["time_ns"].tolist() == [5_000_000_000, 5_200_000_000, 5_400_000_000]
    np.testing.assert_allclose(rows["velocity_ned_m_s"][:, 1], 10.0)
    # All zero down is a receiver that measures none.
    assert np.isnan(rows["velocity_ned_m_s"][:, 2]).all()


def test_the_filters_velocity_is_taken_where_no_receiver_had_a_fix(tmp_path):
    recording = recording_of(
        tmp_path,
        gps(5_000_000, 1, 10.0, 30.0, 0.0),
        ekf(5_000_000, 30.0, -40.0, 5.0),
        ekf(5_200_000, float("nan"), 0.0, 0.0),
    )
    rows = of_kind(recording, Kind.VELOCITY)
    assert rows["velocity_ned_m_s"][0].tolist() == [30.0, -40.0, 5.0]
    assert len(of_kind(recording, Kind.GPS)) == 0


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 61.0), (50.0, -40.0, 0.0), (float("inf"), 0, 0)])
def test_a_filter_that_ran_away_is_not_believed_at_all(velocity, tmp_path):
    recording = recording_of(tmp_path, ekf(5_000_000, 1.0, 2.0, 3.0), ekf(5_200_000, *velocity))
    assert len(of_kind(recording, Kind.VELOCITY)) == 0
    assert "velocity of NKF1 not used" in recording.notes[-1]


def test_the_trim_holds_from_the_first_sample_on_and_changes_where_it_did(tmp_path):
    recording = recording_of(
        tmp_path,
        parm("AHRS_TRIM_X", 0.01),
        parm("OTHER", 0.1),
        parm("AHRS_TRIM_Y", -0.02),
        imu(9_000_000),
        parm("AHRS_TRIM_X", 0.03),
        imu(9_020_000),
    )
    assert recording.readings["kind"][:3].tolist() == [Kind.HEARTBEAT, Kind.TRIM, Kind.TRIM]
    assert recording.readings["kind"][-2:].tolist() == [Kind.TRIM, Kind.IMU]
    trims = of_kind(recording, Kind.TRIM)
    np.testing.assert_allclose(trims["trim_rad"], [[0.01, np.nan], [np.nan, -0.02], [0.03, np.nan]])
    assert trims["time_ns"].tolist() == [1_000_000_000, 1_000_000_000, 9_000_000_000]
    assert "AHRS_TRIM +1.72 deg about x, -1.15 deg about y" in " ".join(recording.notes)


def test_old_parameters_have_no_time(tmp_path):
    path = tmp_path / "old.bin"
    path.write_bytes(
        IMU_FORMAT + OLD_PARM_FORMAT + b"".join(IMU_RECORDS) + parm("AHRS_TRIM_Y", 0.05, None)
    )
    (row,) = of_kind(read_dataflash(path), Kind.TRIM)
    np.testing.assert_allclose(row["trim_rad"], [np.nan, 0.05], rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "limit_deg"),
    [
        ("bench_matekh743_2021_isbd2khz_warmup.bin", 0.3),
        ("bench_cuavv5_2021-12-08.bin", 0.1),
        ("copter_pixhawk_log0039_temp.bin", 0.3),
    ],
)
def test_the_sign_of_the_trim_is_the_autopilots(name, limit_deg, shared):
    """At rest the rotated force is vertical in the autopilot's attitude; unrotated it is not."""
    recording = read_dataflash(shared / "flights" / name)
    reference, rows = recording.references[0], of_kind(recording, Kind.IMU)
    trims = of_kind(recording, Kind.TRIM)["trim_rad"]
    rows = rows[np.abs(np.linalg.norm(rows["accel_m_s2"], axis=1) - 9.8) < 0.3]
    roll, pitch = (float(column[np.isfinite(column)][-1]) for column in trims.T)
    at = np.clip(np.searchsorted(reference.time_ns, rows["time_ns"]), 0, len(reference.time_ns) - 1)
    w, x, y, z = reference.ned_from_body[at].T
    down = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)

    def lean_deg(sign: float) -> float:
        """Mean angle between the vertical and the force rotated by this share of the trim."""
        q = quaternion_columns([[sign * roll, sign * pitch, 0.0]])[0]
        turn = np.empty((3, 3))
        matrix(q, turn)
        apart = (rows["accel_m_s2"] / -9.8) @ turn.T - down
        return float(np.degrees(np.linalg.norm(np.median(apart, axis=0)[:2])))

    assert lean_deg(1.0) < limit_deg
    assert lean_deg(0.0) > 3.0 * lean_deg(1.0)
    assert lean_deg(-1.0) > lean_deg(0.0)


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
