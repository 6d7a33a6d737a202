"""A recording of any format as diagnosis and simulation take it: columns on one clock.

Times are seconds since the sender's power-on where the recording tells it, else since its begin.
The IMU is turned into the vehicle's axes by AHRS_TRIM, as the estimator does. Messages without a
time (VFR_HUD, BATTERY_STATUS, SYS_STATUS) take that of the IMU message before them in the file.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from ahrs_service.app.diagnose.loaded_covariates import (
    TlogClock,
    dataflash_covariates,
    moved,
    receiver_position,
    rising,
    tlog_covariates,
    true_velocity,
)
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.links.errors import RecordingError
from ahrs_service.links.logs.dataflash_tables import read_tables
from ahrs_service.links.logs.readings import from_tables, recording_of
from ahrs_service.links.logs.recording import AttitudeReference, Recording
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.records import Floats, ImuSource, Kind, Rows
from ahrs_service.rotation import quaternion_columns, rotate_columns

Progress = Callable[[float], None]

_OWN_TEMPERATURE: Final = (
    ImuSource.ULOG,
    ImuSource.DATAFLASH,
    ImuSource.SCALED_IMU,
    ImuSource.RAW_IMU,
)
_VELOCITIES: Final = (Kind.VELOCITY, Kind.GLOBAL_VELOCITY, Kind.GPS)
_VIBRATION_S: Final = 2.0
_LEAST_RATE_HZ: Final = 20.0


@dataclass(frozen=True, slots=True)
class Loaded:
    """The columns of a recording, and `notes` on what stands for what was not recorded.

    `position_ned_m` is the GPS receiver's, from its first fix: for where no velocity is known.
    """

    columns: Recorded
    position_ned_m: Series
    notes: tuple[str, ...]


def load(path: Path, progress: Progress | None = None) -> Loaded:
    """Read a recording; RecordingError says why it cannot serve."""
    tlog = read_tlog(path, progress) if path.suffix.lower() == ".tlog" else None
    if tlog is None:
        recording = read_recording(path, progress)
    else:
        readings = from_tables(tlog)
        recording = recording_of(tlog, *readings)
    imu = _imu(recording)
    reference = _reference(recording)
    shift_s = 0.0
    covariates: dict[str, Series] = {}
    rate = position = velocity = Series()
    if tlog is not None:
        clock = TlogClock(tlog, *readings, imu)
        shift_s = clock.shift_s
        covariates, rate = tlog_covariates(tlog, clock, reference.name)
        position = receiver_position(tlog, clock)
        if reference.name == "SIM_STATE":
            true_s = np.asarray(reference.time_ns * 1e-9 - shift_s, np.float64)
            velocity = true_velocity(tlog, clock.vehicle, true_s)
    elif recording.format == "DataFlash":
        covariates = dataflash_covariates(read_tables(path), recording.clock_rate)
    imu_s: Floats = imu["time_ns"] * 1e-9 - shift_s
    gyro, accel = imu["gyro_rad_s"].copy(), imu["accel_m_s2"].copy()
    if imu_s[0] > 1e8:
        covariates = {name: moved(one, imu_s[0]) for name, one in covariates.items()}
        rate, position = moved(rate, imu_s[0]), moved(position, imu_s[0])
        velocity = moved(velocity, imu_s[0])
        shift_s, imu_s = shift_s + imu_s[0], imu_s - imu_s[0]
    attitude_s = np.asarray(reference.time_ns * 1e-9 - shift_s, np.float64)
    attitude = rising(Series(attitude_s, reference.ned_from_body))
    temperature, told = _temperature(recording, imu, shift_s)
    notes = [f"reference: {reference.name}", *([told] if told else [])]
    notes += [
        f"damaged: {count} {what.replace('_', ' ')}" for what, count in recording.damaged.items()
    ]
    vibration = covariates.get("vibration", Series())
    if not len(vibration):
        vibration = vibration_of(imu_s, accel)
        notes.append("vibration: computed from the accelerometer itself")
    return Loaded(
        Recorded(
            name=path.name,
            imu_time_s=imu_s,
            gyro_rad_s=_turned(recording, gyro),
            accel_m_s2=_turned(recording, accel),
            attitude=attitude,
            velocity_ned_m_s=velocity if len(velocity) else _velocity(recording, shift_s),
            body_rate_rad_s=rate,
            temperature_degc=temperature,
            vibration_m_s2=vibration,
            current_a=covariates.get("current", Series()),
            throttle=covariates.get("throttle", Series()),
            airspeed_m_s=covariates.get("airspeed", Series()),
            supply_v=covariates.get("supply", Series()),
        ),
        position,
        tuple(notes),
    )


def vibration_of(time_s: Floats, accel_m_s2: Floats) -> Series:
    """Return the 1-sigma [N, 3] of what is faster than 1 s, over 2 s; none below 20 Hz."""
    if len(time_s) < 2 or np.median(np.diff(time_s)) > 1.0 / _LEAST_RATE_HZ:
        return Series()
    rate_hz = 1.0 / float(np.median(np.diff(time_s)))
    slow = uniform_filter1d(accel_m_s2, max(1, round(rate_hz)), axis=0)
    square = uniform_filter1d(
        np.square(accel_m_s2 - slow), max(1, round(_VIBRATION_S * rate_hz)), axis=0
    )
    return Series(time_s, np.sqrt(np.maximum(square, 0.0)))


def _imu(recording: Recording) -> Rows:
    """Return the samples of the fastest IMU source, the better one of like ones, in time."""
    rows = recording.readings[recording.readings["kind"] == Kind.IMU]
    counts = {int(s): int((rows["source"] == s).sum()) for s in np.unique(rows["source"])}
    best = max(counts, key=lambda source: (round(np.log(counts[source]), 1), -source))
    rows = rows[rows["source"] == best]
    finite = np.isfinite(rows["gyro_rad_s"]).all(axis=1)
    finite &= np.isfinite(rows["accel_m_s2"]).all(axis=1)
    rows = rows[finite]
    # Where a clock was set back the longest piece is kept.
    cuts = np.flatnonzero(np.diff(rows["time_ns"]) < -1_000_000_000) + 1
    rows = max(np.split(rows, cuts), key=len)
    rows = rows[np.concatenate([[True], np.diff(np.maximum.accumulate(rows["time_ns"])) > 0])]
    if len(rows) < 2:
        raise RecordingError(
            f"{recording.path}: fewer than two samples with gyro and accelerometer; "
            "record HIGHRES_IMU, SCALED_IMU or RAW_IMU"
        )
    return rows


def _reference(recording: Recording) -> AttitudeReference:
    """Return the truth of a simulator, else the reference with most instants."""
    if not recording.references:
        raise RecordingError(
            f"{recording.path}: no attitude to compare with; "
            "record ATTITUDE_QUATERNION or ATTITUDE at 10 Hz or more"
        )
    return max(recording.references, key=lambda one: (one.is_truth, len(one.time_ns)))


def _turned(recording: Recording, vectors: Floats) -> Floats:
    """Turn vectors [N, 3] from the board's axes into the vehicle's by the last trim told."""
    trims = recording.readings["trim_rad"][recording.readings["kind"] == Kind.TRIM]
    known = [column[np.isfinite(column)][-1:] for column in trims.T]
    x, y = (float(value[0]) if len(value) else 0.0 for value in known)
    if x == y == 0.0:
        return vectors
    q = np.broadcast_to(quaternion_columns(np.array([[x, y, 0.0]])), (len(vectors), 4))
    return rotate_columns(q, vectors)


def _temperature(recording: Recording, imu: Rows, shift_s: float) -> tuple[Series, str]:
    """Return the IMU's own temperature, else that beside its samples with a note."""
    rows = recording.readings[recording.readings["kind"] == Kind.IMU]
    rows = rows[np.isfinite(rows["temperature_degc"])]
    for source in _OWN_TEMPERATURE:
        own = rows[rows["source"] == source]
        if len(own):
            return rising(Series(own["time_ns"] * 1e-9 - shift_s, own["temperature_degc"])), ""
    own = imu[np.isfinite(imu["temperature_degc"])]
    series = rising(Series(own["time_ns"] * 1e-9 - shift_s, own["temperature_degc"]))
    return series, "temperature: HIGHRES_IMU's, often the barometer's" if len(own) else ""


def _velocity(recording: Recording, shift_s: float) -> Series:
    """Return the velocity with most instants: the filter's before the receiver's."""
    readings = recording.readings
    found = []
    for kind in _VELOCITIES:
        rows = readings[readings["kind"] == kind]
        rows = rows[np.isfinite(rows["velocity_ned_m_s"]).all(axis=1) & (rows["time_ns"] > 0)]
        if len(rows):
            found.append(Series(rows["time_ns"] * 1e-9 - shift_s, rows["velocity_ned_m_s"]))
    return rising(max(found, key=len)) if found else Series()
