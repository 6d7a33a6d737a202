"""Recording readers by file suffix; a reader's libraries load when it is first used."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Final, cast

from ahrs_service.links.errors import RecordingError
from ahrs_service.links.logs.recording import Recording

Reader = Callable[[Path, Callable[[float], None] | None], Recording]

READERS: Final = {
    ".tlog": "ahrs_service.links.logs.readings:recording_from_tlog",
    ".ulg": "ahrs_service.links.logs.ulog:read_ulog",
    ".bin": "ahrs_service.links.logs.dataflash:read_dataflash",
}
KNOWN: Final = "MAVLink .tlog, PX4 ULog .ulg, ArduPilot DataFlash .bin"


def reader_for(path: Path) -> Reader:
    """Return the reader of a file's suffix; RecordingError names the formats there are."""
    target = READERS.get(path.suffix.lower())
    if target is None:
        raise RecordingError(
            f"{path}: {path.suffix or 'a file without suffix'} is no log format that is read; "
            f"known are {KNOWN}; give the original log"
        )
    module, _, name = target.partition(":")
    return cast(Reader, getattr(importlib.import_module(module), name))


def read_recording(path: str | Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a recording of any known format; `progress` is called with the share read, 0 to 1."""
    path = Path(path)
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; give a recording: {KNOWN}")
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; check the path")
    return reader_for(path)(path, progress)
