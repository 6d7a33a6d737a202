"""One contract for every kind of link, against real sockets and a real pty at the other end."""

import asyncio
import contextlib
import os
import pty
import socket
import time
import tty
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from links.errors import LinkOpenError
from links.link import Link, LinkState, Peer, receipt_clock
from links.registry import open_link


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
TIMEOUT_S = 30.0


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
        async with asyncio.timeout(TIMEOUT_S):
            await scenario

    asyncio.run(limited())


def test_receipt_clock_is_wall_time_with_two_low_bits_clear() -> None:
    stamps = [receipt_clock() for _ in range(2000)]
    assert stamps == sorted(stamps)
    assert not any(stamp & 3 for stamp in stamps)
    assert abs(stamps[0] / 1e6 - time.time()) < 5


@pytest.mark.parametrize("kind", KINDS)
def test_bytes_arrive_whole_in_order_and_stamped(kind: str, tmp_path: Path) -> None:
    async def scenario() -> None:
        async with joined(kind, tmp_path) as (link, far, heard):
            sent = b"".join(frame(i) for i in range(300))
            for i in range(300):
                await far.send(frame(i))
            await heard.until(lambda: len(heard.data) >= len(sent))
            assert heard.data == sent
            assert heard.stamps == sorted(heard.stamps)
            assert not any(stamp & 3 for stamp in heard.stamps)
            assert len(set(heard.peers)) == 1
            assert link.counts.bytes_in >= len(sent)
            if link.is_datagram:
                assert heard.pieces == [frame(i) for i in range(300)]

    run(scenario())


@pytest.mark.parametrize("kind", KINDS)
def test_frames_sent_arrive_whole_and_in_order(kind: str, tmp_path: Path) -> None:
    async def scenario() -> None:
        async with joined(kind, tmp_path) as (link, far, _):
            before = link.counts.sends
            sent = b""
            for i in range(50):
                assert link.send(frame(i))
                sent += frame(i)
            assert await far.receive(len(sent)) == sent
            assert link.counts.sends == before + 50
            assert link.counts.send_failures == 0

    run(scenario())


@pytest.mark.parametrize("kind", STREAMS)
def test_a_burst_of_a_megabyte_arrives_whole(kind: str, tmp_path: Path) -> None:
    async def scenario() -> None:
        async with joined(kind, tmp_path) as (_, far, heard):
            sent = b"".join(frame(i) for i in range(16384))
            sending = asyncio.create_task(far.send(sent))
            await heard.until(lambda: len(heard.data) >= len(sent))
            await sending
            assert heard.data == sent

    run(scenario())


@pytest.mark.parametrize("kind", STREAMS)
def test_a_far_end_that_does_not_read_costs_whole_frames_only(kind: str, tmp_path: Path) -> None:
    async def scenario() -> None:
        async with joined(kind, tmp_path) as (link, far, _):
            accepted = []
            for i in range(200_000):
                # An odd length, so that the system takes some frame in part.
                odd = frame(i) + b"tail of it"[: 1 + i % 9]
                if link.send(odd):
                    accepted.append(odd)
                elif link.counts.send_failures > 10:
                    break
            assert link.counts.send_failures > 10
            sent = b"".join(accepted)
            assert await far.receive(len(sent)) == sent
            assert link.send(frame(7))
            assert await far.receive(64) == frame(7)

    run(scenario())


@pytest.mark.parametrize("kind", ["tcp", "tcpin", "serial", "udpin"])
def test_the_far_end_vanishes_and_returns(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> None:
        async with joined(kind, tmp_path) as (link, far, heard):
            far.vanish()
            if kind == "udpin":
                with monkeypatch.context() as patch:
                    patch.setattr("links.udp.PEER_SILENCE_S", -1.0)
                    assert not link.send(frame(0))
            await heard.state(LinkState.DOWN)
            assert not link.send(frame(1))
            assert link.counts.send_failures >= 1
            far.appear()
            await far.meet(link, heard)
            assert link.state is LinkState.UP
            await far.send(frame(2))
            await heard.until(lambda: frame(2) in heard.data)
            assert link.send(frame(3))
            assert await far.receive(64) == frame(3)
            assert link.counts.connects == 2

    run(scenario())


def test_udpout_survives_that_nobody_listens(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with joined("udpout", tmp_path) as (link, far, heard):
            far.vanish()
            while link.state is not LinkState.DOWN:
                link.send(frame(0))
                await asyncio.sleep(0)
            assert "nothing listens" in heard.states[-1][1]
            far.appear()
            while not link.send(frame(1)):
                await asyncio.sleep(0)
            assert await far.receive(64) == frame(1)
            await far.send(frame(2))
            await heard.state(LinkState.UP)
            assert bytes(heard.data) == frame(2)

    run(scenario())


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_a_far_end_that_comes_later_is_found(kind: str, tmp_path: Path) -> None:
    async def scenario() -> None:
        far, heard = Far(kind, tmp_path), Heard()
        far.appear()
        far.vanish()
        link = open_link(far.uri, heard.on_bytes, heard.on_state)
        await link.start()
        await heard.until(lambda: bool(heard.states))
        assert link.state is LinkState.CONNECTING
        assert "trying again" in heard.states[-1][1]
        assert not link.send(frame(0))
        far.appear()
        await far.meet(link, heard)
        await far.send(frame(1))
        await heard.until(lambda: bytes(heard.data) == frame(1))
        await link.close()
        far.vanish()

    run(scenario())


@pytest.mark.parametrize("kind", KINDS)
def test_close_leaves_nothing_behind(kind: str, tmp_path: Path) -> None:
    descriptors = Path("/proc/self/fd")
    if not descriptors.is_dir():
        pytest.skip("no /proc/self/fd on this system to count open descriptors")

    async def scenario() -> None:
        async with joined(kind, tmp_path):
            pass
        before, tasks = len(list(descriptors.iterdir())), len(asyncio.all_tasks())
        async with joined(kind, tmp_path) as (link, far, heard):
            await far.send(frame(1))
            await heard.until(lambda: frame(1) in heard.data)
        assert link.state is LinkState.CLOSED
        assert heard.states[-1][0] is LinkState.CLOSED
        assert not link.send(frame(2))
        await link.close()
        assert [state for state, _ in heard.states].count(LinkState.CLOSED) == 1
        assert len(list(descriptors.iterdir())) == before
        assert len(asyncio.all_tasks()) == tasks

    run(scenario())


def test_closing_while_trying_to_connect_ends_at_once(tmp_path: Path) -> None:
    async def scenario() -> None:
        link = open_link(f"serial:{tmp_path / 'later'}:57600", Heard().on_bytes, Heard().on_state)
        await link.start()
        await asyncio.sleep(0)
        await link.close()
        assert link.state is LinkState.CLOSED
        assert len(asyncio.all_tasks()) == 1

    run(scenario())


def test_udpin_answers_confirmed_peers_only_and_holds_eight() -> None:
    async def scenario() -> None:
        heard = Heard()
        heard.confirms = False
        link = open_link("udpin:127.0.0.1:0", heard.on_bytes, heard.on_state)
        await link.start()
        port = int(link.uri.rpartition(":")[2])
        far = []
        for _ in range(10):
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.setblocking(False)
            sock.connect(("127.0.0.1", port))
            sock.send(b"x")
            far.append(sock)
        await heard.until(lambda: len(heard.peers) == 10)
        assert not link.send(b"unasked")
        for peer in heard.peers:
            link.confirm(peer)
        assert link.counts.peers_refused == 2
        assert link.send(b"answer")
        loop = asyncio.get_running_loop()
        for sock in far[:8]:
            assert await loop.sock_recv(sock, 100) == b"answer"
        for sock in far[8:]:
            with pytest.raises(BlockingIOError):
                sock.recv(100)
        await link.close()
        for sock in far:
            sock.close()

    run(scenario())


def test_udpout_takes_from_its_address_only(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with joined("udpout", tmp_path) as (_, far, heard):
            assert far.socket is not None
            target = far.socket.getpeername()
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                stranger.sendto(b"forged", target)
            await far.send(b"true")
            await heard.until(lambda: b"true" in heard.data)
            assert bytes(heard.data) == b"true"

    run(scenario())


def test_tcpin_turns_a_second_client_away_unless_the_first_is_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> None:
        async with joined("tcpin", tmp_path) as (link, far, heard):
            loop = asyncio.get_running_loop()
            second, third = far._socket(socket.SOCK_STREAM), far._socket(socket.SOCK_STREAM)
            await loop.sock_connect(second, ("127.0.0.1", far.port))
            assert await loop.sock_recv(second, 10) == b""
            assert link.counts.peers_refused == 1
            await far.send(frame(1))
            await heard.until(lambda: frame(1) in heard.data)
            monkeypatch.setattr("links.tcp.SILENT_CLIENT_S", -1.0)
            await loop.sock_connect(third, ("127.0.0.1", far.port))
            await heard.until(lambda: link.counts.connects == 2)
            await loop.sock_sendall(third, frame(2))
            await heard.until(lambda: frame(2) in heard.data)
            assert await loop.sock_recv(far.socket, 10) == b""
            second.close()
            third.close()

    run(scenario())


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_port_that_is_taken_is_an_error(kind: str) -> None:
    async def scenario() -> None:
        first = open_link(f"{kind}:127.0.0.1:0", Heard().on_bytes, Heard().on_state)
        await first.start()
        second = open_link(first.uri, Heard().on_bytes, Heard().on_state)
        with pytest.raises(LinkOpenError, match=r"cannot listen .*choose another port"):
            await second.start()
        await second.close()
        await first.close()

    run(scenario())


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("udpout:no-such-host.invalid:14550", "no host 'no-such-host.invalid'"),
        ("tcp:no-such-host.invalid:5760", "no host 'no-such-host.invalid'"),
        ("udpin:192.0.2.1:14550", "cannot listen"),
        ("serial:/dev/null:57600", "is no serial port"),
        ("serial:/:57600", "is no serial port"),
    ],
)
def test_what_can_never_work_is_an_error(uri: str, says: str) -> None:
    async def scenario() -> None:
        link = open_link(uri, Heard().on_bytes, Heard().on_state)
        with pytest.raises(LinkOpenError, match=says) as caught:
            await link.start()
        assert uri in str(caught.value)
        await link.close()

    run(scenario())


def test_a_held_serial_port_is_waited_for(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with joined("serial", tmp_path) as (first, far, _):
            heard = Heard()
            second = open_link(far.uri, heard.on_bytes, heard.on_state)
            await second.start()
            await heard.until(lambda: bool(heard.states))
            assert "another program holds the device" in heard.states[-1][1]
            await first.close()
            await heard.state(LinkState.UP)
            await far.send(frame(1))
            await heard.until(lambda: bytes(heard.data) == frame(1))
            await second.close()

    run(scenario())
