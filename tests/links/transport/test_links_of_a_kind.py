"""What only one kind of link does: peers, second clients, ports and devices that are taken."""

import asyncio
import socket
from pathlib import Path

import pytest

from ahrs_service.errors import LinkOpenError
from ahrs_service.links.transport.link import LinkState
from ahrs_service.links.transport.registry import open_link
from tests.links.far_end import Heard, frame, joined, run


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


def test_tcpin_refuses_a_second_client_unless_the_first_is_silent(
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
            monkeypatch.setattr("ahrs_service.links.transport.tcp.SILENT_CLIENT_S", -1.0)
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
