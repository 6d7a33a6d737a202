"""The columns that diagnosis needs, from a recording of any format."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from ahrs_service.app.diagnose.loaded_recording import Loaded, load
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.errors import DiagnosisError, RecordingError
from ahrs_service.settings import IntakeSettings
from ahrs_service.simulation.reference_track import smooth


def read_columns(
    path: Path,
    progress: Callable[[float], None] | None = None,
    asked: IntakeSettings | None = None,
) -> Recorded:
    """Read the columns of a recording; RecordingError says what is missing."""
    try:
        return with_velocity(load(path, progress, asked))
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from None


def with_velocity(loaded: Loaded) -> Recorded:
    """Return the columns; without a velocity, that of the receiver's positions is used."""
    columns, place = loaded.columns, loaded.position_ned_m
    if len(columns.velocity_ned_m_s):
        return columns
    if not len(place):
        raise DiagnosisError(
            "no velocity to compare the accelerometer with; "
            "record LOCAL_POSITION_NED or GLOBAL_POSITION_INT at 5 Hz or more"
        )
    curve = smooth(place.time_s, place.values, "position")
    velocity = Series(place.time_s, curve.derivative()(place.time_s))
    return dataclasses.replace(columns, velocity_ned_m_s=velocity)
