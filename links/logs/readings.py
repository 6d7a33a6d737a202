"""From MAVLink messages to readings, by message and by column, following reading_rules."""

import struct
from collections.abc import Callable
from operator import attrgetter
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ahrs_service.links.logs.reading_rules import ACCEL, GYRO, RULES, Conversion, Part, Rule
from ahrs_service.links.logs.tlog import Key, TlogFile
from ahrs_service.records import READING_DTYPE, Floats, Kind, Rows, empty

_TIME_LIMIT_NS: Final = 2**63 - 1
_ALL_UPDATED: Final = 0xFFFF
_NAN: Final = float("nan")


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

    Byte for byte as `from_message` for the same frames; the two low bits of the stamp's
    microseconds are cleared, since ground stations put a link number there.
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
    """Fill one field with the function for single messages, for bit-identical results."""
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
