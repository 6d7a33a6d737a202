"""The far end of a link: real sockets and a real pty, made of plain system calls."""

import asyncio
import contextlib
import os
import pty
import socket
import tty
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

from ahrs_service.links.transport.link import Link, LinkState, Peer
from ahrs_service.links.transport.registry import open_link
from tests.hang import HANG_S


def frame(number: int) -> bytes:
    return number.to_bytes(4, "big") + bytes(i & 255 for i in range(number, number + 60))


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return False
    return True


KINDS = ["udpin", "udpout", "tcp", "tcpin", "serial"] + ["udpin6", "tcpin6"] * has_ipv6()
STREAMS = ["tcp", "tcpin", "serial"]


class Heard:
    """Collects what a link reports and lets a test wait for it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.pieces: list[bytes] = []
        self.stamps: list[int] = []
        self.peers: list[Peer] = []
        self.states: list[tuple[LinkState, str]] = []
        self.link: Link | None = None
        self.confirms = True
        self._news = asyncio.Event()

    def on_bytes(self, data: bytes, received_us: int, peer: Peer) -> None:
        self.data += data
        self.pieces.append(data)
        self.stamps.append(received_us)
        self.peers.append(peer)
        if self.link is not None and self.confirms:
            self.link.confirm(peer)
        self._news.set()

    def on_state(self, state: LinkState, why: str) -> None:
        self.states.append((state, why))
        self._news.set()

    async def until(self, holds: Callable[[], bool]) -> None:
        while not holds():
            self._news.clear()
            await self._news.wait()

    async def state(self, state: LinkState) -> None:
        await self.until(lambda: bool(self.states) and self.states[-1][0] is state)


class Far:
    """The other end of a link, made of plain system calls."""

    def __init__(self, kind: str, folder: Path) -> None:
        self.kind = kind
        self.host = "::1" if kind.endswith("6") else "127.0.0.1"
        self.family = socket.AF_INET6 if kind.endswith("6") else socket.AF_INET
        self.folder = folder
        self.port = 0
        self.socket: socket.socket | None = None
        self.listener: socket.socket | None = None
        self.master = -1
        self.slave = -1

    @property
    def uri(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        if self.kind == "serial":
            return f"serial:{self.folder / 'tty:1'}:921600"
        return f"{self.kind.rstrip('6')}:{host}:{self.port}"

    def _socket(self, kind: socket.SocketKind) -> socket.socket:
        made = socket.socket(self.family, kind)
        made.setblocking(False)
        return made

    def appear(self) -> None:
        """What a link needs to find before it comes up."""
        if self.kind == "udpout":
            self.socket = self._socket(socket.SOCK_DGRAM)
            self.socket.bind((self.host, self.port))
            self.port = self.socket.getsockname()[1]
        elif self.kind == "tcp":
            self.listener = self._socket(socket.SOCK_STREAM)
            self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self.listener.bind((self.host, self.port))
            self.listener.listen(1)
            self.port = self.listener.getsockname()[1]
        elif self.kind == "serial":
            self.master, self.slave = pty.openpty()
            tty.setraw(self.slave)
            os.set_blocking(self.master, False)
            (self.folder / "tty:1").symlink_to(os.ttyname(self.slave))

    async def meet(self, link: Link, heard: Heard) -> None:
        """Bring both ends together."""
        loop = asyncio.get_running_loop()
        if self.kind.startswith("udpin"):
            self.port = int(link.uri.rpartition(":")[2])
            self.socket = self._socket(socket.SOCK_DGRAM)
            self.socket.connect((self.host, self.port))
            await self.send(b"hello")
            await heard.state(LinkState.UP)
            heard.__init__()  # type: ignore[misc]
            heard.link = link
        elif self.kind.startswith("tcpin"):
            self.port = int(link.uri.rpartition(":")[2])
            self.socket = self._socket(socket.SOCK_STREAM)
            await loop.sock_connect(self.socket, (self.host, self.port))
        elif self.kind == "tcp":
            assert self.listener is not None
            self.socket, _ = await loop.sock_accept(self.listener)
        elif self.kind == "udpout":
            assert self.socket is not None
            await heard.state(LinkState.UP)
            while not link.send(b"hello"):
                await asyncio.sleep(0)
            assert await self.receive(5) == b"hello"
            return
        if not self.kind.startswith("udpin"):
            await heard.state(LinkState.UP)

    def vanish(self) -> None:
        for end in (self.socket, self.listener):
            if end is not None:
                end.close()
        self.socket = self.listener = None
        if self.master >= 0:
            (self.folder / "tty:1").unlink()
            os.close(self.slave)
            os.close(self.master)
            self.master = self.slave = -1

    async def send(self, data: bytes) -> None:
        loop = asyncio.get_running_loop()
        if self.kind != "serial":
            assert self.socket is not None
            await loop.sock_sendall(self.socket, data)
            return
        while data:
            try:
                data = data[os.write(self.master, data) :]
            except BlockingIOError:
                await asyncio.sleep(0)

    async def receive(self, count: int) -> bytes:
        loop = asyncio.get_running_loop()
        data = b""
        while len(data) < count:
            if self.kind == "udpout":
                assert self.socket is not None
                more, address = await loop.sock_recvfrom(self.socket, 65536)
                self.socket.connect(address)
                data += more
            elif self.kind == "serial":
                try:
                    data += os.read(self.master, 65536)
                except BlockingIOError:
                    await asyncio.sleep(0)
            else:
                assert self.socket is not None
                data += await loop.sock_recv(self.socket, 65536)
        return data


@contextlib.asynccontextmanager
async def joined(kind: str, folder: Path) -> AsyncIterator[tuple[Link, Far, Heard]]:
    far, heard = Far(kind, folder), Heard()
    far.appear()
    link = open_link(far.uri, heard.on_bytes, heard.on_state)
    heard.link = link
    await link.start()
    try:
        await far.meet(link, heard)
        yield link, far, heard
    finally:
        await link.close()
        far.vanish()


def run(scenario: Coroutine[Any, Any, None]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(HANG_S):
            await scenario

    asyncio.run(limited())
