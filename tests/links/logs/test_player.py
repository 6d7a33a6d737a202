"""Playing recordings over real links: byte for byte, in order, when they are due."""

import asyncio
import contextlib
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.app.cli import main
from ahrs_service.links.logs.player import due_s, play
from ahrs_service.links.logs.tlog import read_tlog, tlog_record
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.links.transport.link import LinkState
from ahrs_service.links.transport.registry import open_link
from tests.hang import HANG_S

FIRST_US = 1_700_000_000_000_000
ROOT = Path(__file__).resolve().parents[3]


def recorded(path: Path, stamps_us: list[int]) -> bytes:
    """Write a recording with a frame at each stamp; return the frames' bytes."""
    encoder, frames = Encoder(1, 1), []
    for i in range(len(stamps_us)):
        message = dialect.MAVLink_attitude_message(i + 1, 0.5, 0.25, 0.0, 0.0, 0.0, 0.0)
        frames.append(encoder.pack(message))
    pairs = zip(stamps_us, frames, strict=True)
    path.write_bytes(b"".join(tlog_record(us, frame) for us, frame in pairs))
    return b"".join(frames)


def test_frames_are_due_by_their_stamps() -> None:
    stamps = np.array([10.0, 10.5, 10.5, 40.5, 39.0, 39.25]) * 1e6
    due = due_s(stamps.astype(np.int64), speed=2.0, max_gap_s=4.0)
    assert due.tolist() == [0.0, 0.25, 0.25, 2.25, 2.25, 2.375]


@given(st.lists(st.integers(0, 2**50), min_size=1), st.floats(0.1, 100), st.floats(0.1, 100))
def test_due_times_never_go_back(stamps: list[int], speed: float, max_gap_s: float) -> None:
    due = due_s(np.array(stamps, np.int64), speed, max_gap_s)
    assert due[0] == 0
    assert np.all(np.diff(due) >= 0)
    assert due[-1] <= (len(stamps) - 1) * max_gap_s / speed * (1 + 1e-9)


def test_as_fast_as_it_goes_takes_no_time() -> None:
    assert not due_s(np.array([0, 10**9], np.int64), np.inf, np.inf).any()


def test_a_recording_arrives_whole_and_in_order_over_tcp(tmp_path: Path) -> None:
    path = tmp_path / "log.tlog"
    wanted = recorded(path, [FIRST_US + 4 * i for i in range(20000)])

    async def scenario() -> bytes:
        heard, up, done = bytearray(), asyncio.Event(), asyncio.Event()
        shares: list[int] = []

        def on_bytes(data: bytes, received_us: int, peer: Any) -> None:
            heard.extend(data)
            if len(heard) >= len(wanted):
                done.set()

        def on_state(state: LinkState, why: str) -> None:
            if state is LinkState.UP:
                up.set()

        server = open_link("tcpin:127.0.0.1:0", on_bytes, lambda state, why: None)
        await server.start()
        client = open_link(server.uri.replace("tcpin", "tcp"), on_bytes, on_state)
        await client.start()
        await up.wait()
        counts = await play(read_tlog(path), client, np.inf, progress=shares.append)
        await done.wait()
        assert (counts.sent, counts.lost) == (20000, 0)
        assert shares == sorted(shares)
        assert shares[-1] == 20000
        await client.close()
        await server.close()
        return bytes(heard)

    async def limited() -> bytes:
        async with asyncio.timeout(HANG_S):
            return await scenario()

    assert asyncio.run(limited()) == wanted


def test_a_link_that_is_down_loses_its_frames_and_the_play_ends(tmp_path: Path) -> None:
    recorded(tmp_path / "log.tlog", [FIRST_US, FIRST_US + 4])

    async def scenario() -> None:
        link = open_link("udpin:127.0.0.1:0", lambda *_: None, lambda *_: None)
        await link.start()
        counts = await play(read_tlog(tmp_path / "log.tlog"), link)
        assert (counts.sent, counts.lost) == (0, 2)
        await link.close()

    asyncio.run(scenario())


def test_no_frame_is_sent_before_it_is_due(tmp_path: Path) -> None:
    path = tmp_path / "log.tlog"
    recorded(path, [FIRST_US + 20_000 * i for i in range(6)])

    async def scenario() -> list[float]:
        loop, sent_s = asyncio.get_running_loop(), []
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind(("127.0.0.1", 0))
            uri = f"udpout:127.0.0.1:{sock.getsockname()[1]}"
            link = open_link(uri, lambda *_: None, lambda *_: None)
            await link.start()
            send = link.send

            def timed_send(frame: bytes) -> bool:
                sent_s.append(loop.time() - begin_s)
                return send(frame)

            link.send = timed_send  # type: ignore[method-assign]
            begin_s = loop.time()
            await play(read_tlog(path), link, speed=2.0)
            await link.close()
        return sent_s

    sent_s = asyncio.run(scenario())
    assert len(sent_s) == 6
    assert all(at >= 0.01 * i - 1e-6 for i, at in enumerate(sent_s))


def test_the_command_plays_over_udp(tmp_path: Path) -> None:
    path = tmp_path / "log.tlog"
    wanted = recorded(path, [FIRST_US + 50_000 * i for i in range(8)])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(HANG_S)
        uri = f"udpout:127.0.0.1:{sock.getsockname()[1]}"
        command = [sys.executable, "-m", "ahrs_service.app.cli", "play", str(path)]
        player = subprocess.Popen(
            [*command, "--link", uri, "--speed", "2"], cwd=ROOT, stderr=subprocess.PIPE
        )
        heard = [sock.recv(300) for _ in range(8)]
        assert b"".join(heard) == wanted
        _, said = player.communicate()
    assert player.returncode == 0
    assert b"8 frames, 0.2 s" in said
    assert b"8 frames sent" in said


def test_the_command_waits_for_a_listener_that_calls(tmp_path: Path) -> None:
    path = tmp_path / "log.tlog"
    wanted = recorded(path, [FIRST_US, FIRST_US + 4])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    got: list[bytes] = []
    finished = threading.Event()

    def listen() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            # Not connected: a refused call must not hide the reply to the previous one.
            sock.settimeout(0.05)
            while len(got) < 2 and not finished.is_set():
                sock.sendto(b"hello", ("127.0.0.1", port))
                with contextlib.suppress(TimeoutError):
                    got.append(sock.recv(300))

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        assert main(["play", str(path), "--link", f"udpin:127.0.0.1:{port}"]) == 0
        listener.join(30)
    finally:
        finished.set()
        listener.join()
    assert b"".join(got) == wanted


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["missing.tlog", "--link", "udpout:127.0.0.1:14550"], 1, "missing.tlog"),
        (["log.tlog", "--link", "udp:127.0.0.1:14550"], 1, "no such kind of link 'udp'"),
    ],
)
def test_errors_are_one_line(
    arguments: list[str],
    code: int,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recorded(tmp_path / "log.tlog", [FIRST_US])
    monkeypatch.chdir(tmp_path)
    assert main(["play", *arguments]) == code
    assert says in capsys.readouterr().err


def test_a_speed_of_nothing_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["play", "log.tlog", "--link", "tcp:127.0.0.1:1", "--speed", "0"])
    assert "0 is not a number above 0" in capsys.readouterr().err
