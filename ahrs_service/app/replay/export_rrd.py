"""A replayed recording as an .rrd file: the live view, made from columns."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from ahrs_service.adoption import of_vehicle
from ahrs_service.app.replay.replay_log import ReplayResult
from ahrs_service.fusion.gating import in_force
from ahrs_service.records import Floats, ImuSource, Integers, Kind, Rows

Series = dict[str, tuple[Integers, Floats]]

_HIGHRES: Final = (ImuSource.HIGHRES_IMU, ImuSource.HIGHRES_IMU_1, ImuSource.HIGHRES_IMU_2)
_SECOND_NS: Final = 1_000_000_000


def write_recording(path: Path, result: ReplayResult) -> None:
    """Write estimates, the log's own attitude, temperatures, rates and notes."""
    # Loading rerun takes longer than replaying most logs.
    from ahrs_service.viz.batch import write_rrd  # noqa: PLC0415

    summary = result.summary
    start_ns = int(result.estimates["time_ns"][0])
    messages = [(start_ns, "INFO", text) for text in summary.notes]
    messages += [(start_ns, "WARN", text) for text in summary.warnings]
    recorded = result.recording.references_of(result.vehicle)
    references = sorted(recorded, key=lambda one: not one.is_truth)
    by_source = list(_by_source(of_vehicle(result.recording.readings, result.vehicle)))
    lost = {name: float(count) for name, count in summary.damaged.items()}
    write_rrd(
        path,
        result.estimates,
        references,
        _temperatures(by_source),
        _rates(by_source),
        {name: (np.array([start_ns]), np.array([count])) for name, count in lost.items()},
        messages,
        gate=in_force(result.settings),
        readings=result.recording.readings[result.positions] if result.is_calibrated else None,
    )


def _by_source(readings: Rows) -> Iterator[tuple[ImuSource, Rows]]:
    """Yield the vehicle's IMU readings of each source."""
    imu = readings[readings["kind"] == Kind.IMU]
    for source in np.unique(imu["source"]):
        yield ImuSource(int(source)), imu[imu["source"] == source]


def _temperatures(by_source: list[tuple[ImuSource, Rows]]) -> Series:
    """Return temperatures [degC] by site; HIGHRES_IMU's is the barometer's or the air's."""
    series = {}
    for source, rows in by_source:
        known = rows[~np.isnan(rows["temperature_degc"])]
        if len(known):
            site = f"{source.name} (not the IMU)" if source in _HIGHRES else source.name
            series[site] = (known["time_ns"], known["temperature_degc"])
    return series


def _rates(by_source: list[tuple[ImuSource, Rows]]) -> Series:
    """Return messages per second [Hz] by name, one value a second."""
    series = {}
    for source, rows in by_source:
        seconds, counts = np.unique(rows["time_ns"] // _SECOND_NS, return_counts=True)
        series[source.name] = (seconds * _SECOND_NS, counts.astype(np.float64))
    return series
