"""One contract for every kind of link, against real sockets and a real pty at the other end."""

import asyncio
import time
from pathlib import Path

import pytest

from ahrs_service.links.transport.link import LinkState, receipt_clock
from ahrs_service.links.transport.registry import open_link
from tests.links.far_end import KINDS, STREAMS, Far, Heard, frame, joined, run


def test_receipt_clock_is_wall_time_with_two_low_bits_clear() -> None:
    stamps = [receipt_clock() for _ in range(2000)]
    assert stamps == sorted(stamps)
    assert not any(stamp & 3 for stamp in stamps)
    assert abs(stamps[0] / 1e6 - time.time()) < 60


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
                # An odd length, to make the system accept some frame in part.
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
                    patch.setattr("ahrs_service.links.transport.udp.PEER_SILENCE_S", -1.0)
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
