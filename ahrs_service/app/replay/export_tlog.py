"""A replay as a .tlog for ground stations: the recording with our ATTITUDE added."""

import heapq
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from ahrs_service.links.component.attitude_messages import Publisher
from ahrs_service.links.logs.recording import AttitudeReference, Recording
from ahrs_service.links.logs.tlog import TlogFile, tlog_record
from ahrs_service.links.logs.tlog_recording import TlogLog
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.links.mavlink.frames import STAMP_BYTES
from ahrs_service.links.mavlink.vehicle_trim import TRIM_NAMES
from ahrs_service.records import Integers, Kind, Phase, Rows
from ahrs_service.rotation import euler_columns
from ahrs_service.settings import Settings

_GAUSS_PER_UT: Final = 0.01
_ACCEL_AND_GYRO: Final = 0x3F
_MAGNETOMETER: Final = 0x1C0
_TEMPERATURE: Final = 0x1000
_AUTOPILOT_COMPONENT: Final = 1
_HEARTBEAT_NS: Final = 1_000_000_000


def write_tlog(
    path: Path,
    recording: Recording,
    estimates: Rows,
    positions: Integers,
    system: int,
    settings: Settings,
) -> None:
    """Write a .tlog with what the live service would send as `settings.link.component`.

    Of a .tlog every frame is kept unchanged, and ours follow the frame of their sample. Of
    other logs HEARTBEAT, trim, HIGHRES_IMU and their own attitude are written. `positions`
    [N] gives the reading behind each estimate.
    """
    ours = _published(estimates, settings, Encoder(system, settings.link.component))
    with path.open("wb") as file:
        if isinstance(recording.log, TlogLog):
            behind = recording.log.frame_index[positions].tolist()
            _write_beside(file, recording.log.tlog, ((behind[n], frame) for n, frame in ours))
            return
        stamps = estimates["time_ns"].tolist()
        for stamp_ns, frame in heapq.merge(
            _imu_frames(recording, system),
            ((stamps[n], frame) for n, frame in ours),
            key=lambda item: item[0],
        ):
            file.write(tlog_record(_stamp_us(stamp_ns), frame))


def _published(
    estimates: Rows, settings: Settings, encoder: Encoder
) -> Iterator[tuple[int, bytes]]:
    """Frames that the live service would send, each with the index of its estimate."""
    publisher = Publisher(settings.publish)
    for n in np.flatnonzero(estimates["phase"] == Phase.RUNNING).tolist():
        for message in publisher.messages(estimates[n]):
            yield n, encoder.pack(message)


def _write_beside(file: BinaryIO, tlog: TlogFile, ours: Iterator[tuple[int, bytes]]) -> None:
    """Copy the frames of `tlog` and insert each of ours after the frame of its index."""
    done = 0
    for index, frame in ours:
        _copy(file, tlog, done, index + 1)
        done = max(done, index + 1)
        file.write(tlog_record(int(tlog.frames["received_us"][index]), frame))
    _copy(file, tlog, done, len(tlog.frames))


def _copy(file: BinaryIO, tlog: TlogFile, start: int, stop: int) -> None:
    """Copy frames start..stop with their stamps; bytes between frames are left out."""
    frames = tlog.frames[start:stop]
    first = frames["offset"] - STAMP_BYTES
    end = frames["offset"] + frames["length"]
    # The reader replaced impossible stamps, so such frames are written one by one.
    if len(frames) and not tlog.damaged["bad_stamp"] and (first[1:] == end[:-1]).all():
        file.write(tlog.data[int(first[0]) : int(end[-1])].tobytes())
        return
    for row in frames:
        offset, length = int(row["offset"]), int(row["length"])
        content = tlog.data[offset : offset + length].tobytes()
        file.write(tlog_record(int(row["received_us"]), content))


def _stamp_us(time_ns: int) -> int:
    # The two low bits are a link number to pymavlink-based tools.
    return max(time_ns, 0) // 1000 & ~3


def _imu_frames(recording: Recording, system: int) -> Iterator[tuple[int, bytes]]:
    """HEARTBEAT at 1 Hz, trim, HIGHRES_IMU and the log's attitude, in order of time."""
    encoder = Encoder(system, _AUTOPILOT_COMPONENT)
    readings = recording.readings
    samples = readings[readings["kind"] == Kind.IMU]
    autopilot, vehicle = int(readings["autopilot"].max()), int(readings["vehicle"].max())
    reference = recording.references[0] if recording.references else None
    messages = heapq.merge(
        _heartbeats(samples["time_ns"], autopilot, vehicle),
        _trims(readings[readings["kind"] == Kind.TRIM]),
        _highres(samples),
        _reference_messages(reference),
        key=lambda item: item[0],
    )
    return ((time_ns, encoder.pack(message)) for time_ns, message in messages)


def _heartbeats(time_ns: Integers, autopilot: int, vehicle: int) -> Iterator[tuple[int, Any]]:
    seconds = time_ns // _HEARTBEAT_NS
    for stamp in time_ns[np.diff(seconds, prepend=seconds[:1] - 1) != 0].tolist():
        yield (
            stamp,
            dialect.MAVLink_heartbeat_message(
                vehicle, autopilot, 0, 0, dialect.MAV_STATE_ACTIVE, 3
            ),
        )


def _trims(trims: Rows) -> Iterator[tuple[int, Any]]:
    for time_ns, values in zip(trims["time_ns"].tolist(), trims["trim_rad"].tolist(), strict=True):
        for index, (name, value) in enumerate(zip(TRIM_NAMES, values, strict=True)):
            if math.isfinite(value):
                yield (
                    time_ns,
                    dialect.MAVLink_param_value_message(
                        name.encode(),
                        value,
                        dialect.MAV_PARAM_TYPE_REAL32,
                        len(TRIM_NAMES),
                        index,
                    ),
                )


def _highres(samples: Rows) -> Iterator[tuple[int, Any]]:
    for row in samples:
        time_ns = int(row["time_ns"])
        mag = (row["mag_ut"] * _GAUSS_PER_UT).tolist()
        degc = float(row["temperature_degc"])
        fields = _ACCEL_AND_GYRO
        fields |= 0 if math.isnan(mag[0]) else _MAGNETOMETER
        fields |= 0 if math.isnan(degc) else _TEMPERATURE
        yield (
            time_ns,
            dialect.MAVLink_highres_imu_message(
                time_ns // 1000,
                *row["accel_m_s2"].tolist(),
                *row["gyro_rad_s"].tolist(),
                *(mag if fields & _MAGNETOMETER else (0.0, 0.0, 0.0)),
                0.0,
                0.0,
                0.0,
                degc if fields & _TEMPERATURE else 0.0,
                fields,
            ),
        )


def _reference_messages(reference: AttitudeReference | None) -> Iterator[tuple[int, Any]]:
    if reference is None:
        return
    euler = euler_columns(reference.ned_from_body)
    for n, time_ns in enumerate(reference.time_ns.tolist()):
        time_ms = time_ns // 1_000_000 & 0xFFFFFFFF
        yield time_ns, dialect.MAVLink_attitude_message(time_ms, *euler[n].tolist(), 0.0, 0.0, 0.0)
