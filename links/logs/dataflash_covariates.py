"""Covariates in a DataFlash log: vibration, current, throttle, airspeed."""

from typing import Any, Final

import numpy as np

from ahrs_service.links.logs.dataflash_tables import DataFlashFile
from ahrs_service.links.logs.recording import Covariates, TimedValues, rising
from ahrs_service.records import Floats

_COLUMNS: Final = (
    ("vibration_m_s2", "VIBE", ("VibeX", "VibeY", "VibeZ"), 1.0),
    ("current_a", "BAT", ("Curr",), 1.0),
    ("current_a", "CURR", ("Curr",), 1.0),
    ("supply_v", "BAT", ("Volt",), 1.0),
    ("throttle", "CTUN", ("ThO",), 1.0),
    ("throttle", "CTUN", ("ThrOut",), 1e-3),
    ("airspeed_m_s", "ARSP", ("Airspeed",), 1.0),
)
"""Covariate, record, its fields and their unit; the first record present is used."""
_OLD_CURRENT_A: Final = 1e-2
"""Logs with stamps in milliseconds have currents in hundredths of an ampere."""
_CLOCKS: Final = {"TimeUS": 1e-6, "TimeMS": 1e-3}


def dataflash_covariates(log: DataFlashFile, clock_rate: float) -> Covariates:
    """Return the first instance of each covariate; a log second lasts `clock_rate` seconds."""
    found: dict[str, TimedValues] = {}
    for what, name, fields, unit in _COLUMNS:
        if what in found or not log.counts().get(name):
            continue
        table = log.table(name)
        names = table.dtype.names or ()
        clock = next((one for one in _CLOCKS if one in names), None)
        if clock is None or set(fields) - set(names):
            continue
        for instance in ("IMU", "I", "C", "Instance"):
            if instance in names:
                table = table[table[instance] == table[instance][0]]
                break
        values = np.stack([log.column(table, name, field) for field in fields], axis=1) * unit
        if name == "CURR" and clock == "TimeMS":
            values *= _OLD_CURRENT_A
        values = values if len(fields) > 1 else values[:, 0]
        found[what] = rising(_seconds(table[clock], clock_rate * _CLOCKS[clock]), values)
    columns: dict[str, Any] = dict(found)
    return Covariates(**columns)


def _seconds(stamps: Any, unit: float) -> Floats:
    seconds: Floats = stamps.astype(np.float64) * unit
    return seconds
