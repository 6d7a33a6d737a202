"""ULog: PX4 logs become readings in SI units, damage is reported, other files are refused."""

import struct
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.ulog import read_ulog
from ahrs_service.records import ImuSource, Kind

HEADER = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000)
IMU_FIELDS = (
    "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;"
)
TEMPERATURE_FIELDS = "uint64_t timestamp;uint32_t device_id;float temperature;uint8_t[4] _padding0;"
SELECTION_FIELDS = "uint64_t timestamp;uint32_t accel_device_id;uint32_t gyro_device_id;"
GPS_FIELDS = "uint64_t timestamp;float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;"
LOCAL_FIELDS = "uint64_t timestamp;float vx;float vy;float vz;"
TRUTH_FIELDS = "uint64_t timestamp;float[4] q;"


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def topic(name: str, fields: str) -> bytes:
    return message("F", f"{name}:{fields}".encode())


def subscribe(number: int, name: str, instance: int = 0) -> bytes:
    return message("A", struct.pack("<BH", instance, number) + name.encode())


def imu(time_us: int, relative: int = 0) -> bytes:
    body = struct.pack("<HQ3fIi3f", 0, time_us, 0.1, 0.2, 0.3, 4000, relative, 0.0, 0.0, -9.8)
    return message("D", body)


def written(folder: Path, *messages: bytes) -> Path:
    path = folder / "log.ulg"
    path.write_bytes(HEADER + b"".join(messages))
    return path


def imu_log(*more: bytes) -> tuple[bytes, ...]:
    return (topic("sensor_combined", IMU_FIELDS), subscribe(0, "sensor_combined"), *more)


@pytest.mark.parametrize("name", ["px4_auavx2_quad_250hz.ulg", "px4_fmuv6c_quad_222hz.ulg"])
def test_imu_columns_equal_pyulogs(name, shared):
    path = shared / "flights" / name
    shares: list[float] = []
    recording = read_ulog(path, shares.append)
    samples = recording.readings[recording.readings["kind"] == Kind.IMU]
    table = ULog(str(path)).get_dataset("sensor_combined").data
    np.testing.assert_array_equal(samples["time_ns"], table["timestamp"].astype("i8") * 1000)
    np.testing.assert_array_equal(samples["received_ns"], samples["time_ns"])
    for i in range(3):
        np.testing.assert_array_equal(samples["gyro_rad_s"][:, i], table[f"gyro_rad[{i}]"])
        np.testing.assert_array_equal(
            samples["accel_m_s2"][:, i], table[f"accelerometer_m_s2[{i}]"]
        )
    assert set(samples["source"]) == {ImuSource.ULOG}
    assert recording.readings["kind"][0] == Kind.HEARTBEAT
    assert recording.readings["autopilot"][0] == 12
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_temperature_comes_from_the_accelerometer_where_the_gyros_is_nan(shared):
    recording = read_ulog(shared / "flights" / "px4_fmuv6c_quad_222hz.ulg")
    degc = recording.readings["temperature_degc"]
    assert np.isfinite(degc).sum() == 92
    assert np.nanmin(degc) == pytest.approx(23.5)
    assert np.nanmax(degc) == pytest.approx(25.0)
    assert recording.notes[0].endswith("sensor_accel[0].temperature")


def test_barometer_temperature_is_never_taken_and_drop_outs_are_reported(shared):
    recording = read_ulog(shared / "flights" / "px4_auavx2_quad_250hz.ulg")
    assert np.isnan(recording.readings["temperature_degc"]).all()
    assert recording.damaged == {"drop-outs": 4}
    assert "119 ms" in " ".join(recording.notes)
    field = np.linalg.norm(recording.readings["mag_ut"], axis=1)
    assert 20 < np.nanmedian(field) < 70


def test_the_reference_is_the_logs_own_attitude(shared):
    recording = read_ulog(shared / "flights" / "px4_auavx2_quad_250hz.ulg")
    (reference,) = recording.references
    assert reference.name == "vehicle_attitude"
    assert not reference.is_truth
    assert len(reference.time_ns) == 6461
    np.testing.assert_allclose(np.linalg.norm(reference.ned_from_body, axis=1), 1.0)
    assert (np.diff(reference.time_ns) >= 0).all()


def test_temperature_is_that_of_the_selected_device_and_zero_is_none(tmp_path):
    def temperature(number: int, device: int, degc: float) -> bytes:
        return message("D", struct.pack("<HQIf", number, 5_000, device, degc))

    path = written(
        tmp_path,
        topic("sensor_gyro", TEMPERATURE_FIELDS),
        topic("sensor_selection", SELECTION_FIELDS),
        *imu_log(imu(4_000), imu(8_000)),
        subscribe(1, "sensor_gyro", 0),
        subscribe(2, "sensor_gyro", 1),
        subscribe(3, "sensor_selection"),
        temperature(1, 71, 25.0),
        temperature(2, 72, 44.0),
        temperature(2, 72, 0.0),
        message("D", struct.pack("<HQII", 3, 3_000, 70, 72)),
    )
    degc = read_ulog(path).readings["temperature_degc"][1:]
    np.testing.assert_array_equal(degc, [np.nan, 44.0])


def test_an_absent_accelerometer_is_nan_and_time_is_in_order(tmp_path):
    invalid = 0x7FFFFFFF
    path = written(tmp_path, *imu_log(imu(8_000), imu(4_000, invalid), imu(12_000)))
    samples = read_ulog(path).readings[1:]
    assert samples["time_ns"].tolist() == [4_000_000, 8_000_000, 12_000_000]
    assert np.isnan(samples["accel_m_s2"][0]).all()
    assert np.isfinite(samples["accel_m_s2"][1:]).all()


def test_groundtruth_is_marked_as_truth(tmp_path):
    path = written(
        tmp_path,
        topic("vehicle_attitude_groundtruth", TRUTH_FIELDS),
        *imu_log(imu(4_000)),
        subscribe(1, "vehicle_attitude_groundtruth"),
        message("D", struct.pack("<HQ4f", 1, 4_000, 2.0, 0.0, 0.0, 0.0)),
        message("D", struct.pack("<HQ4f", 1, 8_000, 0.0, 0.0, 0.0, 0.0)),
    )
    (truth,) = read_ulog(path).references
    assert truth.is_truth
    np.testing.assert_array_equal(truth.ned_from_body, [[1.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize("name", ["vehicle_gps_position", "sensor_gps"])
def test_velocities_of_a_receiver_with_a_fix_and_of_the_filter_are_separated(name, tmp_path):
    def velocity(number: int, time_us: int, north: float, *fix: int) -> bytes:
        values = (number, time_us, north, 2.0, 3.0, *fix)
        return message("D", struct.pack("<HQ3f" + "B" * len(fix), *values))

    path = written(
        tmp_path,
        topic(name, GPS_FIELDS),
        topic("vehicle_local_position", LOCAL_FIELDS),
        *imu_log(imu(4_000), imu(8_000)),
        subscribe(1, name),
        subscribe(2, "vehicle_local_position"),
        velocity(1, 5_000, 1.0, 3),
        velocity(1, 5_200, 1.5, 2),
        velocity(1, 5_400, float("nan"), 4),
        velocity(2, 6_000, 7.0),
    )
    readings = read_ulog(path).readings
    (gps,) = readings[readings["kind"] == Kind.GPS]
    assert (gps["time_ns"], gps["velocity_ned_m_s"].tolist()) == (5_000_000, [1.0, 2.0, 3.0])
    (local,) = readings[readings["kind"] == Kind.VELOCITY]
    assert local["velocity_ned_m_s"].tolist() == [7.0, 2.0, 3.0]


def test_a_receiver_without_a_fix_gives_no_velocity(shared):
    readings = read_ulog(shared / "flights" / "px4_fmuv6c_quad_222hz.ulg").readings
    assert np.count_nonzero(readings["kind"] == Kind.GPS) == 0


def test_a_cut_file_gives_what_is_before_the_cut(tmp_path, shared):
    whole = (shared / "flights" / "px4_fmuv6c_quad_222hz.ulg").read_bytes()
    path = tmp_path / "cut.ulg"
    path.write_bytes(whole[: len(whole) // 2])
    samples = read_ulog(path).readings
    assert 9_000 < len(samples) < 11_500


def test_damage_in_the_middle_is_survived_and_reported(tmp_path, shared, capsys):
    data = bytearray((shared / "flights" / "px4_fmuv6c_quad_222hz.ulg").read_bytes())
    middle = len(data) // 2
    data[middle : middle + 2000] = np.random.default_rng(7).bytes(2000)
    path = tmp_path / "damaged.ulg"
    path.write_bytes(data)
    recording = read_ulog(path)
    assert recording.damaged["corrupt sections"] == 1
    assert len(recording.readings) > 15_000
    assert capsys.readouterr().out == ""


def test_a_log_without_imu_says_what_it_has_instead(tmp_path):
    path = written(
        tmp_path,
        topic("vehicle_attitude", TRUTH_FIELDS),
        subscribe(0, "vehicle_attitude"),
        message("D", struct.pack("<HQ4f", 0, 4_000, 1.0, 0.0, 0.0, 0.0)),
    )
    with pytest.raises(RecordingError, match=r"no sensor_combined .* it has vehicle_attitude;"):
        read_ulog(path)


@pytest.mark.parametrize("data", [b"", b"ULog", HEADER[:10], b"\xa3\x95\x80" * 50])
def test_what_is_no_ulog_is_refused(data, tmp_path):
    path = tmp_path / "other.ulg"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"other\.ulg: not a ULog that can be read"):
        read_ulog(path)
