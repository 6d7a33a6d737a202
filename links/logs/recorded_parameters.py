"""The autopilot's parameters that a recording carries: PARAM_VALUE, PARM, or a ULog's own."""

import contextlib
import io
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from pyulog import ULog

from ahrs_service.links.errors import RecordingError
from ahrs_service.links.logs.dataflash_tables import read_tables
from ahrs_service.links.logs.parameter_values import ARDUPILOT, PX4, decode, param_name
from ahrs_service.links.logs.recording_formats import KNOWN
from ahrs_service.links.logs.tlog import TlogFile, read_tlog
from ahrs_service.links.mavlink.codec import dialect

_INVALID: Final = int(dialect.MAV_AUTOPILOT_INVALID)
Told = Iterable[tuple[str, float]]


@dataclass(frozen=True, slots=True)
class RecordedParameters:
    """Values by name, the last told each, and which of them were told differently before.

    `autopilot` is MAV_AUTOPILOT, 0 where the recording does not say; `notes` are for the user.
    """

    values: dict[str, float]
    autopilot: int = 0
    changed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read_recorded_parameters(path: str | Path) -> RecordedParameters:
    """Return the parameters in a .tlog, .bin or .ulg; none of them is no error."""
    path = Path(path)
    readers = {".tlog": _of_tlog, ".bin": _of_dataflash, ".ulg": _of_ulog}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise RecordingError(f"{path}: no log format that is read; known are {KNOWN}")
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; check the path")
    return reader(path)


@dataclass(slots=True)
class _History:
    values: dict[str, float] = field(default_factory=dict)
    changed: dict[str, None] = field(default_factory=dict)

    def take(self, told: Told) -> None:
        for name, value in told:
            # An autopilot tells some values more than once, the same.
            if self.values.get(name, value) != value:
                self.changed[name] = None
            self.values[name] = value

    def result(self, autopilot: int, notes: tuple[str, ...] = ()) -> RecordedParameters:
        return RecordedParameters(self.values, autopilot, tuple(self.changed), notes)


def _of_tlog(path: Path) -> RecordedParameters:
    """Take what the first autopilot told; else what another, as a ground station, told of it."""
    log = read_tlog(path)
    vehicle, autopilot = _vehicle(log)
    counts = {key[:2]: log.tables.count(key) for key in log.tables if key[2] == "PARAM_VALUE"}
    if not counts:
        return RecordedParameters({}, autopilot)
    told_by = max(counts, key=lambda sender: counts[sender])
    history = _History()
    notes: tuple[str, ...] = ()
    if told_by != vehicle:
        # A ground station's copy may be from before the session, so the vehicle's own word is last.
        history.take(_told(log, told_by, autopilot))
        notes = (f"parameters as {told_by[0]}/{told_by[1]} tells them, not the vehicle itself",)
        history.changed.clear()
    if vehicle in counts:
        history.take(_told(log, vehicle, autopilot))
    return history.result(autopilot, notes)


def _vehicle(log: TlogFile) -> tuple[tuple[int, int], int]:
    """Return sender and kind of the first autopilot that beats."""
    for key in log.tables:
        if key[2] == "HEARTBEAT":
            kinds = log.tables[key]["autopilot"]
            known = kinds[kinds != _INVALID]
            if len(known):
                return (key[0], key[1]), int(known[0])
    return (0, 0), 0


def _told(log: TlogFile, sender: tuple[int, int], autopilot: int) -> Told:
    table = log.tables[(*sender, "PARAM_VALUE")]
    columns = (table[name].tolist() for name in ("param_id", "param_value", "param_type"))
    for name, value, kind in zip(*columns, strict=True):
        yield param_name(name), decode(value, kind, autopilot).value


def _of_dataflash(path: Path) -> RecordedParameters:
    log = read_tables(path)
    layout = log.layouts.get("PARM")
    history = _History()
    if layout is not None and {"Name", "Value"} <= set(layout.dtype.names or ()):
        table = log.table("PARM")
        names = map(param_name, table["Name"].tolist())
        history.take(zip(names, table["Value"].tolist(), strict=True))
    return history.result(ARDUPILOT)


def _of_ulog(path: Path) -> RecordedParameters:
    history = _History()
    try:
        # pyulog prints its findings, and lets many kinds of error out of a damaged file.
        with contextlib.redirect_stdout(io.StringIO()):
            log = ULog(str(path), message_name_filter_list=[])
    except Exception as error:
        raise RecordingError(
            f"{path}: not a ULog that can be read ({error}); check that the file is whole"
        ) from error
    history.take((name, float(value)) for name, value in log.initial_parameters.items())
    history.take((name, float(value)) for _, name, value in log.changed_parameters)
    return history.result(PX4)
