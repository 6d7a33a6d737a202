"""DataFlash records of the first instance of a sensor, and the rate of the log's clock."""

from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.links.logs.dataflash_tables import DataFlashFile
from ahrs_service.links.logs.satellite_clock import clock_rate
from ahrs_service.links.mavlink.gps_velocity import LEAST_FIX

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_INSTANCES: Final = ("I", "C")
_TIMES: Final = {"TimeUS": 1000, "TimeMS": 1_000_000, "T": 1_000_000}
_CLOCKS: Final = ("TimeUS", "TimeMS")
_SATELLITE_CLOCKS: Final = (("TimeUS", "GMS"), ("T", "TimeMS"))
"""Stamps of a fix on the autopilot's clock and in GPS time of the week [ms]."""


class InstanceTable:
    """The records of one name and instance, with their offsets and times."""

    def __init__(self, log: DataFlashFile, name: str, time_field: str) -> None:
        offsets = log.offsets_of(name)
        rows = log.table(name)
        for field in _INSTANCES:
            if field in (rows.dtype.names or ()):
                first = rows[field] == 0
                offsets, rows = offsets[first], rows[first]
                break
        self._log, self._name, self._rows = log, name, rows
        self.offsets = offsets
        self.fields = rows.dtype.names or ()
        self.time_ns: Integers = rows[time_field].astype(np.int64) * _TIMES[time_field]

    def column(self, field: str) -> Floats:
        """Return a field [N] in the units of its format."""
        return self._log.column(self._rows, self._name, field)

    def columns(self, fields: tuple[str, ...]) -> Floats:
        """Return fields [N, M] side by side."""
        return np.stack([self.column(field) for field in fields], axis=-1)


def table_of(
    log: DataFlashFile, name: str, fields: tuple[str, ...], clocks: tuple[str, ...] = _CLOCKS
) -> InstanceTable | None:
    """Return the table of `name` if it has records, a time and all of `fields`."""
    if not len(log.offsets_of(name)):
        return None
    present = log.layouts[name].dtype.names or ()
    time_field = next((field for field in clocks if field in present), None)
    if time_field is None or set(fields) - set(present):
        return None
    table = InstanceTable(log, name, time_field)
    return table if len(table.offsets) else None


def at_rate(time_ns: Integers, rate: float) -> Integers:
    """Times [N] of a clock whose second lasts `rate` true seconds."""
    return time_ns if rate == 1.0 else np.rint(time_ns * rate).astype(np.int64)


def clock_rate_of(log: DataFlashFile) -> float:
    """GPS seconds per second of the autopilot's clock, from the fixes of the first receiver."""
    for own, satellites in _SATELLITE_CLOCKS:
        table = table_of(log, "GPS", ("Status", satellites), (own,))
        if table is not None:
            fixed = table.column("Status") >= LEAST_FIX
            of_week_ms = table.column(satellites)[fixed].astype(np.int64)
            return clock_rate(table.time_ns[fixed], of_week_ms)
    return 1.0
