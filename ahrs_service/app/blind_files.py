"""Blind recordings as files: NAME.tlog and NAME.truth.json."""

import json
from pathlib import Path
from typing import Any, Final

from ahrs_service.diagnosis.blind.case import Case
from ahrs_service.diagnosis.blind.messages import tables
from links.frame_columns import MessageColumns, tlog_bytes

_EPOCH_US: Final = 1_750_000_000_000_000
"""Wall clock of every blind recording's boot [us since 1970]: a seed gives the same bytes."""


def case_bytes(case: Case) -> bytes:
    """Return the bytes of the case's .tlog."""
    columns = [
        MessageColumns(table.name, table.time_us + (_EPOCH_US + order), table.fields)
        for order, table in enumerate(tables(case))
    ]
    return tlog_bytes(columns, system=1, component=1)


def truth_bytes(truth: dict[str, Any]) -> bytes:
    """Return the truth as it is hashed and written."""
    return json.dumps(truth, indent=1, sort_keys=True).encode()


def write_recording(folder: Path, case: Case) -> Path:
    """Write the case's .tlog, without its truth; return its path."""
    path = folder / f"{case.request.name}.tlog"
    path.write_bytes(case_bytes(case))
    return path


def write_truth(folder: Path, name: str, truth: dict[str, Any]) -> Path:
    """Write NAME.truth.json; return its path."""
    path = folder / f"{name}.truth.json"
    path.write_bytes(truth_bytes(truth))
    return path
