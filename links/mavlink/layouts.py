"""Numpy layouts of MAVLink messages, taken from pymavlink's generated classes."""

from functools import cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.links.mavlink.frames import MARKER_V1, Bytes, Rows

_NUMPY_TYPES: Final = {
    "c": "S1",
    "b": "i1",
    "B": "u1",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "q": "<i8",
    "Q": "<u8",
    "f": "<f4",
    "d": "<f8",
}


def message_name(msgid: int) -> str:
    """Return the message's name, `UNKNOWN_<id>` where the dialect has none (as pymavlink)."""
    message = dialect.mavlink_map.get(msgid)
    return f"UNKNOWN_{msgid}" if message is None else str(message.msgname)


def is_known(msgid: int) -> bool:
    """Return whether the dialect has a message of this id."""
    return msgid in dialect.mavlink_map


@cache
def table_dtype(msgid: int) -> np.dtype[Any]:
    """Return the row of a message's table: its fields in wire order, then where it came from.

    char arrays are bytes, other arrays subarrays; `received_us` [us] the tlog's stamp and
    `frame_index` the row of `TlogFile.frames`.
    """
    message = dialect.mavlink_map[msgid]
    types = message.native_format.decode().lstrip("<")
    fields: list[Any] = []
    for name, kind, length in zip(
        message.ordered_fieldnames, types, message.array_lengths, strict=True
    ):
        if kind == "c":
            fields.append((name, f"S{max(length, 1)}"))
        elif length:
            fields.append((name, _NUMPY_TYPES[kind], length))
        else:
            fields.append((name, _NUMPY_TYPES[kind]))
    return np.dtype([*fields, ("received_us", "<i8"), ("frame_index", "<i4")])


@njit(cache=True)
def _copy_payloads(
    data: Bytes, frames: Rows, indices: npt.NDArray[np.int32], size: int, out: Bytes
) -> None:
    """Copy each payload to a row of `out`: cut to `size`; what a sender left away stays 0."""
    for i in range(len(indices)):
        start = frames[indices[i]]["offset"]
        header = 6 if int(data[start]) == MARKER_V1 else 10
        length = min(int(data[start + 1]), size)
        start += header
        row = out[i]
        payload = data[start : start + length]
        for j in range(length):
            row[j] = payload[j]


def decode_table(data: Bytes, frames: Rows, indices: npt.NDArray[np.int32], msgid: int) -> Rows:
    """Return the messages of the frames at `indices`, all of one id, as a table."""
    table = np.zeros(len(indices), table_dtype(msgid))
    size = dialect.mavlink_map[msgid].unpacker.size
    _copy_payloads(data, frames, indices, size, table.view(np.uint8).reshape(len(indices), -1))
    table["received_us"] = frames["received_us"][indices]
    table["frame_index"] = indices
    return table
