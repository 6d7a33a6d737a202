"""From MAVLink messages to readings, by message and by column, following reading_rules."""

import math
import struct
from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.links.component.unit_request import unit_name
from ahrs_service.links.component.vehicle_trim import trim_notes
from ahrs_service.links.errors import RecordingError
from ahrs_service.links.logs.recording import Recording
from ahrs_service.links.logs.references import attitude_references
from ahrs_service.links.logs.session_marks import read_marks
from ahrs_service.links.logs.tlog import Key, TlogFile, read_tlog
from ahrs_service.links.mavlink.gps_velocity import course_is_doubtful, course_likeness
from ahrs_service.links.mavlink.reading_rules import ACCEL, GYRO, RULES, Conversion, Part, Rule
from ahrs_service.records import READING_DTYPE, Floats, ImuSource, Kind, Rows, empty

_TIME_LIMIT_NS: Final = 2**63 - 1
_ALL_UPDATED: Final = 0xFFFF
_NAN: Final = float("nan")
_AUTOPILOT: Final = 1


_FLOATS: Final = tuple(
    name for name in READING_DTYPE.names or () if READING_DTYPE[name].base == "f8"
)
_FIRST_SLOT: Final = {
    name: (READING_DTYPE.fields[name][1] - 16) // 8  # type: ignore[index]
    for name in _FLOATS
}
_SLOTS: Final = 16
_ROW: Final = struct.Struct(f"<qq{_SLOTS}d6B2x")
_NO_VALUES: Final = [_NAN] * _SLOTS

_Writer = Callable[[Any, int, Rows], int]


def _converter(conversion: Conversion) -> Callable[[Any], list[float] | None]:
    """Return the function from a message to the reading's floats, None where it has none."""
    read, first = attrgetter(*conversion.fields), _FIRST_SLOT[conversion.into]

    def values_of(message: Any) -> list[float] | None:
        found = conversion.values(*read(message))
        if found is None:
            return None
        values = _NO_VALUES.copy()
        values[first : first + len(found)] = found
        return values

    return values_of


def _values_reader(rule: Rule) -> Callable[[Any], list[float] | None]:
    """Return the function from a message to the reading's floats, None where it has no IMU."""
    names = [name for part in rule.parts for name in part.fields]
    read = attrgetter(*names, *names[:1])
    slots: list[tuple[int, float]] = []
    checked: list[tuple[int, int, int, bool]] = []
    for part in rule.parts:
        first = _FIRST_SLOT[part.into]
        slots.extend((first + i, part.scale) for i in range(len(part.fields)))
        if part.bits or part.zero_is_none:
            checked.append((first, first + len(part.fields), part.bits, part.zero_is_none))
    is_imu, has_updated = rule.kind == Kind.IMU, rule.has_updated

    def values_of(message: Any) -> list[float] | None:
        raw = read(message)
        if is_imu and not any(raw[:6]):
            return None
        values = _NO_VALUES.copy()
        for (slot, scale), value in zip(slots, raw, strict=False):
            values[slot] = value * scale
        updated = (message.fields_updated or _ALL_UPDATED) if has_updated else _ALL_UPDATED
        if is_imu and has_updated and updated & 0x07 != 0x07 and updated & 0x38 != 0x38:
            return None
        for start, stop, bits, zero_is_none in checked:
            if updated & bits != bits or (zero_is_none and not any(values[start:stop])):
                values[start:stop] = _NO_VALUES[start:stop]
        return values

    return values_of


def _writer(rule: Rule) -> _Writer:
    """Return the function that writes one message of this kind as a row."""
    values_of = _values_reader(rule) if rule.parts else None
    if rule.conversion is not None:
        values_of = _converter(rule.conversion)
    time_of = attrgetter(rule.time[0]) if rule.time else None
    time_unit = rule.time[1] if rule.time else 0
    kind, sources, has_id = int(rule.kind), tuple(map(int, rule.sources)), rule.has_id

    def write(message: Any, received_ns: int, rows: Rows) -> int:
        number = message.id if has_id else 0
        values = _NO_VALUES if values_of is None else values_of(message)
        if values is None or number >= len(sources):
            return 0
        time_ns = 0 if time_of is None else time_of(message) * time_unit
        header = message.get_header()
        _ROW.pack_into(
            rows.view(np.uint8).data,
            0,
            received_ns,
            time_ns if time_ns <= _TIME_LIMIT_NS else 0,
            *values,
            kind,
            sources[number],
            header.srcSystem,
            header.srcComponent,
            message.autopilot if rule.is_heartbeat else 0,
            message.type if rule.is_heartbeat else 0,
        )
        return 1

    return write


_WRITERS: Final = {name: _writer(rule) for name, rule in RULES.items()}


def from_message(message: Any, received_ns: int, rows: Rows) -> int:
    """Write the reading of a pymavlink message to rows[0]; return the rows used, 0 or 1.

    `received_ns` [ns] is the time of receipt on the host's clock, `rows` READING_DTYPE.
    """
    write = _WRITERS.get(message.get_type())
    return 0 if write is None else write(message, received_ns, rows)


def from_tables(tlog: TlogFile) -> tuple[Rows, npt.NDArray[np.int32]]:
    """Return the readings of a tlog in file order and the index of each one's frame.

    Byte for byte what `from_message` gives for the same frames; the two low bits of the stamp's
    microseconds are cleared, for ground stations put a link number there.
    """
    parts = [_from_table(key, tlog.tables[key]) for key in tlog.tables if key[2] in RULES]
    readings = np.concatenate([empty(READING_DTYPE, 0), *(rows for rows, _ in parts)])
    indices = np.concatenate([np.zeros(0, np.int32), *(frames for _, frames in parts)])
    order = np.argsort(indices, kind="stable")
    return readings[order], indices[order]


def _from_table(key: Key, table: Rows) -> tuple[Rows, npt.NDArray[np.int32]]:
    rule = RULES[key[2]]
    rows = empty(READING_DTYPE, len(table))
    rows["received_ns"] = (table["received_us"] & ~3) * 1000
    rows["system"], rows["component"] = key[0], key[1]
    rows["kind"] = rule.kind
    if rule.is_heartbeat:
        rows["autopilot"] = table["autopilot"]
        rows["vehicle"] = table["type"]
    if rule.time:
        time, unit = table[rule.time[0]].astype(np.uint64), rule.time[1]
        rows["time_ns"] = np.where(time <= _TIME_LIMIT_NS // unit, time, 0).astype(np.int64) * unit
    number = table["id"] if rule.has_id else np.zeros(len(table), np.uint8)
    keep = number < len(rule.sources)
    rows["source"] = np.array(rule.sources, np.uint8)[np.where(keep, number, 0)]
    for part in rule.parts:
        _fill_part(part, rule, table, rows)
    if rule.conversion is not None:
        keep &= _convert(rule.conversion, table, rows)
    if rule.kind == Kind.IMU:
        keep &= np.any([table[name] != 0 for name in (*GYRO, *ACCEL)], axis=0)
    if rule.has_updated:
        updated = _updated(table)
        keep &= (updated & 0x07 == 0x07) | (updated & 0x38 == 0x38)
    return rows[keep], table["frame_index"][keep]


def _convert(conversion: Conversion, table: Rows, rows: Rows) -> npt.NDArray[np.bool_]:
    """Fill one field by the function that takes messages, so that not even a last bit differs."""
    keep = np.zeros(len(table), np.bool_)
    columns = (table[name].tolist() for name in conversion.fields)
    for n, fields in enumerate(zip(*columns, strict=True)):
        found = conversion.values(*fields)
        if found is not None:
            rows[conversion.into][n, : len(found)] = found
            keep[n] = True
    return keep


def _updated(table: Rows) -> npt.NDArray[np.uint16]:
    updated = table["fields_updated"]
    return np.where(updated == 0, np.uint16(_ALL_UPDATED), updated)


def _fill_part(part: Part, rule: Rule, table: Rows, rows: Rows) -> None:
    values: Floats = np.stack([table[name] for name in part.fields], axis=1).astype(np.float64)
    values *= part.scale
    absent = np.zeros(len(table), np.bool_)
    if rule.has_updated and part.bits:
        absent |= _updated(table) & part.bits != part.bits
    if part.zero_is_none:
        absent |= ~np.any(values != 0.0, axis=1)
    values[absent] = np.nan
    rows[part.into] = values.reshape(rows[part.into].shape)


def recording_from_tlog(
    path: str | Path, progress: Callable[[float], None] | None = None
) -> Recording:
    """Read a tlog as the pipeline takes it, with the attitudes it contains as references.

    RecordingError where it holds no IMU message, saying what it has instead.
    """
    tlog = read_tlog(path, progress)
    return recording_of(tlog, *from_tables(tlog))


def recording_of(tlog: TlogFile, readings: Rows, frame_index: npt.NDArray[np.int32]) -> Recording:
    """Return a tlog that was read, with what `from_tables` gives of it, as a recording."""
    counts = tlog.message_counts()
    if not np.any(readings["kind"] == Kind.IMU):
        found = ", ".join(f"{name} {count}" for name, count in list(counts.items())[:12])
        raise RecordingError(
            f"{tlog.path}: holds no IMU message (HIGHRES_IMU, SCALED_IMU, RAW_IMU) with values; "
            f"it has {found or 'none known'}; record again with one of them switched on"
        )
    references = attitude_references(tlog, readings, frame_index)
    readings, doubts = _without_doubtful_courses(tlog, readings)
    return Recording(
        path=tlog.path,
        format="tlog",
        readings=readings,
        references=references,
        message_counts=counts,
        damaged={name: count for name, count in tlog.damaged.items() if count},
        notes=(*_notes(readings), *trim_notes(readings), *doubts),
        unit=_unit(tlog),
    )


def _unit(tlog: TlogFile) -> str:
    """Return the number of the board that the first autopilot reported, "" if none did."""
    for key in tlog.tables:
        if key[1:] == (_AUTOPILOT, "AUTOPILOT_VERSION"):
            row = tlog.tables[key][-1]
            return unit_name(int(row["uid"]), row["uid2"].tobytes())
    return ""


def _without_doubtful_courses(tlog: TlogFile, readings: Rows) -> tuple[Rows, tuple[str, ...]]:
    """Leave out the GPS velocity of vehicles whose course does not follow their positions.

    A recording of this service keeps it: it must replay as the session was.
    """
    notes = []
    for key in tlog.tables:
        likeness = course_likeness(tlog.tables[key]) if key[2] == "GPS_RAW_INT" else math.nan
        if not course_is_doubtful(likeness):
            continue
        own = next(read_marks(tlog.tables), None) is not None
        if not own:
            readings = readings.copy()
            theirs = (readings["system"] == key[0]) & (readings["component"] == key[1])
            readings["velocity_ned_m_s"][theirs & (readings["kind"] == Kind.GPS)] = np.nan
        notes.append(
            f"GPS_RAW_INT of {key[0]}/{key[1]}: its course does not follow its positions (mean "
            f"cosine {likeness:.2f}; cog in other units than centi-degrees?); the GPS velocity is "
            + ("used as it was when this was recorded" if own else "not used")
        )
    return readings, tuple(notes)


def _notes(readings: Rows) -> tuple[str, ...]:
    """Say where RAW_IMU cannot be in mG: its median specific force is far from 1 g."""
    raw = readings["accel_m_s2"][readings["source"] == ImuSource.RAW_IMU]
    if not len(raw):
        return ()
    force = float(np.median(np.linalg.norm(raw, axis=1)))
    if 0.5 < force / STANDARD_GRAVITY_M_S2 < 2.0:
        return ()
    return (
        f"RAW_IMU has a median specific force of {force:.1f} m/s^2 when read in mG: it is likely "
        "in raw counts of the sensor; choose another imu_source",
    )
