"""Recording readers by file suffix; a reader's libraries load when it is first used."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Final, cast

from ahrs_service.errors import RecordingError
from ahrs_service.links.logs.recorded_parameters import RecordedParameters
from ahrs_service.links.logs.recording import Log, Recording
from ahrs_service.settings import IntakeSettings

Progress = Callable[[float], None]
Reader = Callable[[Path, Progress | None], Log]

READERS: Final = {
    ".tlog": ("MAVLink", "ahrs_service.links.logs.tlog_recording:open_tlog"),
    ".ulg": ("PX4 ULog", "ahrs_service.links.logs.ulog:open_ulog"),
    ".bin": ("ArduPilot DataFlash", "ahrs_service.links.logs.dataflash:open_dataflash"),
}
"""Name of each format and its reader, "module:function", by suffix: one line adds a format."""
KNOWN: Final = ", ".join(f"{name} {suffix}" for suffix, (name, _) in READERS.items())


def reader_for(path: Path) -> Reader:
    """Return the reader of a file's suffix; RecordingError names the formats there are."""
    found = READERS.get(path.suffix.lower())
    if found is None:
        raise RecordingError(
            f"{path}: {path.suffix or 'a file without suffix'} is not a supported log format; "
            f"known are {KNOWN}; give the original log"
        )
    module, _, name = found[1].partition(":")
    return cast(Reader, getattr(importlib.import_module(module), name))


def open_log(path: str | Path, progress: Progress | None = None) -> Log:
    """Read a log of any known format; `progress` is called with the share read, 0 to 1."""
    path = Path(path)
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; give a recording: {KNOWN}")
    reader = reader_for(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; check the path")
    return reader(path, progress)


def read_recording(path: str | Path, progress: Progress | None = None) -> Recording:
    """Read a recording of any known format; `progress` is called with the share read, 0 to 1.

    >>> from ahrs_service import read_recording
    >>> recording = read_recording("flight.tlog")
    >>> recording.format
    'tlog'
    """
    return open_log(path, progress).recording()


def read_recorded_parameters(
    path: str | Path, settings: IntakeSettings | None = None
) -> RecordedParameters:
    """Return the parameters in a log, of the vehicle that the intake adopts; none is no error."""
    log = open_log(path)
    return log.parameters(log.vehicle(settings or IntakeSettings()))
