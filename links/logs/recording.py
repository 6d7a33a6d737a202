"""What every recording reader returns, whatever the file's format."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ahrs_service.records import READING_DTYPE, Kind, Rows, empty


@dataclass(frozen=True, slots=True)
class AttitudeReference:
    """An attitude the recording itself contains, to compare with.

    `time_ns` [N] on the clock of the IMU samples, `ned_from_body` [N, 4] wxyz. `is_truth` is set
    for a simulator's truth; everything else is some estimator's output.
    """

    name: str
    time_ns: npt.NDArray[np.int64]
    ned_from_body: npt.NDArray[np.float64]
    is_truth: bool = False


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording as the pipeline takes it.

    `readings` [N] READING_DTYPE in order of arrival; `message_counts` messages by name;
    `damaged` frames or bytes that could not be read, by reason; `notes` facts for the user;
    `unit` the number of the autopilot's board (links.component.unit_request), empty if not known;
    `clock_rate` by how much the log's own stamps were stretched to be seconds (1.0: not at all).

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
    references: tuple[AttitudeReference, ...] = ()
    message_counts: dict[str, int] = field(default_factory=dict)
    damaged: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    unit: str = ""
    clock_rate: float = 1.0


def own_readings(time_ns: npt.NDArray[np.int64], kind: Kind) -> Rows:
    """Return readings of the vehicle that keeps its own log, received when they were true."""
    rows = empty(READING_DTYPE, len(time_ns))
    rows["time_ns"] = rows["received_ns"] = time_ns
    rows["kind"] = kind
    rows["system"] = rows["component"] = 1
    return rows
