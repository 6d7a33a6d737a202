"""Notes on a .tlog: no IMU, raw counts, a doubtful course, a trim."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.session_marks import MarkKind, mark_messages
from ahrs_service.links.logs.tlog import tlog_record
from ahrs_service.links.logs.tlog_recording import recording_from_tlog
from ahrs_service.records import Kind
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


def test_a_tlog_without_imu_says_what_it_has(tmp_path: Path) -> None:
    path = write(tmp_path / "none.tlog", heartbeat(), attitude(1, 0.1), attitude(2, 0.1))
    with pytest.raises(RecordingError, match=r"none\.tlog.*ATTITUDE 2, HEARTBEAT 1.*record again"):
        recording_from_tlog(path)


def test_raw_counts_in_raw_imu_are_reported(tmp_path: Path) -> None:
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


def test_the_trim_of_the_samples_is_reported(tmp_path: Path) -> None:
    entries = [heartbeat(), parameter(b"AHRS_TRIM_X", 0.01), parameter(b"AHRS_TRIM_Y", 0.0)]
    entries += [parameter(b"AHRS_TRIM_Y", -0.02), highres()]
    (note,) = recording_from_tlog(write(tmp_path / "a.tlog", *entries)).notes
    assert "1/1 turned by AHRS_TRIM +0.57 deg about x, -1.15 deg about y" in note
