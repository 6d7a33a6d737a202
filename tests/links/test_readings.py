"""Messages to readings: units, what counts as absent, and the references a tlog contains."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ahrs_service.records import READING_DTYPE, ImuSource, Kind, Rows, empty
from ahrs_service.rotation import quaternion_columns
from links.errors import RecordingError
from links.mavlink_codec import Decoder, Encoder, dialect
from links.readings import RULES, from_message, from_tables, recording_from_tlog
from links.session_marks import MarkKind, mark_messages
from links.tlog import read_tlog, tlog_record

START_US = 1_700_000_000_000_000
RECEIVED_NS = START_US * 1000
CODEC = Decoder()
AUTOPILOT = Encoder(1, 1)


def highres(updated: int = 0x1FFF, number: int = 0, **changed: float) -> Any:
    message = dialect.MAVLink_highres_imu_message(
        5_000_000, 1.0, 2.0, -9.5, 0.1, 0.2, 0.3, 0.25, 0.0, 0.5, 0, 0, 0, 31.5, updated, number
    )
    for name, value in changed.items():
        setattr(message, name, value)
    return message


def scaled(kind: str = "scaled_imu", temperature: int = 3150, **changed: int) -> Any:
    make = getattr(dialect, f"MAVLink_{kind}_message")
    message = make(7000, 100, -200, -1000, 10, -20, 30, 250, 0, -500, temperature=temperature)
    for name, value in changed.items():
        setattr(message, name, value)
    return message


def attitude(time_boot_ms: int, roll: float, pitch: float = 0.1, yaw: float = 0.2) -> Any:
    return dialect.MAVLink_attitude_message(time_boot_ms, roll, pitch, yaw, 0, 0, 0)


def heartbeat(autopilot: int = 3) -> Any:
    return dialect.MAVLink_heartbeat_message(1, autopilot, 0, 0, 4, 3)


def reading_of(message: Any, encoder: Encoder = AUTOPILOT) -> Rows | None:
    """The reading of a message that went over the wire; None where it gives none."""
    ((received, _),) = CODEC.feed(encoder.pack(message))
    rows = empty(READING_DTYPE)
    return rows[0] if from_message(received, RECEIVED_NS, rows) else None


def write(path: Path, *entries: Any) -> Path:
    """A tlog of messages, one millisecond apart; (encoder, message) for another sender."""
    content = b""
    for i, entry in enumerate(entries):
        encoder, message = entry if isinstance(entry, tuple) else (AUTOPILOT, entry)
        content += tlog_record(START_US + 1000 * i, encoder.pack(message))
    path.write_bytes(content)
    return path


def test_highres_imu_is_si_but_for_its_magnetic_field() -> None:
    row = reading_of(highres())
    assert row["kind"] == Kind.IMU
    assert row["source"] == ImuSource.HIGHRES_IMU
    assert row["time_ns"] == 5_000_000_000
    assert row["received_ns"] == RECEIVED_NS
    assert row["accel_m_s2"].tolist() == [1.0, 2.0, -9.5]
    np.testing.assert_allclose(row["gyro_rad_s"], [0.1, 0.2, 0.3], rtol=1e-7)
    assert row["mag_ut"].tolist() == [25.0, 0.0, 50.0]
    assert row["temperature_degc"] == 31.5
    assert np.isnan(row["velocity_ned_m_s"]).all()
    assert np.isnan(row["airspeed_m_s"])


@pytest.mark.parametrize(
    ("kind", "source", "time_ns"),
    [
        ("scaled_imu", ImuSource.SCALED_IMU, 7_000_000_000),
        ("scaled_imu2", ImuSource.SCALED_IMU2, 7_000_000_000),
        ("scaled_imu3", ImuSource.SCALED_IMU3, 7_000_000_000),
        ("raw_imu", ImuSource.RAW_IMU, 7_000_000),
    ],
)
def test_integer_imus_come_in_milli_units(kind: str, source: ImuSource, time_ns: int) -> None:
    row = reading_of(scaled(kind))
    assert row["source"] == source
    assert row["time_ns"] == time_ns
    np.testing.assert_allclose(row["accel_m_s2"], [0.980665, -1.96133, -9.80665], rtol=1e-15)
    np.testing.assert_allclose(row["gyro_rad_s"], [0.01, -0.02, 0.03], rtol=1e-15)
    np.testing.assert_allclose(row["mag_ut"], [25.0, 0.0, -50.0], rtol=1e-15)
    assert row["temperature_degc"] == 31.5


def test_sender_autopilot_airspeed_and_velocity() -> None:
    row = reading_of(heartbeat(12), Encoder(7, 9))
    assert (row["kind"], row["system"], row["component"]) == (Kind.HEARTBEAT, 7, 9)
    assert (row["autopilot"], row["time_ns"]) == (12, 0)
    row = reading_of(dialect.MAVLink_vfr_hud_message(21.5, 3, 0, 0, 0, 0))
    assert (row["kind"], row["airspeed_m_s"], row["time_ns"]) == (Kind.AIRSPEED, 21.5, 0)
    row = reading_of(dialect.MAVLink_local_position_ned_message(40, 0, 0, 0, 1.5, -2.0, 0.25))
    assert (row["kind"], row["time_ns"]) == (Kind.VELOCITY, 40_000_000)
    assert row["velocity_ned_m_s"].tolist() == [1.5, -2.0, 0.25]
    assert reading_of(attitude(1, 0.0)) is None


def gps(fix: int = 3, vel: int = 1234, cog: int = 21_000, **changed: int) -> Any:
    message = dialect.MAVLink_gps_raw_int_message(
        9_000_000, fix, 474_000_000, 85_500_000, 0, 90, 140, vel, cog, 12
    )
    for name, value in changed.items():
        setattr(message, name, value)
    return message


def test_a_receiver_tells_speed_and_course_over_ground() -> None:
    row = reading_of(gps())
    assert (row["kind"], row["time_ns"]) == (Kind.GPS, 9_000_000_000)
    north, east, down = row["velocity_ned_m_s"]
    assert north == pytest.approx(-12.34 * np.cos(np.pi / 6))
    assert east == pytest.approx(-12.34 / 2)
    assert np.isnan(down)
    assert reading_of(gps(fix=4)) is not None
    assert reading_of(gps(vel=0, cog=0))["velocity_ned_m_s"].tolist()[:2] == [0.0, 0.0]


@pytest.mark.parametrize("absent", [{"fix": 2}, {"fix": 0}, {"vel": 0xFFFF}, {"cog": 0xFFFF}])
def test_without_a_fix_there_is_no_velocity(absent: dict[str, int]) -> None:
    assert reading_of(gps(**absent)) is None


def test_the_global_position_has_a_velocity_too_unless_all_is_zero() -> None:
    def position(*velocity: int) -> Any:
        return dialect.MAVLink_global_position_int_message(40, 1, 2, 3, 4, *velocity, 0)

    row = reading_of(position(150, -200, 25))
    assert (row["kind"], row["time_ns"]) == (Kind.GLOBAL_VELOCITY, 40_000_000)
    assert row["velocity_ned_m_s"].tolist() == [1.5, -2.0, 0.25]
    assert np.isnan(reading_of(position(0, 0, 0))["velocity_ned_m_s"]).all()


def parameter(name: bytes, value: float) -> Any:
    return dialect.MAVLink_param_value_message(name, value, 9, 900, 17)


def test_the_trim_is_a_parameter() -> None:
    row = reading_of(parameter(b"AHRS_TRIM_X", -0.0625))
    assert (row["kind"], row["time_ns"]) == (Kind.TRIM, 0)
    np.testing.assert_array_equal(row["trim_rad"], [-0.0625, np.nan])
    row = reading_of(parameter(b"AHRS_TRIM_Y", 0.125))
    np.testing.assert_array_equal(row["trim_rad"], [np.nan, 0.125])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (b"AHRS_TRIM_Z", 0.01),
        (b"AHRS_TRIM_X2", 0.01),
        (b"", 0.01),
        (b"AHRS_TRIM_X", 0.2),
        (b"AHRS_TRIM_X", float("nan")),
        (b"AHRS_TRIM_Y", float("-inf")),
    ],
)
def test_other_parameters_and_impossible_trims_are_none(name: bytes, value: float) -> None:
    assert reading_of(parameter(name, value)) is None


@pytest.mark.parametrize(
    ("updated", "absent"),
    [
        (0x1FFF, set()),
        (0x003F, {"mag_ut", "temperature_degc"}),
        (0x01FF, {"temperature_degc"}),
        (0x103F, {"mag_ut"}),
        (0x0038, {"accel_m_s2", "mag_ut", "temperature_degc"}),
        (0x0007, {"gyro_rad_s", "mag_ut", "temperature_degc"}),
        (0x0037, {"gyro_rad_s", "mag_ut", "temperature_degc"}),
        (0x003B, {"accel_m_s2", "mag_ut", "temperature_degc"}),
        (0x0000, set()),
    ],
)
def test_only_updated_fields_are_taken(updated: int, absent: set[str]) -> None:
    row = reading_of(highres(updated))
    names = ("gyro_rad_s", "accel_m_s2", "mag_ut", "temperature_degc")
    assert {name for name in names if np.isnan(row[name]).any()} == absent


def test_nothing_updated_or_all_zero_is_no_reading() -> None:
    nothing = dict.fromkeys(("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro"), 0)
    assert reading_of(highres(0x1FC0)) is None
    assert reading_of(highres(0, **nothing)) is None
    assert reading_of(scaled(**nothing)) is None
    assert reading_of(scaled("raw_imu", **nothing)) is None
    assert reading_of(scaled(**{**nothing, "zgyro": 1})) is not None


def test_zero_temperature_and_zero_field_mean_there_is_none() -> None:
    row = reading_of(scaled(temperature=0, xmag=0, zmag=0))
    assert np.isnan(row["temperature_degc"])
    assert np.isnan(row["mag_ut"]).all()
    assert reading_of(scaled(temperature=-1))["temperature_degc"] == pytest.approx(-0.01)


def test_ids_name_further_imus() -> None:
    sources = [reading_of(highres(number=number))["source"] for number in range(3)]
    assert sources == [ImuSource.HIGHRES_IMU, ImuSource.HIGHRES_IMU_1, ImuSource.HIGHRES_IMU_2]
    assert reading_of(highres(number=3)) is None
    assert reading_of(scaled("raw_imu", id=1)) is None


def test_times_beyond_int64_nanoseconds_are_none() -> None:
    assert reading_of(highres(time_usec=2**64 - 1))["time_ns"] == 0
    assert reading_of(highres(time_usec=2**63 // 1000))["time_ns"] == 2**63 // 1000 * 1000


def any_message(name: str) -> st.SearchStrategy[Any]:
    known = next(one for one in dialect.mavlink_map.values() if one.msgname == name)
    few = st.sampled_from([b"\x00", b"\x01", b"\x02", b"\x7f", b"\xff"])
    size = known.unpacker.size
    payload = st.binary(min_size=size, max_size=size) | st.lists(
        few, min_size=size, max_size=size
    ).map(b"".join)
    orders = known.orders
    if name == "PARAM_VALUE":
        ids = st.sampled_from([b"AHRS_TRIM_X", b"AHRS_TRIM_Y\0x", b"\xff\0AHRS_TRIM_X", b"OTHER"])
        values = st.floats(-0.25, 0.25, width=32) | st.just(float("nan"))
        return st.builds(parameter, ids, values)
    return payload.map(known.unpacker.unpack).map(lambda t: known(*(t[i] for i in orders)))


@given(st.lists(st.sampled_from(sorted(RULES)).flatmap(any_message), min_size=1, max_size=30))
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_columns_give_the_bytes_of_messages(tmp_path: Path, messages: list[Any]) -> None:
    tlog = read_tlog(write(tmp_path / "any.tlog", *messages))
    readings, frame_index = from_tables(tlog)
    rows = empty(READING_DTYPE)
    found, frames = b"", []
    for index, (offset, received_us, _, length, _, _) in enumerate(tlog.frames.tolist()):
        ((message, _),) = CODEC.feed(tlog.data[offset : offset + length].tobytes())
        if from_message(message, (received_us & ~3) * 1000, rows):
            found += rows.tobytes()
            frames.append(index)
    assert found == readings.tobytes()
    assert frames == frame_index.tolist()


def test_the_link_number_in_a_stamp_is_no_time(tmp_path: Path) -> None:
    path = tmp_path / "link.tlog"
    path.write_bytes(tlog_record(START_US + 7, AUTOPILOT.pack(highres())))
    readings, _ = from_tables(read_tlog(path))
    assert readings["received_ns"].tolist() == [(START_US + 4) * 1000]


def test_references_are_the_autopilots_own_in_file_order(tmp_path: Path) -> None:
    companion, station = Encoder(1, 191), Encoder(255, 190)
    q = dialect.MAVLink_attitude_quaternion_message(30, 1.0, 0.0, 0.0, 0.0, 0, 0, 0)
    recording = recording_from_tlog(
        write(
            tmp_path / "a.tlog",
            (station, heartbeat(8)),
            heartbeat(),
            highres(),
            attitude(10, 0.5),
            (companion, heartbeat(8)),
            (companion, attitude(10, -0.5)),
            q,
            attitude(20, 0.6),
            attitude(25, float("nan")),
        )
    )
    names = [(one.name, one.is_truth) for one in recording.references]
    assert names == [("ATTITUDE_QUATERNION", False), ("ATTITUDE", False)]
    assert recording.references[1].time_ns.tolist() == [10_000_000, 20_000_000]
    np.testing.assert_allclose(
        recording.references[1].ned_from_body,
        quaternion_columns([[0.5, 0.1, 0.2], [0.6, 0.1, 0.2]]),
        atol=1e-7,
    )
    assert recording.message_counts["ATTITUDE"] == 4
    assert recording.format == "tlog"
    assert recording.damaged == {}


def sim_state(q: tuple[float, float, float, float]) -> Any:
    return dialect.MAVLink_sim_state_message(*q, *[0.0] * 17)


def test_truth_takes_the_time_of_the_raw_imu_right_before(tmp_path: Path) -> None:
    recording = recording_from_tlog(
        write(
            tmp_path / "a.tlog",
            heartbeat(),
            sim_state((1.0, 0.0, 0.0, 0.0)),
            scaled("raw_imu", time_usec=1000),
            highres(time_usec=1500),
            sim_state((0.0, 2.0, 0.0, 0.0)),
            scaled("raw_imu", time_usec=2000),
            sim_state((0.0, 0.0, 1.0, 0.0)),
            dialect.MAVLink_simstate_message(0.5, 0.1, 0.2, 0, 0, 0, 0, 0, 0, 0, 0),
        )
    )
    truth, angles = recording.references
    assert (truth.name, truth.is_truth, angles.name, angles.is_truth) == (
        "SIM_STATE",
        True,
        "SIMSTATE",
        True,
    )
    assert truth.time_ns.tolist() == [1_000_000, 2_000_000]
    assert truth.ned_from_body.tolist() == [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    assert angles.time_ns.tolist() == [2_000_000]


def test_references_follow_an_imu_on_unix_time(tmp_path: Path) -> None:
    boot_us = START_US - 50_000_000
    clock = dialect.MAVLink_system_time_message(boot_us + 40_000_000, 40_000)
    imu = [highres(time_usec=boot_us + 1000 * ms) for ms in (50_000, 50_003)]
    with_clock = recording_from_tlog(
        write(tmp_path / "a.tlog", heartbeat(), clock, imu[0], attitude(50_001, 0.1), imu[1])
    )
    assert with_clock.references[0].time_ns.tolist() == [(boot_us + 50_001_000) * 1000]


def test_without_system_time_both_clocks_meet_at_the_time_of_receipt(tmp_path: Path) -> None:
    # The autopilot's Unix time is a minute ahead of the receiver's.
    imu = [highres(time_usec=START_US + 60_000_000 + 1000 * ms) for ms in (1, 3)]
    recording = recording_from_tlog(
        write(tmp_path / "b.tlog", heartbeat(), imu[0], attitude(777, 0.1), imu[1])
    )
    expected = (START_US + 60_000_000 + 2000) * 1000
    assert recording.references[0].time_ns.tolist() == [expected]


def test_a_second_autopilot_has_its_references_named(tmp_path: Path) -> None:
    other = Encoder(2, 1)
    entries = [(other, heartbeat(12)), heartbeat(), highres(), attitude(10, 0.5)]
    entries += [(other, highres()), (other, attitude(10, 0.6))]
    recording = recording_from_tlog(write(tmp_path / "a.tlog", *entries))
    assert [one.name for one in recording.references] == ["ATTITUDE of 2/1", "ATTITUDE of 1/1"]


def test_a_tlog_without_imu_says_what_it_has(tmp_path: Path) -> None:
    path = write(tmp_path / "none.tlog", heartbeat(), attitude(1, 0.1), attitude(2, 0.1))
    with pytest.raises(RecordingError, match=r"none\.tlog.*ATTITUDE 2, HEARTBEAT 1.*record again"):
        recording_from_tlog(path)


def test_raw_counts_in_raw_imu_are_told(tmp_path: Path) -> None:
    counts = scaled("raw_imu", xacc=30, yacc=-60, zacc=-16384)
    assert "raw counts" in recording_from_tlog(write(tmp_path / "a.tlog", counts)).notes[0]
    assert recording_from_tlog(write(tmp_path / "b.tlog", scaled("raw_imu"))).notes == ()


def flown_square(cog_of: Any) -> list[Any]:
    """GPS_RAW_INTs at 5 Hz: 10 s north, east, south and west at 8 m/s."""
    north = east = 0.0
    flown = []
    for n in range(200):
        course = np.pi / 2 * (n // 50)
        north, east = north + 1.6 * np.cos(course), east + 1.6 * np.sin(course)
        at = {"lat": int(north / 0.0111195), "lon": int(east / 0.0111195)}
        flown.append(gps(vel=800, cog=cog_of(course), time_usec=200_000 * n, **at))
    return flown


def square_tlog(path: Path, cog_of: Any, *head: Any) -> Path:
    content = b"".join(tlog_record(START_US, AUTOPILOT.pack(one)) for one in head)
    for n, message in enumerate([heartbeat(), highres(), *flown_square(cog_of)]):
        content += tlog_record(START_US + 200_000 * n, AUTOPILOT.pack(message))
    path.write_bytes(content)
    return path


def gps_velocities(path: Path) -> tuple[Any, tuple[str, ...]]:
    recording = recording_from_tlog(path)
    rows = recording.readings[recording.readings["kind"] == Kind.GPS]
    assert len(rows) == 200
    return rows["velocity_ned_m_s"][:, :2], recording.notes


def test_a_course_that_does_not_follow_the_positions_is_not_used(tmp_path: Path) -> None:
    velocity, notes = gps_velocities(
        square_tlog(tmp_path / "good.tlog", lambda course: int(100 * np.degrees(course)))
    )
    assert np.isfinite(velocity).all()
    assert notes == ()
    radians = square_tlog(tmp_path / "bad.tlog", lambda course: int(100 * course))
    velocity, (note,) = gps_velocities(radians)
    assert np.isnan(velocity).all()
    assert "GPS_RAW_INT of 1/1" in note
    assert "not used" in note


def test_a_doubtful_course_in_an_own_recording_replays_as_the_session_was(tmp_path: Path) -> None:
    marks = mark_messages(MarkKind.SETTINGS, b"{}")
    path = square_tlog(tmp_path / "own.tlog", lambda course: int(100 * course), *marks)
    velocity, (note,) = gps_velocities(path)
    assert np.isfinite(velocity).all()
    assert "used as it was" in note


def test_the_trim_of_the_samples_is_told(tmp_path: Path) -> None:
    entries = [heartbeat(), parameter(b"AHRS_TRIM_X", 0.01), parameter(b"AHRS_TRIM_Y", 0.0)]
    entries += [parameter(b"AHRS_TRIM_Y", -0.02), highres()]
    (note,) = recording_from_tlog(write(tmp_path / "a.tlog", *entries)).notes
    assert "1/1 turned by AHRS_TRIM +0.57 deg about x, -1.15 deg about y" in note


@pytest.mark.parametrize(
    ("name", "limit_deg"),
    [
        # Tilted by 11 deg: a wrong sign would show 22 deg; the autopilot's trim is within 5.
        ("bench_copter_2021-11-23_static_44min_1hz", 5.0),
        ("umn_thor75_fixedwing_50hz_reencoded", 1.0),
    ],
)
def test_real_attitudes_agree_with_gravity(shared: Path, name: str, limit_deg: float) -> None:
    """Unaccelerated, the specific force points against the down axis, in time and in sign."""
    path = shared / "flights" / f"{name}.tlog"
    if not path.is_file():
        pytest.skip(f"no {path.name} in ../shared/data/flights")
    recording = recording_from_tlog(path)
    reference, imu = recording.references[0], recording.readings
    imu = imu[np.isin(imu["source"], [ImuSource.RAW_IMU, ImuSource.HIGHRES_IMU])]
    at = np.clip(np.searchsorted(imu["time_ns"], reference.time_ns), 0, len(imu) - 1)
    force, rate = imu["accel_m_s2"][at], np.linalg.norm(imu["gyro_rad_s"][at], axis=1)
    size = np.linalg.norm(force, axis=1)
    w, x, y, z = reference.ned_from_body.T
    down = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    angle = np.degrees(np.arccos(np.clip(-np.sum(force * down, axis=1) / size, -1.0, 1.0)))
    assert np.median(angle[(abs(size - 9.8) < 0.6) & (rate < 0.2)]) < limit_deg
