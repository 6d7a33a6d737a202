"""The references that a .tlog contains, and their clock."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ahrs_service.links.logs.tlog_recording import recording_from_tlog
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.records import ImuSource
from ahrs_service.rotation import quaternion_columns
from tests.links.messages import (
    START_US,
    attitude,
    heartbeat,
    highres,
    scaled,
    write,
)


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


@pytest.mark.parametrize(
    ("name", "limit_deg"),
    [
        # Tilted by 11 deg: a wrong sign would give 22 deg; the autopilot's trim is within 5.
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
