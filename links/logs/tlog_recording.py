"""A telemetry log as a recording: readings, attitudes, marks, parameters of all its vehicles."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ahrs_service.adoption import AUTOPILOT_INVALID, NO_VEHICLE, Vehicle, first_vehicle
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.parameter_values import decode, param_name
from ahrs_service.links.logs.readings import from_tables
from ahrs_service.links.logs.recorded_parameters import (
    ParameterHistory,
    RecordedParameters,
    Reported,
)
from ahrs_service.links.logs.recording import Covariates, Log, Recording
from ahrs_service.links.logs.references import attitude_references
from ahrs_service.links.logs.session_marks import read_marks
from ahrs_service.links.logs.tlog import TlogFile, read_tlog
from ahrs_service.links.logs.tlog_covariates import tlog_covariates
from ahrs_service.links.mavlink.gps_velocity import course_is_doubtful, course_likeness
from ahrs_service.links.mavlink.unit_name import unit_name
from ahrs_service.links.mavlink.vehicle_trim import trim_notes
from ahrs_service.records import ImuSource, Kind, Rows
from ahrs_service.settings import IntakeSettings


class TlogLog(Log):
    """A telemetry log that was read.

    `readings` [N] as they are in the file, `frame_index` [N] the frame of each.
    """

    def __init__(self, tlog: TlogFile) -> None:
        self.tlog = tlog
        self.readings, self.frame_index = from_tables(tlog)

    def recording(self) -> Recording:
        """Return the log as input of the pipeline.

        RecordingError where it holds no IMU message; it lists what the log has instead.
        """
        tlog, counts = self.tlog, self.tlog.message_counts()
        if not np.any(self.readings["kind"] == Kind.IMU):
            found = ", ".join(f"{name} {count}" for name, count in list(counts.items())[:12])
            raise RecordingError(
                f"{tlog.path}: holds no IMU message (HIGHRES_IMU, SCALED_IMU, RAW_IMU) with "
                f"values; it has {found or 'none known'}; record again with one of them switched on"
            )
        marks = tuple(read_marks(tlog.tables, self.frame_index))
        readings, doubts = _without_doubtful_courses(tlog, self.readings, bool(marks))
        return Recording(
            path=tlog.path,
            format="tlog",
            readings=readings,
            log=self,
            references=attitude_references(tlog, self.readings, self.frame_index),
            marks=marks,
            message_counts=counts,
            damaged={name: count for name, count in tlog.damaged.items() if count},
            notes=(*_notes(readings), *trim_notes(readings), *doubts),
            units=dict(_units(tlog)),
        )

    def vehicle(self, settings: IntakeSettings) -> Vehicle:
        """Return the vehicle that the intake adopts, NO_VEHICLE where none is heard."""
        return first_vehicle(self.readings, settings)

    def parameters(self, vehicle: Vehicle) -> RecordedParameters:
        """Return what the vehicle reported; else what a ground station reported of it."""
        tables = self.tlog.tables
        autopilot, others = self._autopilots(vehicle)
        counts = {
            key[:2]: tables.count(key)
            for key in tables
            if key[2] == "PARAM_VALUE" and key[:2] not in others
        }
        if not counts:
            return RecordedParameters({}, autopilot)
        most = max(counts, key=lambda sender: counts[sender])
        history = ParameterHistory()
        notes: tuple[str, ...] = ()
        if most != vehicle:
            # A ground station's copy may be from before the session: the vehicle's own values win.
            history.take(_reported(self.tlog, most, autopilot))
            notes = (f"parameters as reported by {most[0]}/{most[1]}, not the vehicle itself",)
            history.changed.clear()
        if vehicle in counts:
            history.take(_reported(self.tlog, vehicle, autopilot))
        return history.result(autopilot, notes)

    def covariates(self, imu: Rows) -> Covariates:
        """Return the covariates of the vehicle of these IMU readings."""
        return tlog_covariates(self.tlog, self.readings, self.frame_index, imu)

    def _autopilots(self, vehicle: Vehicle) -> tuple[int, set[Vehicle]]:
        """Return the vehicle's MAV_AUTOPILOT, 0 if not heard, and the other vehicles' numbers."""
        beats = self.readings[self.readings["kind"] == Kind.HEARTBEAT]
        beats = beats[beats["autopilot"] != AUTOPILOT_INVALID]
        senders = list(zip(beats["system"].tolist(), beats["component"].tolist(), strict=True))
        autopilot = int(beats["autopilot"][senders.index(vehicle)]) if vehicle in senders else 0
        return autopilot, set(senders) - {vehicle, NO_VEHICLE}


def open_tlog(path: str | Path, progress: Callable[[float], None] | None = None) -> TlogLog:
    """Read a tlog, once."""
    return TlogLog(read_tlog(path, progress))


def recording_from_tlog(
    path: str | Path, progress: Callable[[float], None] | None = None
) -> Recording:
    """Read a tlog as input of the pipeline, with the attitudes it contains as references."""
    return open_tlog(path, progress).recording()


def _reported(tlog: TlogFile, sender: Vehicle, autopilot: int) -> Reported:
    table = tlog.tables[(*sender, "PARAM_VALUE")]
    columns = (table[name].tolist() for name in ("param_id", "param_value", "param_type"))
    for name, value, kind in zip(*columns, strict=True):
        yield param_name(name), decode(value, kind, autopilot).value


def _units(tlog: TlogFile) -> Iterator[tuple[Vehicle, str]]:
    """Yield the number of each board that an autopilot reported."""
    for key in tlog.tables:
        if key[2] == "AUTOPILOT_VERSION":
            row = tlog.tables[key][-1]
            yield key[:2], unit_name(int(row["uid"]), row["uid2"].tobytes())


def _without_doubtful_courses(
    tlog: TlogFile, readings: Rows, is_own: bool
) -> tuple[Rows, tuple[str, ...]]:
    """Leave out the GPS velocity of vehicles whose course does not follow their positions.

    A recording of this service keeps it: the replay must equal the session.
    """
    notes = []
    for key in tlog.tables:
        likeness = course_likeness(tlog.tables[key]) if key[2] == "GPS_RAW_INT" else math.nan
        if not course_is_doubtful(likeness):
            continue
        if not is_own:
            readings = readings.copy()
            theirs = (readings["system"] == key[0]) & (readings["component"] == key[1])
            readings["velocity_ned_m_s"][theirs & (readings["kind"] == Kind.GPS)] = np.nan
        notes.append(
            f"GPS_RAW_INT of {key[0]}/{key[1]}: its course does not follow its positions (mean "
            f"cosine {likeness:.2f}; cog in other units than centi-degrees?); the GPS velocity is "
            + ("used as it was when this was recorded" if is_own else "not used")
        )
    return readings, tuple(notes)


def _notes(readings: Rows) -> tuple[str, ...]:
    """Report where RAW_IMU cannot be in mG: its median specific force is far from 1 g."""
    raw = readings["accel_m_s2"][readings["source"] == ImuSource.RAW_IMU]
    if not len(raw):
        return ()
    force = float(np.median(np.linalg.norm(raw, axis=1)))
    if 0.5 < force / STANDARD_GRAVITY_M_S2 < 2.0:
        return ()
    return (
        f"RAW_IMU has a median specific force of {force:.1f} m/s^2 when read in mG: it is likely "
        "in raw counts of the sensor; choose another imu_source",
    )
