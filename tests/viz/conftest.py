"""Estimates of a short synthetic flight, and a reader of the files written from them."""

import os

os.environ["RERUN_STRICT"] = "1"

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from ahrs_service.records import ESTIMATE_DTYPE, Flag, Gate, Phase, Rows, empty
from ahrs_service.rotation import quaternion_columns


@dataclass(frozen=True, slots=True)
class Table:
    """Every row of one entity, in the order it was sent: t [ns] and the cells by component."""

    t: np.ndarray
    cells: dict[str, list[object]]

    def numbers(self, component: str) -> np.ndarray:
        return np.array(self.cells[component])


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    import rerun as rr

    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture
def flight() -> Rows:
    """Six seconds at 200 Hz: one of alignment, then a turn that closes the gate, and a gap."""
    count, random = 1200, np.random.default_rng(5)
    rows = empty(ESTIMATE_DTYPE, count)
    for name in ESTIMATE_DTYPE.names:
        if ESTIMATE_DTYPE[name].base.kind == "f":
            rows[name] = random.normal(0.0, 1.0, rows[name].shape)
    time_ns = 7_000_000_000 + np.arange(count) * 5_000_000
    time_ns[900:] += 800_000_000
    rows["time_ns"], rows["received_ns"] = time_ns, time_ns + 1_700_000_000_000_000_000
    rows["ned_from_body"] = quaternion_columns(random.uniform(-1.2, 1.2, (count, 3)))
    rows["phase"] = np.where(np.arange(count) < 200, Phase.ALIGNING, Phase.RUNNING)
    rows["gate"][400:480] = Gate.NORM
    rows["gate"][450:470] |= np.uint32(Gate.RATE)
    rows["gate"][470:480] |= np.uint32(Gate.SATURATION)
    rows["flags"][900] = Flag.GAP | Flag.SPIKE
    return rows


@pytest.fixture
def read() -> Callable[[Path], dict[str, Table]]:
    """Read the rows of an .rrd file by entity; what is static is left out."""

    def tables(path: Path) -> dict[str, Table]:
        from rerun.chunk import RrdReader

        stamps: dict[str, list[np.ndarray]] = {}
        cells: dict[str, dict[str, list[object]]] = {}
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            if chunk.is_static or "t" not in batch.schema.names:
                continue
            entity = str(chunk.entity_path)
            stamps.setdefault(entity, []).append(np.asarray(batch["t"]).astype(np.int64))
            for name in batch.schema.names:
                if ":" in name:
                    columns = cells.setdefault(entity, {})
                    columns.setdefault(name, []).extend(batch[name].to_pylist())
        return {name: Table(np.concatenate(stamps[name]), cells[name]) for name in stamps}

    return tables


@pytest.fixture
def static() -> Callable[[Path], dict[str, set[str]]]:
    """Read which components are static, by entity."""

    def components(path: Path) -> dict[str, set[str]]:
        from rerun.chunk import RrdReader

        found: dict[str, set[str]] = {}
        for chunk in RrdReader(path).stream():
            if chunk.is_static:
                names = chunk.to_record_batch().schema.names
                found.setdefault(str(chunk.entity_path), set()).update(names)
        return found

    return components
