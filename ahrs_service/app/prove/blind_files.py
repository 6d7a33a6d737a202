"""Blind recordings as files: NAME.tlog, NAME.truth.json, and the hash that seals the truths."""

import hashlib
import json
from pathlib import Path
from typing import Any, Final

from ahrs_service.app.files import toml_file
from ahrs_service.blind.making.case import Case
from ahrs_service.blind.making.messages import tables
from ahrs_service.errors import RecordingError
from ahrs_service.links.mavlink.frame_columns import MessageColumns, tlog_bytes

TRUTH_SUFFIX: Final = ".truth.json"
REPORT_SUFFIX: Final = ".report.json"

_EPOCH_US: Final = 1_750_000_000_000_000
"""Wall clock at boot of every blind recording [us since 1970]: one seed gives the same bytes."""


def case_bytes(case: Case) -> bytes:
    """Return the bytes of the case's .tlog."""
    columns = [
        MessageColumns(table.name, table.time_us + (_EPOCH_US + order), table.fields)
        for order, table in enumerate(tables(case))
    ]
    return tlog_bytes(columns, system=1, component=1)


def write_case(recordings: Path, truths: Path, case: Case) -> None:
    """Write the case's .tlog to one folder and its truth to another."""
    name = case.request.name
    (recordings / f"{name}.tlog").write_bytes(case_bytes(case))
    text = json.dumps(case.truth, indent=1)
    (truths / f"{name}{TRUTH_SUFFIX}").write_text(text, encoding="utf-8")


def seal(truths: Path) -> str:
    """Return the SHA-256 over names and bytes of a folder's truth files, sorted by name."""
    digest = hashlib.sha256()
    for path in sorted(truths.glob(f"*{TRUTH_SUFFIX}")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def truths_of(folder: Path) -> Path:
    """Return the folder with the truths of a set: its `truths` if there is one, else itself."""
    inner = folder / "truths"
    return inner if inner.is_dir() else folder


def recordings(folder: Path) -> list[Path]:
    """Return the recordings of a folder that have a truth, sorted by name."""
    truths = truths_of(folder)
    found = sorted(
        path for path in folder.glob("*.tlog") if (truths / f"{path.stem}{TRUTH_SUFFIX}").is_file()
    )
    if not found:
        raise RecordingError(f"{folder}: no NAME.tlog with NAME{TRUTH_SUFFIX} next to it")
    return found


def write_report(folder: Path, name: str, report: dict[str, Any]) -> None:
    """Write a report as NAME.report.json."""
    path = folder / f"{name}{REPORT_SUFFIX}"
    path.write_text(json.dumps(report, indent=1), encoding="utf-8")


def read_report(folder: Path, name: str) -> dict[str, Any] | None:
    """Read NAME.report.json of ahrs-mismatch/1; None where there is none."""
    path = folder / f"{name}{REPORT_SUFFIX}"
    if not path.is_file():
        return None
    return toml_file.read_json_table(
        path, ("verdict", "effects", "unexplained"), "a report of ahrs-mismatch/1"
    )
