"""The flight that a twin makes along the reference of a recording."""

from pathlib import Path
from typing import Final

import numpy as np

from ahrs_service.app.diagnose.loaded_recording import Loaded, load
from ahrs_service.attitude_interpolation import gap_limit
from ahrs_service.diagnosis.input.diagnosis_input import Series
from ahrs_service.errors import RecordingError
from ahrs_service.records import Floats
from ahrs_service.settings import IntakeSettings
from ahrs_service.simulation.imu import Imu
from ahrs_service.simulation.reference_track import ReferenceTrack
from ahrs_service.simulation.retrace import Surroundings, retrace
from ahrs_service.simulation.scenario import Flight

_SHORTEST_S: Final = 2.0


def flight_along(
    path: Path, imu: Imu, rate_hz: float, seed: int, asked: IntakeSettings | None = None
) -> tuple[Flight, tuple[str, ...]]:
    """Return the flight along the reference of a recording, and notes on the sources used.

    The longest piece without a gap in the reference is flown; RecordingError if there is none.
    """
    loaded = load(path, asked=asked)
    try:
        track, notes = _track(loaded)
        begin_s, end_s = _longest_piece(track)
        time_s = begin_s + np.arange(int((end_s - begin_s) * rate_hz) + 1) / rate_hz
        surroundings = _surroundings(loaded, time_s)
        flight = retrace(path.stem, track, surroundings, time_s, rate_hz, seed, imu)
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from None
    notes.append(f"from {begin_s:.1f} s to {end_s:.1f} s of the recording's clock")
    return flight, (*loaded.notes, *notes)


def _track(loaded: Loaded) -> tuple[ReferenceTrack, list[str]]:
    columns = loaded.columns
    attitude, velocity, position = (
        columns.attitude,
        columns.velocity_ned_m_s,
        loaded.position_ned_m,
    )
    source = "velocity: the recording's"
    if not len(velocity):
        source = "velocity: from the positions of the GPS receiver"
        if not len(position):
            source = "velocity: none in the recording, assumed at rest"
    track = ReferenceTrack(
        attitude.time_s,
        attitude.values,
        velocity.time_s,
        velocity.values,
        position.time_s,
        position.values,
    )
    return track, [source]


def _longest_piece(track: ReferenceTrack) -> tuple[float, float]:
    """Return begin and end [s] of the longest piece without a gap in the attitude."""
    first, last = track.span_s()
    time_s = track.attitude_s[(track.attitude_s >= first) & (track.attitude_s <= last)]
    if len(time_s) < 2:
        raise ValueError("attitude and velocity do not overlap; give a recording with both")
    steps = np.diff(time_s)
    cuts = np.flatnonzero(steps > gap_limit(steps))
    begins, ends = np.append(0, cuts + 1), np.append(cuts, len(time_s) - 1)
    best = int(np.argmax(time_s[ends] - time_s[begins]))
    begin_s, end_s = float(time_s[begins[best]]), float(time_s[ends[best]])
    if end_s - begin_s < _SHORTEST_S:
        raise ValueError(
            f"the longest piece of the reference without a gap is {end_s - begin_s:.1f} s; "
            f"give a recording with {_SHORTEST_S:g} s or more"
        )
    return begin_s, end_s


def _surroundings(loaded: Loaded, time_s: Floats) -> Surroundings:
    columns = loaded.columns
    vibration = columns.vibration_m_s2
    mean = Series(vibration.time_s, vibration.values.mean(axis=1)) if len(vibration) else Series()
    return Surroundings(
        columns.temperature_degc.at(time_s),
        mean.at(time_s),
        columns.current_a.at(time_s),
        columns.throttle.at(time_s),
        columns.airspeed_m_s.at(time_s),
    )
