"""From a recording, or from columns, to its diagnosis: `ahrs_service.diagnose`."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Final

from ahrs_service.app.diagnose.diagnosis_text import DOUBTFUL_TRUTH
from ahrs_service.app.diagnose.loaded_recording import load
from ahrs_service.app.diagnose.recorded_columns import with_velocity
from ahrs_service.app.files import truth_file, twin_file
from ahrs_service.diagnosis.diagnose import diagnose as diagnose_columns
from ahrs_service.diagnosis.input.diagnosis_input import Recorded
from ahrs_service.diagnosis.input.effect_removal import without_effects
from ahrs_service.diagnosis.result import Diagnosis
from ahrs_service.errors import RecordingError
from ahrs_service.sensor.compensation import compensate_columns
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.settings import IntakeSettings
from ahrs_service.simulation.imu import Imu

Advance = Callable[[str, float], None]

_READ: Final = 0.05
"""Share of the total time spent on reading the recording."""


def diagnose(
    source: str | Path | Recorded,
    twin: Imu | str | Path | None = None,
    truth: str | Path | None = None,
    advance: Advance | None = None,
    intake: IntakeSettings | None = None,
) -> Diagnosis:
    """Compare a recording with its twin: where they differ, what physics is missing, how sure.

    `source` is a recording (.tlog, .ulg, .bin) or columns of one; `twin` is a model of the sensor
    or its file (default: an ideal sensor); `truth` is a file of the effects known to be in the
    recording, to compare the findings with. `advance` is called with the current stage and the
    share done, 0 to 1; `intake` selects vehicle and IMU in a log of several. RecordingError or
    DiagnosisError says what is missing.

    >>> from ahrs_service import diagnose
    >>> diagnosis = diagnose("bench.tlog")
    >>> diagnosis.verdict
    'explained'
    >>> [finding.effect for finding in diagnosis.findings]
    ['gyro_scale_factor']
    """
    known = Imu() if twin is None else twin
    if isinstance(known, str | Path):
        known = twin_file.read(Path(known))
    truth_path = None if truth is None else Path(truth)
    report = advance or _silent
    if isinstance(source, Recorded):
        return _diagnose(source, known, truth_path, report, ())
    path = Path(source)
    loaded = load(path, lambda share: report("reading", _READ * share), intake)
    try:
        return _diagnose(with_velocity(loaded), known, truth_path, report, loaded.notes)
    except ValueError as error:
        # Some of these name the recording, but not the folder that it is in.
        why = str(error).removeprefix(f"{path.name}: ")
        raise RecordingError(f"{path}: {why}") from None


def _diagnose(
    recorded: Recorded, twin: Imu, truth_path: Path | None, report: Advance, notes: tuple[str, ...]
) -> Diagnosis:
    columns = without_effects(compensated(recorded, twin.calibration), twin.effects)
    truth = None if truth_path is None else truth_file.read(truth_path, columns)
    diagnosis = diagnose_columns(
        columns, lambda share: report("searching", _READ + (1.0 - _READ) * share), truth
    )
    notes = (*notes, *diagnosis.notes)
    if diagnosis.oracle and diagnosis.oracle.oracle["gyro"].log_likelihood_gain < 0.0:
        notes = (*notes, DOUBTFUL_TRUTH)
    return dataclasses.replace(diagnosis, notes=notes)


def compensated(columns: Recorded, calibration: Calibration) -> Recorded:
    """Return the columns with the IMU's readings compensated by the twin's calibration."""
    if calibration == Calibration.ideal():
        return columns
    time_s = columns.imu_time_s
    temperature = columns.temperature_degc.at(time_s)
    gyro, accel = compensate_columns(
        coefficients(calibration), columns.gyro_rad_s, columns.accel_m_s2, temperature, time_s
    )
    return dataclasses.replace(columns, gyro_rad_s=gyro, accel_m_s2=accel)


def _silent(stage: str, share: float) -> None:
    del stage, share
