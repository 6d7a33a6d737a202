"""From a recording or the readings of a live session to the IMU columns that procedures take.

The columns are in the axes the autopilot sends, not rotated by its trim, and of one IMU message
throughout: the one that a replay would settle on, or the one named.
"""

import argparse
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ahrs_service import intake
from ahrs_service.app.files.config_file import ConfigError
from ahrs_service.calibration.autopilots.double_compensation import already_compensated
from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.calibration.errors import CalibrationError
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.links.errors import RecordingError
from ahrs_service.links.logs.recorded_parameters import read_recorded_parameters
from ahrs_service.links.logs.recording import Recording
from ahrs_service.links.logs.recording_formats import KNOWN, read_recording
from ahrs_service.records import SAMPLE_DTYPE, ImuSource, Kind, Rows, empty
from ahrs_service.settings import IntakeSettings

_BETWEEN_RECORDINGS_S: Final = 1000.0
_LEAST_IN_ORDER: Final = 0.9
# Somigliana's formula, WGS 84: equatorial gravity, k and e^2 (NIMA TR8350.2).
_EQUATOR_M_S2: Final = 9.7803253359
_K: Final = 0.00193185265241
_E2: Final = 0.00669437999014


@dataclass(frozen=True, slots=True)
class Capture:
    """IMU columns and where they come from: IMU message, sample rate [Hz], hash of the file.

    `unit` is the number of the autopilot's board, "" where the recording does not have it.
    `compensated` names what the autopilot had removed from these samples, as far as is known.
    """

    columns: ImuColumns
    path: Path
    sha256: str
    source: str
    rate_hz: float
    notes: tuple[str, ...] = ()
    compensated: tuple[str, ...] = ()
    unit: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the recordings and what chooses the samples in them."""
    parser.add_argument("recordings", nargs="*", type=Path, metavar="RECORDING", help=KNOWN)
    parser.add_argument(
        "--imu",
        default="auto",
        metavar="MESSAGE",
        help="the IMU message: auto, or " + ", ".join(s.name for s in ImuSource if s),
    )
    parser.add_argument(
        "--temperature",
        choices=("imu", "highres_imu"),
        default="imu",
        help="whose temperature: the IMU's own, or HIGHRES_IMU's field (of some recordings)",
    )


def intake_of(arguments: argparse.Namespace) -> IntakeSettings:
    """Return the settings of the intake that the arguments ask for."""
    settings = IntakeSettings(imu_source=arguments.imu, temperature_source=arguments.temperature)
    try:
        intake.parameters(settings)
    except ValueError as error:
        raise ConfigError(str(error).replace("intake.imu_source =", "--imu")) from None
    return settings


def read_capture(path: Path, settings: IntakeSettings) -> Capture:
    """Read one recording; RecordingError where it holds no samples of the IMU asked for."""
    recording = read_recording(path)
    return capture_of(recording, recording.readings, settings)


def capture_of(recording: Recording, readings: Rows, settings: IntakeSettings) -> Capture:
    """Return the capture of those `readings` of a recording."""
    path = recording.path
    columns, source = columns_of(readings, settings)
    if not len(columns.time_s):
        raise RecordingError(
            f"{path}: holds no samples of the IMU asked for (--imu {settings.imu_source}); it has "
            + ", ".join(f"{name} {count}" for name, count in recording.message_counts.items())
        )
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    known = read_recorded_parameters(path)
    return Capture(
        columns=columns,
        path=path,
        sha256=digest,
        source=source,
        rate_hz=1.0 / columns.interval_s,
        notes=recording.notes,
        compensated=tuple(already_compensated(known.values, ImuSource[source], known.autopilot)),
        unit=recording.unit,
    )


def read_captures(arguments: argparse.Namespace) -> list[Capture]:
    """Read the recordings named; ConfigError where there is none."""
    if not arguments.recordings:
        raise ConfigError("give one recording or more, or --link URI for a guided session")
    settings = intake_of(arguments)
    return [read_capture(path, settings) for path in arguments.recordings]


def columns_of(readings: Rows, settings: IntakeSettings) -> tuple[ImuColumns, str]:
    """Return the columns of readings [N] READING_DTYPE, and the IMU message that they are of."""
    # Without trims: a calibration is of the sensor's axes, the trim is of the vehicle's.
    readings = readings[readings["kind"] != Kind.TRIM]
    samples = _select(readings, settings)
    sources, counts = np.unique(samples["source"], return_counts=True)
    if len(sources) > 1:
        name = ImuSource(int(sources[np.argmax(counts)])).name
        one = IntakeSettings(settings.system, settings.component, name, settings.temperature_source)
        samples = _select(readings, one)
    finite = np.isfinite(samples["gyro_rad_s"]).all(axis=1)
    finite &= np.isfinite(samples["accel_m_s2"]).all(axis=1)
    samples = _in_order(samples[finite])
    source = ImuSource(int(samples["source"][0])).name if len(samples) else "none"
    return (
        ImuColumns(
            (samples["time_ns"] - samples["time_ns"][:1]) * 1e-9,
            samples["gyro_rad_s"],
            samples["accel_m_s2"],
            samples["temperature_degc"],
        ),
        source,
    )


def _select(readings: Rows, settings: IntakeSettings) -> Rows:
    count = int(np.count_nonzero(readings["kind"] == Kind.IMU))
    samples, positions = empty(SAMPLE_DTYPE, count), np.zeros(count, np.int64)
    written = intake.select(
        intake.parameters(settings), intake.new_state(), readings, samples, positions
    )
    return samples[:written]


def _in_order(samples: Rows) -> Rows:
    """Return the samples whose time is later than all before; by receipt where few are."""
    for name in ("time_ns", "received_ns"):
        time_ns = samples[name]
        later = np.concatenate([[True], time_ns[1:] > np.maximum.accumulate(time_ns)[:-1]])
        if len(samples) and later.mean() >= _LEAST_IN_ORDER:
            kept = samples[later].copy()
            kept["time_ns"] = kept[name]
            return kept
    return samples[:0]


def joined(captures: list[Capture]) -> ImuColumns:
    """Return all captures as one, with a gap between them that no turn and no pose spans."""
    begin_s, times = 0.0, []
    for capture in captures:
        times.append(capture.columns.time_s + begin_s)
        begin_s = float(times[-1][-1]) + _BETWEEN_RECORDINGS_S
    return ImuColumns(
        np.concatenate(times),
        np.concatenate([capture.columns.gyro_rad_s for capture in captures]),
        np.concatenate([capture.columns.accel_m_s2 for capture in captures]),
        np.concatenate([capture.columns.temperature_degc for capture in captures]),
    )


def add_gravity(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for local gravity."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--latitude",
        type=float,
        metavar="DEG",
        help="gravity by latitude (WGS 84): 0.5 %% more at the poles than at the equator",
    )
    where.add_argument(
        "--gravity", type=float, metavar="M_S2", help="local gravity (default: 9.80665)"
    )


def gravity_of(arguments: argparse.Namespace) -> float:
    """Return the gravity [m/s^2] given by the arguments; ConfigError where it is not Earth's."""
    if arguments.gravity is not None:
        if not 9.7 < arguments.gravity < 9.9:
            raise ConfigError(
                f"--gravity {arguments.gravity:g}: give the local gravity in m/s^2, 9.76 to 9.84"
            )
        return float(arguments.gravity)
    if arguments.latitude is None:
        return STANDARD_GRAVITY_M_S2
    if not -90.0 <= arguments.latitude <= 90.0:
        raise ConfigError(f"--latitude {arguments.latitude:g}: give degrees from -90 to 90")
    sine2 = math.sin(math.radians(arguments.latitude)) ** 2
    return _EQUATOR_M_S2 * (1.0 + _K * sine2) / math.sqrt(1.0 - _E2 * sine2)


def check_rate(capture: Capture, least_hz: float, why: str) -> None:
    """Raise CalibrationError where a recording's rate is too low for its purpose."""
    if not capture.rate_hz >= least_hz:
        raise CalibrationError(
            f"{capture.path.name}: {capture.source} comes at {capture.rate_hz:.1f} Hz, {why} needs "
            f"{least_hz:g} Hz or more: ask the autopilot for a faster message "
            "(SET_MESSAGE_INTERVAL; --link does it)"
        )
