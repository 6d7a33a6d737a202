"""UDP links: `udpin:HOST:PORT` listens and answers, `udpout:HOST:PORT` sends to one place."""

import asyncio
import contextlib
import socket
import time
from typing import Any, ClassVar, Final

from ahrs_service.links.transport.address import host_and_port, listening_error, place, resolve
from ahrs_service.links.transport.link import Link, LinkState, OnBytes, OnState, Peer, ReopeningLink

DATAGRAM_BYTES: Final = 65536
BURST: Final = 32
"""Datagrams read per iteration of the event loop, so a flood leaves time for other work."""
RECEIVE_BUFFER_BYTES: Final = 1 << 20
MAX_PEERS: Final = 8
PEER_SILENCE_S: Final = 10.0


def _datagram_socket(family: int) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_DGRAM)
    sock.setblocking(False)
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    return sock


class UdpInLink(Link):
    """Listens on a UDP port and sends to the peers that were confirmed lately, at most eight.

    Every sender is read, none is answered before `confirm`: a forged source address costs no
    memory and draws no traffic to its victim.
    """

    is_datagram: ClassVar[bool] = True

    def __init__(self, uri: str, rest: str, on_bytes: OnBytes, on_state: OnState) -> None:
        super().__init__(uri, on_bytes, on_state)
        self._host, self._port = host_and_port(uri, rest, "127.0.0.1")
        self._sock: socket.socket | None = None
        self._peers: dict[Any, float] = {}

    async def start(self) -> None:
        """Bind the port; `uri` then names the port really taken."""
        family, address = await resolve(self.uri, self._host, self._port, socket.SOCK_DGRAM)
        sock = _datagram_socket(family)
        try:
            if family == socket.AF_INET6:
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            sock.bind(address)
        except OSError as error:
            sock.close()
            raise listening_error(self.uri, error) from error
        self._sock = sock
        self.uri = f"udpin:{place(sock.getsockname())}"
        asyncio.get_running_loop().add_reader(sock, self._readable, sock)
        self._set_state(LinkState.CONNECTING, f"{self.uri}: listening")

    def _readable(self, sock: socket.socket) -> None:
        for _ in range(BURST):
            try:
                data, peer = sock.recvfrom(DATAGRAM_BYTES)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                continue
            self._deliver(data, peer)
            if self._sock is None:
                return

    def confirm(self, peer: Peer) -> None:
        """Make the peer one that `send` goes to, for as long as valid frames keep coming."""
        now_s = time.monotonic()
        if peer not in self._peers:
            self._forget_silent(now_s)
            if len(self._peers) >= MAX_PEERS:
                self.counts.peers_refused += 1
                return
        self._peers[peer] = now_s
        if self.state is not LinkState.UP:
            self._set_state(LinkState.UP, f"{self.uri}: hearing {place(peer)}")

    def _forget_silent(self, now_s: float) -> None:
        silent = [peer for peer, heard in self._peers.items() if now_s - heard > PEER_SILENCE_S]
        for peer in silent:
            del self._peers[peer]
        if silent and not self._peers:
            self._set_state(
                LinkState.DOWN, f"{self.uri}: nothing from {place(silent[0])}; listening"
            )

    def _write(self, frame: bytes) -> bool:
        if self._sock is None:
            return False
        self._forget_silent(time.monotonic())
        sent = False
        for peer in self._peers:
            with contextlib.suppress(OSError):
                sent |= self._sock.sendto(frame, peer) == len(frame)
        return sent

    async def close(self) -> None:
        """Give the port back."""
        if self._sock is not None:
            asyncio.get_running_loop().remove_reader(self._sock)
            self._sock.close()
            self._sock = None
        self._peers.clear()
        self._set_state(LinkState.CLOSED, f"{self.uri}: closed")


class UdpOutLink(ReopeningLink):
    """Sends to one UDP address and takes datagrams from nowhere else.

    The socket is connected, so the system reports when nothing listens there; the link then stands
    DOWN and goes on sending until it is heard. It is reopened after the network was lost.
    """

    is_datagram: ClassVar[bool] = True
    calls_first: ClassVar[bool] = True

    def __init__(self, uri: str, rest: str, on_bytes: OnBytes, on_state: OnState) -> None:
        super().__init__(uri, on_bytes, on_state)
        self._host, self._port = host_and_port(uri, rest, None)
        self._family = 0
        self._address: Any = None
        self._sock: socket.socket | None = None

    async def start(self) -> None:
        """Resolve the host and begin to send; nobody needs to listen there yet."""
        self._family, self._address = await resolve(
            self.uri, self._host, self._port, socket.SOCK_DGRAM
        )
        await super().start()

    async def _open(self) -> str:
        self._sock = _datagram_socket(self._family)
        self._sock.connect(self._address)
        asyncio.get_running_loop().add_reader(self._sock, self._readable, self._sock)
        return place(self._address)

    def _release(self) -> None:
        if self._sock is not None:
            asyncio.get_running_loop().remove_reader(self._sock)
            self._sock.close()
            self._sock = None

    def _readable(self, sock: socket.socket) -> None:
        for _ in range(BURST):
            try:
                data = sock.recv(DATAGRAM_BYTES)
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                self._failed(error)
                return
            if self.state is LinkState.DOWN:
                self._set_state(LinkState.UP, f"{self.uri}: hearing {place(self._address)}")
            self._deliver(data, self._address)
            if self._sock is not sock:
                return

    def _failed(self, error: OSError) -> None:
        if not isinstance(error, ConnectionRefusedError):
            self._lose(error.strerror or str(error))
        elif self.state is LinkState.UP:
            self._set_state(LinkState.DOWN, f"{self.uri}: nothing listens there yet")

    def _write(self, frame: bytes) -> bool:
        if self._sock is None:
            return False
        try:
            return self._sock.send(frame) == len(frame)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError as error:
            self._failed(error)
            return False
