"""Estimates as Parquet or CSV columns."""

from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from ahrs_service.app.files.config_file import to_json
from ahrs_service.app.replay.summary import Summary
from ahrs_service.flat_columns import as_columns
from ahrs_service.records import ESTIMATE_DTYPE, Rows
from ahrs_service.settings import Settings

_ROWS: Final = 1 << 16


def write_parquet(path: Path, estimates: Rows, settings: Settings, summary: Summary) -> None:
    """Write one row per estimate; settings, digest, log and version go into the file's metadata.

    The digest is that of the causal estimates, even where the rows are smoothed.
    """
    metadata = {
        "ahrs_service.version": version("ahrs-service"),
        "ahrs_service.settings": to_json(settings).decode(),
        "ahrs_service.estimates_sha256": summary.digest,
        "ahrs_service.smoothed": "yes" if summary.smoothed else "no",
        "ahrs_service.log": summary.log,
    }
    with pyarrow.parquet.ParquetWriter(path, _schema().with_metadata(metadata)) as writer:
        for start in range(0, len(estimates), _ROWS):
            writer.write_table(_table(estimates[start : start + _ROWS]).cast(writer.schema))


def write_csv(path: Path, estimates: Rows) -> None:
    """Write one row per estimate, NaN where there is no value."""
    with pyarrow.csv.CSVWriter(path, _schema()) as writer:
        for start in range(0, len(estimates), _ROWS):
            writer.write_table(_table(estimates[start : start + _ROWS]))


def _schema() -> Any:
    return _table(np.zeros(0, ESTIMATE_DTYPE)).schema


def _table(estimates: Rows) -> Any:
    return pa.table(as_columns(estimates))
