"""Records what arrives to .tlog files: rotated by size, bounded on disk, never blocking."""

import contextlib
import errno
import os
import re
import shutil
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ahrs_service.links.mavlink.frames import MARKER_V2, SIGNED, strip_signature
from ahrs_service.links.mavlink.signing import SETUP_SIGNING, message_id

MB: Final = 1_000_000
BUFFER_BYTES: Final = 65536
KEEP_FREE_MB: Final = 50.0
OWN_NAME: Final = re.compile(r"\d{8}-\d{6}-\d{2,}\.tlog")
_STAMP: Final = struct.Struct(">Q")


@dataclass(slots=True)
class RecorderCounts:
    """What was written, and what was not."""

    frames: int = 0
    bytes: int = 0
    dropped: int = 0
    files: int = 0
    deleted: int = 0


class Recorder:
    """Writes frames with their receipt stamps to .tlog files.

    `path` a folder, where files are named `YYYYmmdd-HHMMSS-NN.tlog` by the UTC time of
    their first frame, or one file to be made, ending in .tlog and never rotated. No file is ever
    overwritten. `rotate_mb` starts a new file; `limit_mb` bounds all files of such names in the
    folder, of which one takes at most half: the oldest are deleted first; 0 disables either.
    `header` gives frames that go
    first into every file. `on_note` is called for every file started or deleted, and once, when
    recording ended because the disk is full or cannot be written; frames are then counted as
    dropped, and nothing is raised. `last_stamp_us` is that of the last frame recorded. Signatures
    are stripped and SETUP_SIGNING, which holds the key, is left out.
    """

    def __init__(
        self,
        path: str | Path,
        rotate_mb: float = 100.0,
        limit_mb: float = 1000.0,
        header: Callable[[], list[bytes]] = list,
        on_note: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.counts = RecorderCounts()
        self.file: Path | None = None
        self.last_stamp_us = 0
        self._path = Path(path)
        self._is_file = self._path.suffix == ".tlog"
        limit = limit_mb * MB if limit_mb > 0 else float("inf")
        rotate = rotate_mb * MB if rotate_mb > 0 else float("inf")
        self._limit = limit
        self._rotate = limit if self._is_file else min(rotate, limit / 2)
        self._header = header
        self._on_note = on_note
        self._fd = -1
        self._size = 0
        self._buffer = bytearray()
        self._waiting = 0
        self._ended = False

    def write(self, received_us: int, frame: bytes) -> None:
        """Record one frame received at `received_us` [us since 1970]; it is written later."""
        if frame[0] == MARKER_V2:
            if frame[2] & SIGNED:
                frame = strip_signature(frame)
            if message_id(frame) == SETUP_SIGNING:
                return
        if self._fd < 0 and not self._begin(received_us):
            self.counts.dropped += 1
            return
        self.last_stamp_us = received_us
        self._buffer += _STAMP.pack(received_us)
        self._buffer += frame
        self._waiting += 1
        if len(self._buffer) >= BUFFER_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write the buffer to the file; call it once a second."""
        if self._fd < 0 or not self._buffer:
            return
        try:
            # A check of a mount point costs less than the write that follows.
            if shutil.disk_usage(self._folder).free < KEEP_FREE_MB * MB:
                raise OSError(errno.ENOSPC, f"less than {KEEP_FREE_MB:.0f} MB free")
            done = os.write(self._fd, self._buffer)
            if done < len(self._buffer):
                os.ftruncate(self._fd, self._size)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self._end(error)
            return
        self._size += done
        self.counts.bytes += done
        self.counts.frames += self._waiting
        self._waiting = 0
        self._buffer.clear()
        if self._size >= self._rotate:
            if self._is_file:
                self._end(OSError(errno.EFBIG, f"{self._size / MB:.0f} MB, the limit, reached"))
            else:
                self._close_file()

    def close(self) -> None:
        """Write what is buffered and close the file."""
        self.flush()
        self._close_file()

    @property
    def has_ended(self) -> bool:
        """Whether recording ended for good, as `on_note` reported."""
        return self._ended

    @property
    def _folder(self) -> Path:
        return self._path.parent if self._is_file else self._path

    def _begin(self, received_us: int) -> bool:
        """Open the next file and put the header into the buffer."""
        if self._ended:
            return False
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if not self._is_file:
                self._make_room()
            self.file, self._fd = self._create(received_us)
        except OSError as error:
            self._end(error)
            return False
        self._size = 0
        self.counts.files += 1
        self._on_note(f"recording to {self.file}")
        for frame in self._header():
            self._buffer += _STAMP.pack(received_us)
            self._buffer += strip_signature(frame)
            self._waiting += 1
        return True

    def _create(self, received_us: int) -> tuple[Path, int]:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
        if self._is_file:
            return self._path, os.open(self._path, flags, 0o644)
        instant = time.strftime("%Y%m%d-%H%M%S", time.gmtime(received_us // 1_000_000))
        number = 0
        while True:
            path = self._path / f"{instant}-{number:02d}.tlog"
            try:
                return path, os.open(path, flags, 0o644)
            except FileExistsError:
                number += 1

    def _make_room(self) -> None:
        """Delete the oldest own files until the next one fits under the limit."""
        if self._limit == float("inf"):
            return
        own = sorted(
            (path.name, path.stat().st_size, path)
            for path in self._path.iterdir()
            if OWN_NAME.fullmatch(path.name) and path.is_file()
        )
        total = sum(size for _, size, _ in own)
        for _, size, path in own:
            if total + self._rotate <= self._limit:
                break
            path.unlink()
            total -= size
            self.counts.deleted += 1
            self._on_note(f"deleted {path}, the oldest recording, to stay in the disk limit")

    def _close_file(self) -> None:
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                os.close(self._fd)
            self._fd = -1

    def _end(self, error: OSError) -> None:
        """Stop recording, and report it once."""
        self._ended = True
        self._close_file()
        self.counts.dropped += self._waiting
        self._waiting = 0
        self._buffer.clear()
        place = self.file or self._path
        self._on_note(f"recording ended: {place}: {error.strerror or error}")
