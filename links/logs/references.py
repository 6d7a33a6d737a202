"""The attitudes contained in a tlog, on the clock of its IMU samples."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from ahrs_service.adoption import AUTOPILOT_INVALID, Vehicle
from ahrs_service.links.logs.recording import AttitudeReference
from ahrs_service.links.logs.tlog import TlogFile
from ahrs_service.records import Floats, ImuSource, Integers, Kind, Rows
from ahrs_service.rotation import quaternion_columns

_UNIX_FROM_NS: Final = 10**18
"""Later times (2001 on) are Unix time; no autopilot has been on for 31 years."""


@dataclass(frozen=True, slots=True)
class _ImuTimes:
    """Clock of a vehicle's IMU messages, and how far it leads the time of receipt [ns]."""

    is_unix: bool
    lead_ns: int
    time_ns: Integers
    frame_index: npt.NDArray[np.int32]


def _from_quaternion(table: Rows) -> Floats:
    return np.stack([table[f"q{i}"] for i in (1, 2, 3, 4)], axis=1).astype(np.float64)


def _from_euler(table: Rows) -> Floats:
    euler = np.stack([table[name] for name in ("roll", "pitch", "yaw")], axis=1)
    return quaternion_columns(euler.astype(np.float64))


_MESSAGES: Final[tuple[tuple[str, Callable[[Rows], Floats], bool], ...]] = (
    ("SIM_STATE", _from_quaternion, True),
    ("SIMSTATE", _from_euler, True),
    ("ATTITUDE_QUATERNION", _from_quaternion, False),
    ("ATTITUDE", _from_euler, False),
)


_RATES: Final = ("rollspeed", "pitchspeed", "yawspeed")
_VELOCITIES: Final = ("vn", "ve", "vd")


def _median(times_ns: Integers) -> int:
    """Return the median of times near one another: double would round Unix time to 256 ns."""
    return int(times_ns[0]) + int(np.median(times_ns - times_ns[0]))


def attitude_references(
    tlog: TlogFile, readings: Rows, frame_index: npt.NDArray[np.int32]
) -> tuple[AttitudeReference, ...]:
    """Return the references of every autopilot in the log, the first heard first.

    `readings` [N] and their `frame_index` [N] as `readings.from_tables` gives them. SIM_STATE and
    SIMSTATE (truth) carry no time: theirs is that of the RAW_IMU (else of any IMU message) right
    before them in the file. Times since boot become Unix time where the IMU has that: by
    SYSTEM_TIME, else by the times of receipt. Order is that of the file.
    """
    vehicles = _vehicles(readings)
    return tuple(
        reference
        for vehicle in vehicles
        for reference in _of_vehicle(
            tlog, vehicle, _imu_times(readings, frame_index, vehicle), len(vehicles) > 1
        )
    )


def _vehicles(readings: Rows) -> list[Vehicle]:
    """Return (system, component) of the autopilots by heartbeat, else of the IMU's senders."""
    heartbeats = readings["kind"] == Kind.HEARTBEAT
    autopilots = heartbeats & (readings["autopilot"] != AUTOPILOT_INVALID)
    rows = readings[autopilots if autopilots.any() else readings["kind"] == Kind.IMU]
    names = rows["system"].astype(np.int64) << 8 | rows["component"]
    found, first = np.unique(names, return_index=True)
    return [(int(name) >> 8, int(name) & 0xFF) for name in found[np.argsort(first)]]


def _imu_times(
    readings: Rows, frame_index: npt.NDArray[np.int32], vehicle: Vehicle
) -> _ImuTimes | None:
    mine = (readings["kind"] == Kind.IMU) & (readings["system"] == vehicle[0])
    mine &= readings["component"] == vehicle[1]
    if not mine.any():
        return None
    rows = readings[mine]
    main = rows[rows["source"] == np.bincount(rows["source"]).argmax()]
    is_raw = rows["source"] == ImuSource.RAW_IMU
    stamps = is_raw if is_raw.any() else np.ones(len(rows), np.bool_)
    return _ImuTimes(
        is_unix=bool(np.median(main["time_ns"]) >= _UNIX_FROM_NS),
        lead_ns=_median(main["time_ns"] - main["received_ns"]),
        time_ns=rows["time_ns"][stamps],
        frame_index=frame_index[mine][stamps],
    )


def _of_vehicle(
    tlog: TlogFile, vehicle: Vehicle, imu: _ImuTimes | None, is_named: bool
) -> Iterator[AttitudeReference]:
    for name, quaternion_of, is_truth in _MESSAGES:
        table = tlog.tables.get((*vehicle, name))
        if table is None or imu is None:
            continue
        if "time_boot_ms" in (table.dtype.names or ()):
            time_ns = table["time_boot_ms"].astype(np.int64) * 1_000_000
            placed = np.ones(len(table), np.bool_)
        else:
            before = np.searchsorted(imu.frame_index, table["frame_index"]) - 1
            placed = before >= 0
            time_ns = imu.time_ns[np.maximum(before, 0)]
        q = quaternion_of(table)
        norm = np.linalg.norm(q, axis=1)
        good = placed & np.isfinite(norm) & (norm > 0.5)
        if not good.any():
            continue
        time_ns = time_ns[good]
        if imu.is_unix:
            time_ns = _as_unix(tlog, vehicle, imu, table[good], time_ns)
        label = f"{name} of {vehicle[0]}/{vehicle[1]}" if is_named else name
        yield AttitudeReference(
            label,
            time_ns,
            q[good] / norm[good, None],
            is_truth,
            vehicle,
            _columns(table[good], _RATES),
            _columns(table[good], _VELOCITIES) if is_truth else None,
        )


def _columns(table: Rows, names: tuple[str, ...]) -> Floats | None:
    """Return the fields side by side [N, 3], None where the message has none of them."""
    if set(names) - set(table.dtype.names or ()):
        return None
    return np.stack([table[name] for name in names], axis=1).astype(np.float64)


def _as_unix(
    tlog: TlogFile, vehicle: Vehicle, imu: _ImuTimes, table: Rows, time_ns: Integers
) -> Integers:
    since_boot = time_ns < _UNIX_FROM_NS
    clock = tlog.tables.get((*vehicle, "SYSTEM_TIME"))
    if clock is not None:
        clock = clock[clock["time_unix_usec"] >= _UNIX_FROM_NS // 1000]
    if clock is not None and len(clock):
        unix_ns = clock["time_unix_usec"].astype(np.int64) * 1000
        offsets = unix_ns - clock["time_boot_ms"].astype(np.int64) * 1_000_000
        last = np.searchsorted(clock["frame_index"], table["frame_index"]) - 1
        return np.where(since_boot, time_ns + offsets[np.maximum(last, 0)], time_ns)
    offset = imu.lead_ns + _median(table["received_us"] * 1000 - time_ns)
    return np.where(since_boot, time_ns + offset, time_ns)
