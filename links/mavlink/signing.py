"""MAVLink 2 message signing: sign what goes out, judge what comes in, never reuse a stamp.

A signature is 13 bytes after the checksum: link id, 48-bit stamp [10 us since 2015-01-01 UTC], the
first 48 bits of SHA-256(key, frame up to and with the stamp).
Source: mavlink.io, Message Signing (authentication).
"""

import hashlib
import hmac
import json
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ahrs_service.errors import SigningError
from ahrs_service.links.mavlink.frames import (
    MARKER_V1,
    MARKER_V2,
    SIGNATURE_BYTES,
    SIGNED,
    flip_in_checksum,
    strip_signature,
)

HEADER_BYTES: Final = 10
RADIO_STATUS: Final = 109
SETUP_SIGNING: Final = 256

EPOCH_S: Final = 1_420_070_400
TICKS_PER_S: Final = 100_000
NEW_STREAM_AGE: Final = 60 * TICKS_PER_S
"""How far [ticks] behind our time the first frame of a stream may be."""
AHEAD_LIMIT: Final = 20 * 365 * 86400 * TICKS_PER_S
SAVE_PERIOD: Final = 30 * TICKS_PER_S
SAVE_FRAMES: Final = TICKS_PER_S
"""The state is written once in so much time, or in so many frames stamped ahead of the clock."""


def _with_flag(frame: bytes) -> bytes:
    """Return an unsigned frame with its signed flag set and the checksum following."""
    end = HEADER_BYTES + frame[1]
    checksum = int.from_bytes(frame[end : end + 2], "little") ^ flip_in_checksum(SIGNED, end - 2)
    head = bytes((MARKER_V2, frame[1], frame[2] | SIGNED))
    return head + frame[3:end] + checksum.to_bytes(2, "little")


def is_signed(frame: bytes) -> bool:
    """Return whether this is a whole MAVLink 2 frame that carries a signature."""
    return (
        len(frame) > HEADER_BYTES
        and frame[0] == MARKER_V2
        and bool(frame[2] & SIGNED)
        and len(frame) == HEADER_BYTES + frame[1] + 2 + SIGNATURE_BYTES
    )


def message_id(frame: bytes) -> int:
    """Return the message id of a frame of either version."""
    if frame[0] == MARKER_V1:
        return frame[5]
    return int.from_bytes(frame[7:10], "little")


def key_from_text(text: str) -> bytes:
    """Return the 32-byte key of 64 hex digits, or else of a passphrase: its SHA-256.

    Ground stations make keys of passphrases the same way.
    """
    text = text.strip()
    if not text:
        raise SigningError("the signing key is empty; give a passphrase or 64 hex digits")
    if len(text) == 64:
        try:
            return bytes.fromhex(text)
        except ValueError:
            pass
    return hashlib.sha256(text.encode()).digest()


def clock_ticks() -> int:
    """Return the host's time as a signing stamp, 0 while its clock is before 2015."""
    return max(0, (time.time_ns() - EPOCH_S * 10**9) // 10_000)


@dataclass(slots=True)
class SigningCounts:
    """Frames judged: taken, or refused and why."""

    accepted: int = 0
    unsigned_allowed: int = 0
    unsigned: int = 0
    bad_signature: int = 0
    replayed: int = 0
    too_old: int = 0
    too_far_ahead: int = 0
    state_failures: int = 0


class Signer:
    """Signs frames of one component and judges frames of all others that hold the same key.

    Stamps rise strictly for each (system, component, link id), and only a frame whose signature is
    right moves them: a forged stamp changes nothing. A stamp ahead of our clock is taken, for
    a companion without a battery clock wakes in the past; it binds the stream it came on and
    ours, which must be newer than what peers have seen, but not other streams: whether a new
    stream is too old is judged by our own clock alone, so one sender with a wrong clock cannot
    shut the others out. More than 20 years ahead is refused, before the counter can run full.

    `state_path` keeps the stamps and the newest time our clock has shown over a restart. Delete
    the file if the clock was once set far ahead by mistake.
    """

    def __init__(
        self,
        key: bytes,
        link_id: int,
        state_path: str | Path | None = None,
        clock: Callable[[], int] = clock_ticks,
        allow_unsigned: Iterable[int] = (RADIO_STATUS,),
    ) -> None:
        if len(key) != 32:
            raise SigningError(f"a signing key has 32 bytes, not {len(key)}")
        if not 0 <= link_id <= 255:
            raise SigningError(f"signing link id {link_id} is not between 0 and 255")
        self.counts = SigningCounts()
        self._key = key
        self._link_id = link_id
        self._clock = clock
        self._allow_unsigned = frozenset(allow_unsigned)
        self._path = None if state_path is None else Path(state_path)
        self._streams: dict[tuple[int, int, int], int] = {}
        self._sent = self._floor = 0
        self._save_sent = self._save_floor = 0
        if self._path is not None and self._path.exists():
            self._load(self._path)

    def sign(self, frame: bytes) -> bytes:
        """Return the signed frame of a MAVLink 2 frame; one that is signed is signed anew."""
        frame = _with_flag(strip_signature(frame))
        now = self._now()
        self._sent = max(now, self._sent + 1)
        self._streams[frame[5], frame[6], self._link_id] = self._sent
        if now >= self._save_floor or self._sent >= max(self._save_sent, now + 1):
            self.save()
        body = frame + bytes((self._link_id,)) + self._sent.to_bytes(6, "little")
        return body + hashlib.sha256(self._key + body).digest()[:6]

    def accept(self, frame: bytes) -> bool:
        """Return whether a received frame, signed or not, may be believed."""
        counts = self.counts
        if not is_signed(frame):
            return self._accept_unsigned(frame)
        digest = hashlib.sha256(self._key + frame[:-6]).digest()[:6]
        if not hmac.compare_digest(digest, frame[-6:]):
            counts.bad_signature += 1
            return False
        stamp = int.from_bytes(frame[-12:-6], "little")
        stream = (frame[5], frame[6], frame[-13])
        now = self._now()
        last = self._streams.get(stream)
        if stamp > now + AHEAD_LIMIT:
            counts.too_far_ahead += 1
            return False
        if last is not None and stamp <= last:
            counts.replayed += 1
            return False
        if last is None and stamp < now - NEW_STREAM_AGE:
            counts.too_old += 1
            return False
        self._streams[stream] = stamp
        self._sent = max(self._sent, stamp)
        counts.accepted += 1
        return True

    def _accept_unsigned(self, frame: bytes) -> bool:
        counts = self.counts
        if len(frame) > 2 and frame[0] == MARKER_V2 and frame[2] & SIGNED:
            counts.bad_signature += 1
            return False
        if len(frame) >= HEADER_BYTES - 2 and message_id(frame) in self._allow_unsigned:
            counts.unsigned_allowed += 1
            return True
        counts.unsigned += 1
        return False

    def _now(self) -> int:
        self._floor = max(self._floor, self._clock())
        return self._floor

    def save(self) -> None:
        """Write the state, replacing the old one at once; call it when the service ends too."""
        self._save_sent = self._sent + SAVE_FRAMES
        self._save_floor = self._floor + SAVE_PERIOD
        if self._path is None:
            return
        streams = [[*stream, stamp] for stream, stamp in self._streams.items()]
        state = {"sent": self._sent, "clock": self._floor, "streams": streams}
        beside = self._path.with_name(self._path.name + ".new")
        try:
            with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as f:
                json.dump(state, f)
            beside.replace(self._path)
        except OSError:
            # Flying on is right: the clock alone keeps stamps rising unless it is set back.
            self.counts.state_failures += 1

    def _load(self, path: Path) -> None:
        """Go on after every stamp that can have been used since the state was written."""
        try:
            state: Any = json.loads(path.read_text("ascii"))
            sent, floor = int(state["sent"]), int(state["clock"])
            self._streams = {(int(s), int(c), int(k)): int(t) for s, c, k, t in state["streams"]}
        except (OSError, ValueError, TypeError, KeyError):
            self.counts.state_failures += 1
            return
        self._floor = floor
        self._sent = sent + SAVE_FRAMES
        if self._clock() < floor:
            self._sent = max(self._sent, floor + SAVE_PERIOD)
