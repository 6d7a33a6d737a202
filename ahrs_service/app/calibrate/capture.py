"""From a recording or the readings of a live session to the IMU columns that procedures take.

The columns are in the axes the autopilot sends, not rotated by its trim, and of one IMU message
throughout: the one that a replay would settle on, or the one named.
"""

import argparse
import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from ahrs_service.app import intake_choice
from ahrs_service.calibration.autopilots.double_compensation import already_compensated
from ahrs_service.calibration.columns import ImuColumns
from ahrs_service.chosen_imu import choose_imu
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import CalibrationError, ConfigError, RecordingError
from ahrs_service.links.logs.recording import Recording
from ahrs_service.links.logs.recording_formats import KNOWN, read_recording
from ahrs_service.records import ImuSource, Rows
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
    `recording` is what was read, for whoever replays it.
    """

    columns: ImuColumns
    path: Path
    sha256: str
    source: str
    rate_hz: float
    notes: tuple[str, ...] = ()
    compensated: tuple[str, ...] = ()
    unit: str = ""
    recording: Recording | None = field(default=None, repr=False, compare=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the recordings and what chooses the samples in them."""
    parser.add_argument("recordings", nargs="*", type=Path, metavar="RECORDING", help=KNOWN)
    intake_choice.add_arguments(parser)


def read_capture(path: Path, asked: IntakeSettings | None = None) -> Capture:
    """Read one recording; RecordingError where it holds no samples of the IMU asked for."""
    recording = read_recording(path)
    return capture_of(recording, recording.readings, asked)


def capture_of(recording: Recording, readings: Rows, asked: IntakeSettings | None) -> Capture:
    """Return the capture of those `readings` of a recording; the vehicle is that of the whole."""
    path, settings = recording.path, intake_choice.intake_of(recording, asked)
    columns, source = columns_of(readings, settings)
    if not len(columns.time_s):
        raise RecordingError(
            f"{path}: holds no samples of the IMU asked for (--system {settings.system}, --imu "
            f"{settings.imu_source}); it has "
            + ", ".join(f"{name} {count}" for name, count in recording.message_counts.items())
        )
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    vehicle = settings.system, settings.component
    recorded = recording.log.parameters(vehicle)
    compensated = already_compensated(recorded.values, ImuSource[source], recorded.autopilot)
    return Capture(
        columns=columns,
        path=path,
        sha256=digest,
        source=source,
        rate_hz=1.0 / columns.interval_s,
        notes=recording.notes,
        compensated=tuple(compensated),
        unit=recording.unit_of(vehicle),
        recording=recording,
    )


def read_captures(arguments: argparse.Namespace) -> list[Capture]:
    """Read the recordings named; ConfigError where there is none."""
    if not arguments.recordings:
        raise ConfigError("give one recording or more, or --link URI for a guided session")
    asked = intake_choice.asked_intake(arguments)
    return [read_capture(path, asked) for path in arguments.recordings]


def columns_of(readings: Rows, settings: IntakeSettings) -> tuple[ImuColumns, str]:
    """Return the columns of readings [N] READING_DTYPE, and the IMU message that they are of."""
    samples = choose_imu(readings, settings).samples
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
