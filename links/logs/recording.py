"""What every recording reader returns, for any file format."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.adoption import Vehicle
from ahrs_service.links.logs.recorded_parameters import RecordedParameters
from ahrs_service.links.logs.session_marks import Mark
from ahrs_service.records import READING_DTYPE, Floats, Integers, Kind, Rows, empty
from ahrs_service.settings import IntakeSettings

OWN: Final[Vehicle] = (1, 1)
"""The vehicle of an on-board log, which has no system and component numbers."""


@dataclass(frozen=True, slots=True)
class AttitudeReference:
    """An attitude contained in the recording, for comparison.

    `time_ns` [N] on the clock of the IMU samples, `ned_from_body` [N, 4] wxyz. `is_truth` is set
    for a simulator's truth; everything else is some estimator's output. `vehicle` is its vehicle;
    `rate_rad_s` [N, 3] and `velocity_ned_m_s` [N, 3] come from the same messages, else None.
    """

    name: str
    time_ns: Integers
    ned_from_body: Floats
    is_truth: bool = False
    vehicle: Vehicle = OWN
    rate_rad_s: Floats | None = None
    velocity_ned_m_s: Floats | None = None


@dataclass(frozen=True, slots=True)
class TimedValues:
    """Values [N] or [N, M] at `time_s` [N], rising; empty where the log has none."""

    time_s: Floats = field(default_factory=lambda: np.empty(0))
    values: Floats = field(default_factory=lambda: np.empty(0))

    def __len__(self) -> int:
        return len(self.time_s)


def rising(time_s: Floats, values: Floats) -> TimedValues:
    """Return values in order of time, each instant once."""
    _, first = np.unique(time_s, return_index=True)
    return TimedValues(time_s[first], values[first])


@dataclass(frozen=True, slots=True)
class Covariates:
    """Covariates of one vehicle in a log, besides readings and attitudes.

    Times are on the clock of the IMU samples less `power_on_s`, which makes Unix time the time
    since power-on. `vibration_m_s2` [N, 3]; `throttle` 0 to 1; `position_ned_m` [N, 3] of the GPS
    receiver from its first 3D fix, as a local tangent plane of a spherical Earth.
    """

    power_on_s: float = 0.0
    vibration_m_s2: TimedValues = field(default_factory=TimedValues)
    current_a: TimedValues = field(default_factory=TimedValues)
    supply_v: TimedValues = field(default_factory=TimedValues)
    throttle: TimedValues = field(default_factory=TimedValues)
    airspeed_m_s: TimedValues = field(default_factory=TimedValues)
    position_ned_m: TimedValues = field(default_factory=TimedValues)


class Log(ABC):
    """A log file of any format, read once, when it was opened.

    A reader's module has a function `(path, progress) -> Log`; recording_formats names it. Costly
    and seldom used parts, parameters and covariates, are made on request.
    """

    @abstractmethod
    def recording(self) -> "Recording":
        """Return the log as input of the pipeline; RecordingError where it holds no IMU."""

    def vehicle(self, settings: IntakeSettings) -> Vehicle:
        """Return the vehicle that the intake adopts; an on-board log has only one."""
        del settings
        return OWN

    def parameters(self, vehicle: Vehicle) -> RecordedParameters:
        """Return the parameters of a vehicle's autopilot; none by default."""
        del vehicle
        return RecordedParameters({})

    def covariates(self, imu: Rows) -> Covariates:
        """Return the covariates, for the clock and vehicle of the IMU readings [N]."""
        del imu
        return Covariates()


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording as input of the pipeline.

    `readings` [N] READING_DTYPE in order of arrival, of all vehicles; `log` the file behind it, for
    parameters and covariates; `marks` of a session of this service, in order; `message_counts`
    messages by name; `damaged` frames or bytes that could not be read, by reason; `notes` facts for
    the user; `units` the number of each autopilot's board (links.component.unit_request), as far as
    known; `clock_rate` by how much the log's own stamps were stretched to be seconds (1.0: not at
    all).

    >>> from ahrs_service import as_columns, read_recording
    >>> recording = read_recording("flight.tlog")
    >>> [reference.name for reference in recording.references]
    ['SIM_STATE', 'ATTITUDE_QUATERNION', 'ATTITUDE']
    >>> list(as_columns(recording.readings))[:3]
    ['received_ns', 'time_ns', 'gyro_rad_s_x']
    """

    path: Path
    format: str
    readings: Rows
    log: Log = field(repr=False, compare=False)
    references: tuple[AttitudeReference, ...] = ()
    marks: tuple[Mark, ...] = ()
    message_counts: dict[str, int] = field(default_factory=dict)
    damaged: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    units: Mapping[Vehicle, str] = field(default_factory=dict)
    clock_rate: float = 1.0

    def unit_of(self, vehicle: Vehicle) -> str:
        """Return the number of a vehicle's board, "" if not known."""
        return self.units.get(vehicle, "")

    def references_of(self, vehicle: Vehicle) -> tuple[AttitudeReference, ...]:
        """Return the attitudes that a vehicle reports of itself."""
        return tuple(one for one in self.references if one.vehicle == vehicle)


def own_readings(time_ns: npt.NDArray[np.int64], kind: Kind) -> Rows:
    """Return readings of an on-board log's vehicle, with times of receipt equal to their stamps."""
    rows = empty(READING_DTYPE, len(time_ns))
    rows["time_ns"] = rows["received_ns"] = time_ns
    rows["kind"] = kind
    rows["system"], rows["component"] = OWN
    return rows
