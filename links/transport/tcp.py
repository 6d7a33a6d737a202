"""TCP links: `tcp:HOST:PORT` connects and reconnects, `tcpin:HOST:PORT` serves one client."""

import asyncio
import contextlib
import errno
import os
import socket
import time
from typing import Any, Final

from ahrs_service.links.transport.address import host_and_port, listening_error, place, resolve
from ahrs_service.links.transport.link import Link, LinkState, OnBytes, OnState, ReopeningLink
from ahrs_service.links.transport.stream import FdStream

CONNECT_S: Final = 5.0
SILENT_CLIENT_S: Final = 3.0
ACCEPT_PAUSE_S: Final = 1.0
QUEUE_BYTES: Final = 32768


def _prepare(sock: socket.socket) -> None:
    """Send without delay, and notice within seconds that the other side is gone."""
    options = [
        (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
        (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
        (socket.SOL_SOCKET, socket.SO_SNDBUF, QUEUE_BYTES),
        (socket.IPPROTO_TCP, getattr(socket, "TCP_KEEPIDLE", 0), 3),
        (socket.IPPROTO_TCP, getattr(socket, "TCP_KEEPINTVL", 0), 2),
        (socket.IPPROTO_TCP, getattr(socket, "TCP_KEEPCNT", 0), 3),
        (socket.IPPROTO_TCP, getattr(socket, "TCP_USER_TIMEOUT", 0), 8000),
    ]
    for level, option, value in options:
        if option:
            with contextlib.suppress(OSError):
                sock.setsockopt(level, option, value)


class TcpLink(ReopeningLink):
    """Connects to a TCP server, again and again."""

    def __init__(self, uri: str, rest: str, on_bytes: OnBytes, on_state: OnState) -> None:
        super().__init__(uri, on_bytes, on_state)
        self._host, self._port = host_and_port(uri, rest, None)
        self._sock: socket.socket | None = None
        self._stream: FdStream | None = None

    async def start(self) -> None:
        """Begin to connect; the host must have an address, the server may come later."""
        await resolve(self.uri, self._host, self._port, socket.SOCK_STREAM)
        await super().start()

    async def _open(self) -> str:
        loop = asyncio.get_running_loop()
        found = await loop.getaddrinfo(self._host, self._port, type=socket.SOCK_STREAM)
        failure = OSError(errno.EHOSTUNREACH, os.strerror(errno.EHOSTUNREACH))
        for family, kind, protocol, _, address in found:
            try:
                await self._connect(socket.socket(family, kind, protocol), address)
            except OSError as error:
                self._release()
                failure = error
            else:
                return place(address)
        raise failure

    async def _connect(self, sock: socket.socket, address: Any) -> None:
        self._sock = sock
        sock.setblocking(False)
        _prepare(sock)
        try:
            async with asyncio.timeout(CONNECT_S):
                await asyncio.get_running_loop().sock_connect(sock, address)
        except TimeoutError as error:
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT)) from error
        self._stream = FdStream(
            sock.fileno(), lambda data: self._deliver(data, address), self._lose, QUEUE_BYTES
        )

    def _release(self) -> None:
        if self._stream is not None:
            self._stream.detach()
            self._stream = None
        if self._sock is not None:
            self._sock.close()
            self._sock = None

    def _write(self, frame: bytes) -> bool:
        return self._stream is not None and self._stream.write(frame)

    async def close(self) -> None:
        """Send what is queued, then disconnect."""
        if self._stream is not None:
            await self._stream.drain()
        await super().close()


class TcpInLink(Link):
    """Serves one TCP client at a time; further ones are rejected.

    A client that has been silent for three seconds gives way to the next, since one that lost its
    network comes back on a new connection while the old one still looks alive.
    """

    def __init__(self, uri: str, rest: str, on_bytes: OnBytes, on_state: OnState) -> None:
        super().__init__(uri, on_bytes, on_state)
        self._host, self._port = host_and_port(uri, rest, "127.0.0.1")
        self._listener: socket.socket | None = None
        self._pause: asyncio.TimerHandle | None = None
        self._client: socket.socket | None = None
        self._stream: FdStream | None = None
        self._heard_s = 0.0

    async def start(self) -> None:
        """Bind the port and listen; `uri` then names the port really taken."""
        family, address = await resolve(self.uri, self._host, self._port, socket.SOCK_STREAM)
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            listener.setblocking(False)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            listener.bind(address)
            listener.listen(4)
        except OSError as error:
            listener.close()
            raise listening_error(self.uri, error) from error
        self._listener = listener
        self.uri = f"tcpin:{place(listener.getsockname())}"
        self._listen()
        self._set_state(LinkState.CONNECTING, f"{self.uri}: listening")

    def _listen(self) -> None:
        self._pause = None
        if self._listener is not None:
            asyncio.get_running_loop().add_reader(self._listener, self._accept, self._listener)

    def _accept(self, listener: socket.socket) -> None:
        try:
            client, address = listener.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return
        except OSError:
            # No descriptors left: the listener stays readable, so look away for a while.
            loop = asyncio.get_running_loop()
            loop.remove_reader(listener)
            self._pause = loop.call_later(ACCEPT_PAUSE_S, self._listen)
            return
        if self._client is not None:
            if time.monotonic() - self._heard_s < SILENT_CLIENT_S:
                self.counts.peers_refused += 1
                client.close()
                return
            self._drop("a new client takes over from one that fell silent")
        self._take(client, address)

    def _take(self, client: socket.socket, address: Any) -> None:
        client.setblocking(False)
        _prepare(client)
        self._client = client
        self._heard_s = time.monotonic()

        def heard(data: bytes) -> None:
            self._heard_s = time.monotonic()
            self._deliver(data, address)

        self._stream = FdStream(client.fileno(), heard, self._drop, QUEUE_BYTES)
        self._set_state(LinkState.UP, f"{self.uri}: serving {place(address)}")

    def _drop(self, why: str) -> None:
        self._release_client()
        self._set_state(LinkState.DOWN, f"{self.uri}: {why}; listening")

    def _release_client(self) -> None:
        if self._stream is not None:
            self._stream.detach()
            self._stream = None
        if self._client is not None:
            self._client.close()
            self._client = None

    def _write(self, frame: bytes) -> bool:
        return self._stream is not None and self._stream.write(frame)

    async def close(self) -> None:
        """Send what is queued, then end the client and the listener."""
        if self._stream is not None:
            await self._stream.drain()
        self._release_client()
        if self._pause is not None:
            self._pause.cancel()
            self._pause = None
        if self._listener is not None:
            asyncio.get_running_loop().remove_reader(self._listener)
            self._listener.close()
            self._listener = None
        self._set_state(LinkState.CLOSED, f"{self.uri}: closed")
