"""Settings, calibration and estimator state inside a .tlog, as TUNNEL messages of our component.

Every file of a recording begins, at its first frame, with the current settings, the calibration if
there is one, and, after a rotation, the state; a change of settings or of the calibration is marked
where it happened. A replay of any one file then starts and continues as the live service did, and
other readers of the file skip the messages.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.records import Rows


class MarkKind(IntEnum):
    """Payload types from MAVLink's range for private use (32768 and up)."""

    SETTINGS = 0xA501
    STATE = 0xA502
    CALIBRATION = 0xA503


@dataclass(frozen=True, slots=True)
class Mark:
    """One mark: its kind, its bytes, and the index of the first reading that it applies to."""

    kind: MarkKind
    data: bytes
    reading: int


_PART: Final = struct.Struct("<HH")
_KINDS: Final = frozenset(int(kind) for kind in MarkKind)
_PAYLOAD: Final = 128
_PART_BYTES: Final = _PAYLOAD - _PART.size


def mark_messages(kind: MarkKind, data: bytes) -> list[Any]:
    """Return the TUNNEL messages that carry `data`: part number, part count, up to 124 bytes."""
    parts = [data[i : i + _PART_BYTES] for i in range(0, len(data), _PART_BYTES)]
    messages = []
    for index, part in enumerate(parts):
        payload = _PART.pack(index, len(parts)) + part
        messages.append(
            dialect.MAVLink_tunnel_message(
                0, 0, int(kind), len(payload), list(payload.ljust(_PAYLOAD, b"\0"))
            )
        )
    return messages


def is_mark(message: Any) -> bool:
    """Return whether `read_marks` would read a received message as a mark.

    Marks are only ever written to files: one that arrives over a link is forged, or comes from a
    recording being played, and must not be recorded.
    """
    return (
        message.get_msgId() == dialect.MAVLINK_MSG_ID_TUNNEL and int(message.payload_type) in _KINDS
    )


def _own(table: Rows) -> npt.NDArray[np.bool_]:
    return np.isin(table["payload_type"], list(_KINDS))


def read_marks(
    tables: Mapping[tuple[int, int, str], Rows], frame_index: npt.NDArray[np.int32]
) -> Iterator[Mark]:
    """Yield the marks of a recording's message tables, in file order.

    `frame_index` [N] is the frame of each reading of the file.

    Only a file that begins with a mark is one of ours; only that component's marks are used: its
    recorder keeps `is_mark` messages of others out, while a ground station's recording holds
    messages from any sender. An incomplete one, as at the end of a truncated file, is skipped.
    """
    tunnels = {
        key: table for key, table in tables.items() if key[2] == "TUNNEL" and _own(table).any()
    }
    writers = [
        key[1] for key, table in tunnels.items() if table["frame_index"][_own(table)][0] == 0
    ]
    if not writers:
        return
    table = np.concatenate([table for key, table in tunnels.items() if key[1] == writers[0]])
    pending: dict[int, list[bytes]] = {}
    for row in table[np.argsort(table["frame_index"], kind="stable")]:
        kind = int(row["payload_type"])
        length = int(row["payload_length"])
        if kind not in _KINDS or not _PART.size <= length <= _PAYLOAD:
            continue
        payload = row["payload"][:length].tobytes()
        index, count = _PART.unpack_from(payload)
        if index == 0:
            pending[kind] = []
        parts = pending.get(kind, [])
        if index != len(parts):
            continue
        parts.append(payload[_PART.size :])
        if len(parts) == count:
            reading = int(np.searchsorted(frame_index, row["frame_index"]))
            yield Mark(MarkKind(kind), b"".join(parts), reading)
            pending.pop(kind)
