"""Messages to readings: units, what counts as absent, columns as single messages."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ahrs_service.links.logs.readings import RULES, from_message, from_tables
from ahrs_service.links.logs.tlog import read_tlog, tlog_record
from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect
from ahrs_service.records import READING_DTYPE, ImuSource, Kind, Rows, empty
from tests.links.messages import (
    AUTOPILOT,
    START_US,
    attitude,
    gps,
    heartbeat,
    highres,
    parameter,
    scaled,
    write,
)

RECEIVED_NS = START_US * 1000
CODEC = Decoder()


def reading_of(message: Any, encoder: Encoder = AUTOPILOT) -> Rows | None:
    """The reading of a message that went over the wire; None where it gives none."""
    ((received, _),) = CODEC.feed(encoder.pack(message))
    rows = empty(READING_DTYPE)
    return rows[0] if from_message(received, RECEIVED_NS, rows) else None


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


def test_a_receiver_reports_speed_and_course_over_ground() -> None:
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
