"""Topics, parameters and damage of PX4 ULog (.ulg) files, read with pyulog."""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy.typing as npt
from pyulog import ULog

from ahrs_service.errors import RecordingError
from ahrs_service.links.mavlink.unit_name import unit_name

Table = dict[str, npt.NDArray[Any]]

_BLOCK: Final = 1 << 18


@dataclass(frozen=True, slots=True)
class UlogTables:
    """The topics of a log by (name, instance), and the damage found in the file.

    `parameters` are those at the start, and the later changes.
    """

    topics: dict[tuple[str, int], Table]
    counts: dict[str, int]
    damaged: dict[str, int]
    notes: tuple[str, ...]
    vehicle: int
    unit: str
    parameters: tuple[list[tuple[str, Any]], list[tuple[str, Any]]]


class _CountingFile(io.FileIO):
    """A file that reports how far it has been read; pyulog has no progress of its own."""

    def __init__(self, path: Path, progress: Callable[[float], None] | None) -> None:
        super().__init__(path)
        self._size = max(path.stat().st_size, 1)
        self._progress = progress

    def readinto(self, buffer: Any) -> int | None:
        count = super().readinto(buffer)
        if self._progress is not None:
            self._progress(min(self.tell() / self._size, 1.0))
        return count


def read_tables(path: Path, progress: Callable[[float], None] | None) -> UlogTables:
    """Read a ULog; RecordingError if it is not one. `progress` is called with the share read."""
    try:
        with (
            _CountingFile(path, progress) as raw,
            # pyulog prints its findings; they are reported through Recording.damaged instead.
            contextlib.redirect_stdout(io.StringIO()),
        ):
            log = ULog(io.BufferedReader(raw, _BLOCK))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:
        # pyulog raises many kinds of error for a damaged header or definition section.
        raise RecordingError(
            f"{path}: not a ULog that can be read ({error}); check that the file is whole"
        ) from error
    damaged = {}
    if log.dropouts:
        damaged["drop-outs"] = len(log.dropouts)
    if log.file_corruption:
        damaged["corrupt sections"] = 1
    lost_ms = sum(dropout.duration for dropout in log.dropouts)
    notes = (f"the logger dropped {lost_ms} ms in total",) if log.dropouts else ()
    # A damaged definition can leave a topic without its time.
    topics = {
        (item.name, item.multi_id): item.data for item in log.data_list if "timestamp" in item.data
    }
    counts: dict[str, int] = {}
    for (name, _), data in topics.items():
        counts[name] = counts.get(name, 0) + len(data["timestamp"])
    vehicle, unit = _vehicle(log.initial_parameters), _unit(log.msg_info_dict)
    initial = list(log.initial_parameters.items())
    changed = [(name, value) for _, name, value in log.changed_parameters]
    return UlogTables(topics, counts, damaged, notes, vehicle, unit, (initial, changed))


def _unit(about: dict[str, Any]) -> str:
    """Return the number of the board, which PX4 sends as AUTOPILOT_VERSION.uid2; "" if damaged."""
    with contextlib.suppress(ValueError):
        return unit_name(0, bytes.fromhex(str(about.get("sys_uuid", ""))))
    return ""


def _vehicle(parameters: dict[str, Any]) -> int:
    """Return the parameter MAV_TYPE, 0 (generic) where a log has no valid one."""
    value = parameters.get("MAV_TYPE", 0)
    return int(value) if 0 <= value <= 255 else 0
