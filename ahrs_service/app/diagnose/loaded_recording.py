"""A recording of any format as diagnosis and simulation use it: columns on one clock.

Times are seconds since the sender's power-on where the recording has it, else since its start.
The IMU is the one that the intake chooses, rotated into the vehicle's axes by AHRS_TRIM, as in the
estimator; everything else is from the same vehicle.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from ahrs_service.adoption import Vehicle, of_vehicle
from ahrs_service.app.intake_choice import chosen_imu, intake_of
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.recording import AttitudeReference, Recording, TimedValues
from ahrs_service.links.logs.recording_formats import read_recording
from ahrs_service.records import IMU_OF_SOURCE, Floats, ImuSource, Kind, Rows
from ahrs_service.rotation import quaternion_columns, rotate_columns
from ahrs_service.settings import IntakeSettings

Progress = Callable[[float], None]

_HIGHRES: Final = (ImuSource.HIGHRES_IMU, ImuSource.HIGHRES_IMU_1, ImuSource.HIGHRES_IMU_2)
_LATEST_BEGIN_S: Final = 1e8
"""A clock that starts later than this, three years, does not count from power-on."""
_VELOCITIES: Final = (Kind.VELOCITY, Kind.GLOBAL_VELOCITY, Kind.GPS)
_VIBRATION_S: Final = 2.0
_LEAST_RATE_HZ: Final = 20.0


@dataclass(frozen=True, slots=True)
class Loaded:
    """The columns of a recording, and `notes` on what replaces a quantity that was not recorded.

    `position_ned_m` is the GPS receiver's, relative to its first fix, for use without a velocity.
    """

    columns: Recorded
    position_ned_m: Series
    notes: tuple[str, ...]


def rising(series: Series) -> Series:
    """Return the series sorted by time, without repeated instants."""
    if not len(series):
        return series
    _, first = np.unique(series.time_s, return_index=True)
    return Series(series.time_s[first], series.values[first])


def load(
    path: Path, progress: Progress | None = None, asked: IntakeSettings | None = None
) -> Loaded:
    """Read a recording; RecordingError says why it cannot be used.

    The intake chooses the vehicle and its IMU, as `asked` or automatically. Unlike in a replay,
    data from before the vehicle's first heartbeat is used too.
    """
    recording = read_recording(path, progress)
    settings = intake_of(recording, asked)
    chosen = chosen_imu(recording, settings)
    readings = of_vehicle(recording.readings, chosen.vehicle)
    imu = _in_time(path, readings[readings["source"] == chosen.source])
    reference = _reference(recording, chosen.vehicle)
    covariates = recording.log.covariates(imu)
    shift_s, begin_s = covariates.power_on_s, 0.0
    imu_s: Floats = imu["time_ns"] * 1e-9 - shift_s
    if imu_s[0] > _LATEST_BEGIN_S:
        begin_s = float(imu_s[0])
        shift_s, imu_s = shift_s + begin_s, imu_s - begin_s

    def series(values: TimedValues) -> Series:
        return Series(values.time_s - begin_s, values.values)

    attitude_s = np.asarray(reference.time_ns * 1e-9 - shift_s, np.float64)

    def of_reference(values: Floats | None) -> Series:
        return Series() if values is None else rising(Series(attitude_s, values))

    gyro, accel = imu["gyro_rad_s"].copy(), imu["accel_m_s2"].copy()
    temperature, remark = _temperature(readings, imu, shift_s, settings)
    notes = [f"reference: {reference.name}", *([remark] if remark else [])]
    notes += [
        f"damaged: {count} {what.replace('_', ' ')}" for what, count in recording.damaged.items()
    ]
    vibration = series(covariates.vibration_m_s2)
    if not len(vibration):
        vibration = vibration_of(imu_s, accel)
        notes.append("vibration: computed from the accelerometer itself")
    velocity = of_reference(reference.velocity_ned_m_s)
    return Loaded(
        Recorded(
            name=path.name,
            imu_time_s=imu_s,
            gyro_rad_s=_in_vehicle_axes(readings, gyro),
            accel_m_s2=_in_vehicle_axes(readings, accel),
            attitude=of_reference(reference.ned_from_body),
            velocity_ned_m_s=velocity if len(velocity) else _velocity(readings, shift_s),
            body_rate_rad_s=of_reference(reference.rate_rad_s),
            temperature_degc=temperature,
            vibration_m_s2=vibration,
            current_a=series(covariates.current_a),
            throttle=series(covariates.throttle),
            airspeed_m_s=series(covariates.airspeed_m_s),
            supply_v=series(covariates.supply_v),
        ),
        series(covariates.position_ned_m),
        tuple(notes),
    )


def vibration_of(time_s: Floats, accel_m_s2: Floats) -> Series:
    """Return the 1-sigma [N, 3] over 2 s of the signal above 1 Hz; none for rates below 20 Hz."""
    if len(time_s) < 2 or np.median(np.diff(time_s)) > 1.0 / _LEAST_RATE_HZ:
        return Series()
    rate_hz = 1.0 / float(np.median(np.diff(time_s)))
    slow = uniform_filter1d(accel_m_s2, max(1, round(rate_hz)), axis=0)
    square = uniform_filter1d(
        np.square(accel_m_s2 - slow), max(1, round(_VIBRATION_S * rate_hz)), axis=0
    )
    return Series(time_s, np.sqrt(np.maximum(square, 0.0)))


def _in_time(path: Path, rows: Rows) -> Rows:
    """Return the finite samples in order of time; the longest piece if the clock was set back."""
    finite = np.isfinite(rows["gyro_rad_s"]).all(axis=1)
    finite &= np.isfinite(rows["accel_m_s2"]).all(axis=1)
    rows = rows[finite]
    cuts = np.flatnonzero(np.diff(rows["time_ns"]) < -1_000_000_000) + 1
    rows = max(np.split(rows, cuts), key=len)
    if len(rows):
        later = np.diff(np.maximum.accumulate(rows["time_ns"])) > 0
        rows = rows[np.concatenate([[True], later])]
    if len(rows) < 2:
        raise RecordingError(
            f"{path}: fewer than two samples with gyro and accelerometer; "
            "record HIGHRES_IMU, SCALED_IMU or RAW_IMU"
        )
    return rows


def _reference(recording: Recording, vehicle: Vehicle) -> AttitudeReference:
    """Return a simulator's truth, else the vehicle's reference with most samples."""
    references = recording.references_of(vehicle)
    if not references:
        raise RecordingError(
            f"{recording.path}: no attitude to compare with; "
            "record ATTITUDE_QUATERNION or ATTITUDE at 10 Hz or more"
        )
    return max(references, key=lambda one: (one.is_truth, len(one.time_ns)))


def _in_vehicle_axes(readings: Rows, vectors: Floats) -> Floats:
    """Rotate vectors [N, 3] from the board's axes into the vehicle's by the last trim reported."""
    trims = readings["trim_rad"][readings["kind"] == Kind.TRIM]
    known = [column[np.isfinite(column)][-1:] for column in trims.T]
    x, y = (float(value[0]) if len(value) else 0.0 for value in known)
    if x == y == 0.0:
        return vectors
    q = np.broadcast_to(quaternion_columns(np.array([[x, y, 0.0]])), (len(vectors), 4))
    return rotate_columns(q, vectors)


def _temperature(
    readings: Rows, imu: Rows, shift_s: float, settings: IntakeSettings
) -> tuple[Series, str]:
    """Return the temperature of the chosen IMU, else the one sent with its samples, and a note."""
    rows = readings[(readings["kind"] == Kind.IMU) & np.isfinite(readings["temperature_degc"])]
    is_trusted = settings.temperature_source == "highres_imu"
    number = IMU_OF_SOURCE.get(ImuSource(int(imu["source"][0])), 0)
    for source in ImuSource:
        if IMU_OF_SOURCE.get(source, 0) != number or (source in _HIGHRES and not is_trusted):
            continue
        own = rows[rows["source"] == source]
        if len(own):
            return rising(Series(own["time_ns"] * 1e-9 - shift_s, own["temperature_degc"])), ""
    own = imu[np.isfinite(imu["temperature_degc"])]
    series = rising(Series(own["time_ns"] * 1e-9 - shift_s, own["temperature_degc"]))
    return series, "temperature: HIGHRES_IMU's, often the barometer's" if len(own) else ""


def _velocity(readings: Rows, shift_s: float) -> Series:
    """Return the velocity with most samples; the filter's is preferred to the receiver's."""
    found = []
    for kind in _VELOCITIES:
        rows = readings[readings["kind"] == kind]
        rows = rows[np.isfinite(rows["velocity_ned_m_s"]).all(axis=1) & (rows["time_ns"] > 0)]
        if len(rows):
            found.append(Series(rows["time_ns"] * 1e-9 - shift_s, rows["velocity_ned_m_s"]))
    return rising(max(found, key=len)) if found else Series()
