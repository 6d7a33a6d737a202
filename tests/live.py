"""A real daemon in this event loop, and the far end of its link."""

import asyncio
import contextlib
import dataclasses
import os
import pty
import tty
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_service.app.live.daemon import Daemon
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect
from ahrs_service.links.simulated.autopilot_parameters import AutopilotParameters
from ahrs_service.links.transport.link import Link, LinkState
from ahrs_service.links.transport.registry import open_link
from ahrs_service.links.transport.stream import FdStream
from ahrs_service.records import ESTIMATE_DTYPE, Rows
from ahrs_service.settings import RecorderSettings, Settings
from tests.hang import HANG_S


class Served:
    """A real daemon in this event loop, with copies of all that it said and estimated."""

    def __init__(self, settings: Settings) -> None:
        self.said: list[tuple[str, str]] = []
        self.estimates: list[bytes] = []
        self.failures: list[dict[str, Any]] = []
        self._news = asyncio.Event()
        self.daemon = Daemon(settings, self._on_log, self._on_estimate)

    def _on_log(self, level: str, text: str) -> None:
        self.said.append((level, text))
        self._news.set()

    def _on_estimate(self, estimates: Rows) -> None:
        self.estimates.append(estimates.tobytes())
        self._news.set()

    async def __aenter__(self) -> "Served":
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: self.failures.append(context))
        self._task = asyncio.create_task(self.daemon.run())
        ready = asyncio.create_task(self.daemon.ready.wait())
        await asyncio.wait([self._task, ready], return_when=asyncio.FIRST_COMPLETED)
        ready.cancel()
        if self._task.done():
            await self._task
        return self

    async def __aexit__(self, *error: object) -> None:
        self.daemon.stop()
        await self._task
        assert not self.failures, self.failures

    async def until(self, holds: Callable[[], Any]) -> None:
        """Wait until `holds()`; without a new estimate or log line it is polled."""
        async with asyncio.timeout(HANG_S):
            while not holds():
                self._news.clear()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._news.wait(), 0.02)

    async def heard(self, words: str, times: int = 1) -> None:
        """Wait for a log line that contains `words`, said so often."""
        await self.until(lambda: sum(words in text for _, text in self.said) >= times)

    async def decoded(self, frames: int) -> None:
        """Wait until this many good frames were decoded."""
        await self.until(lambda: self.frames >= frames)

    async def received(self, count: int) -> None:
        """Wait until this many bytes arrived over the link."""
        await self.until(lambda: self.daemon.link.counts.bytes_in >= count)

    @property
    def frames(self) -> int:
        """Good frames decoded so far."""
        return self.daemon.decoder.counts["frames"]

    @property
    def rows(self) -> Rows:
        """All estimates so far."""
        return np.frombuffer(b"".join(self.estimates), ESTIMATE_DTYPE)

    @property
    def digest(self) -> str:
        """SHA-256 of all estimates so far, as reported by the daemon."""
        return self.daemon.estimator.digest.hexdigest()


class Vehicle:
    """The far end of a daemon's link: sends bytes, keeps what comes back.

    `kind` is the kind of the daemon's link; `uri` what the daemon is to open, known after
    `prepare`; `meet` connects both. `answer` makes reply frames from those received.
    """

    def __init__(self, kind: str, folder: Path) -> None:
        self.kind = kind
        self.uri = ""
        self.heard: list[Any] = []
        self.answer: Callable[[Any], list[bytes]] = lambda message: []
        self.link: Link | None = None
        self.up = asyncio.Event()
        self._folder = folder
        self._stream: FdStream | None = None
        self._pty = (-1, -1)
        self._decoder = Decoder()

    def _on_bytes(self, data: bytes, received_us: int = 0, peer: Any = None) -> None:
        if self.link is not None:
            self.link.confirm(peer)
        for message, _ in self._decoder.feed(data):
            self.heard.append(message)
            for frame in self.answer(message):
                self.send(frame)

    def _on_state(self, state: LinkState, why: str) -> None:
        if state is LinkState.UP:
            self.up.set()

    async def prepare(self, port: int = 0) -> "Vehicle":
        """Create what must exist before the daemon opens its link."""
        if self.kind == "serial":
            self._open_pty()
        elif self.kind in ("tcp", "udpout"):
            scheme = {"tcp": "tcpin", "udpout": "udpin"}[self.kind]
            self.link = open_link(f"{scheme}:127.0.0.1:{port}", self._on_bytes, self._on_state)
            await self.link.start()
            self.uri = self.link.uri.replace(scheme, self.kind)
        else:
            self.uri = f"{self.kind}:127.0.0.1:{port}"
        return self

    def _open_pty(self) -> None:
        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        device = self._folder / "tty"
        device.unlink(missing_ok=True)
        device.symlink_to(os.ttyname(slave))
        self._pty = master, slave
        self._stream = FdStream(master, self._on_bytes, lambda why: None, 1 << 20)
        self.uri = f"serial:{device}:921600"
        self.up.set()

    async def meet(self, uri: str) -> None:
        """Connect to the daemon whose link has this URI."""
        if self.kind in ("udpin", "tcpin"):
            far = uri.replace(self.kind, {"udpin": "udpout", "tcpin": "tcp"}[self.kind])
            self.link = open_link(far, self._on_bytes, self._on_state)
            await self.link.start()
        async with asyncio.timeout(HANG_S):
            await self.up.wait()

    @property
    def state(self) -> LinkState:
        """Whether frames sent can arrive, as reported by the link."""
        return LinkState.UP if self.link is None else self.link.state

    def send(self, data: bytes) -> bool:
        """Send bytes as they are; False where the queue is full."""
        if self._stream is not None:
            return self._stream.write(data)
        assert self.link is not None
        return self.link.send(data)

    async def close(self) -> None:
        """Vanish as a vehicle that lost power does."""
        if self._stream is not None:
            self._stream.detach()
            self._stream = None
            for fd in self._pty:
                os.close(fd)
        if self.link is not None:
            await self.link.close()


class FarAutopilot:
    """An autopilot at the far end of a link: it sends heartbeats and serves its parameters.

    `lose_request(message)` and `lose_answer(message)` choose what is lost; after `die_after`
    PARAM_SET messages the link is dead in both directions.
    """

    def __init__(self, parameters: AutopilotParameters, autopilot: int, vehicle: Vehicle) -> None:
        self.parameters, self.vehicle = parameters, vehicle
        self.heard: list[Any] = []
        self.is_dead, self.die_after = False, 10**9
        self.lose_request: Callable[[Any], bool] = lambda message: False
        self.lose_answer: Callable[[Any], bool] = lambda message: False
        self.encoder = Encoder(1, 1)
        self.uid = 0x0123456789ABCDEF
        self._autopilot = autopilot
        vehicle.answer = self.answer

    def answer(self, message: Any) -> list[bytes]:
        """Take a message; return the frames that come back."""
        if message.get_type() == "COMMAND_LONG":
            none = bytes(8)
            version = dialect.MAVLink_autopilot_version_message(
                0, 0, 0, 0, 0, none, none, none, 0, 0, self.uid
            )
            return [self.encoder.pack(version)]
        if not message.get_type().startswith("PARAM_"):
            return []
        self.is_dead = self.is_dead or self.count("PARAM_SET") >= self.die_after
        if self.is_dead:
            return []
        self.heard.append(message)
        if self.lose_request(message):
            return []
        answers = self.parameters.on_message(message)
        return [self.encoder.pack(answer) for answer in answers if not self.lose_answer(answer)]

    def count(self, kind: str) -> int:
        """Return how many messages of a kind have arrived."""
        return sum(message.get_type() == kind for message in self.heard)

    async def beat(self) -> None:
        """Send heartbeats until cancelled."""
        while True:
            if not self.is_dead:
                message = dialect.MAVLink_heartbeat_message(2, self._autopilot, 0, 0, 4, 3)
                self.vehicle.send(self.encoder.pack(message))
            await asyncio.sleep(0.02)


async def fly(served: Served, vehicle: Vehicle, frames: Sequence[bytes]) -> None:
    """Send frames in bursts, each when the daemon has taken the one before."""
    taken = served.frames
    for start in range(0, len(frames), 64):
        burst = frames[start : start + 64]
        for frame in burst:
            while not vehicle.send(frame):
                await asyncio.sleep(0.001)
        taken += len(burst)
        await served.decoded(taken)


@asynccontextmanager
async def session(settings: Settings, kind: str, folder: Path) -> AsyncIterator[Any]:
    """Give (served, vehicle): a daemon with a link of this kind, and the far end, connected."""
    vehicle = await Vehicle(kind, folder).prepare()
    link = dataclasses.replace(settings.link, uri=vehicle.uri)
    async with Served(dataclasses.replace(settings, link=link)) as served:
        await vehicle.meet(served.daemon.link.uri)
        if kind not in ("udpin", "udpout"):
            await served.until(lambda: served.daemon.link.state is LinkState.UP)
        yield served, vehicle
    await vehicle.close()


def assert_replays(served: Served, path: Path) -> Any:
    """The replay of a recording gives the bytes of the live session; returns its result."""
    result = replay_log(path)
    assert result.estimates.tobytes() == b"".join(served.estimates)
    assert result.summary.digest == served.digest
    return result


def recorded_in(path: Path) -> Settings:
    """Settings of a session that records into a file or a folder."""
    return Settings(recorder=RecorderSettings(directory=str(path)))


def names(vehicle: Vehicle) -> list[str]:
    """Names of all messages that a far end has heard, in order."""
    return [message.get_type() for message in vehicle.heard]
