"""The real daemon on real sockets and ptys while links vanish, streams stall and clocks restart."""

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ahrs_service.health import Health
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.links.simulated.autopilot import SimulatedAutopilot
from ahrs_service.links.transport.link import LinkState
from ahrs_service.records import Flag, Phase
from ahrs_service.settings import LinkSettings, Settings
from ahrs_service.simulation.scenario import make_flight
from tests.live import assert_replays, names, recorded_in


@pytest.mark.parametrize("kind", ["tcp", "tcpin", "serial"])
def test_a_link_that_vanishes_and_returns(
    kind: str, live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path, half = tmp_path / "session.tlog", len(flight_frames) // 2

    async def scenario() -> Any:
        async with live.session(recorded_in(path), kind, tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, flight_frames[:half])
            vehicle.send(flight_frames[half][:9])
            port = 0 if kind == "serial" else int(served.daemon.link.uri.rpartition(":")[2])
            await vehicle.close()
            await served.until(lambda: served.daemon.link.state is LinkState.DOWN)
            sent, refused = served.daemon.session.published, served.daemon.session.not_sent
            await served.heard("health: no IMU data")
            again = await live.Vehicle(kind, tmp_path).prepare(port)
            await again.meet(served.daemon.link.uri)
            await served.until(lambda: served.daemon.link.state is LinkState.UP)
            await live.fly(served, again, flight_frames[half:])
            await served.until(lambda: "ATTITUDE" in names(again))
            assert served.daemon.session.published > sent
            assert served.daemon.session.not_sent >= refused
            await served.until(lambda: served.daemon.health.state is not Health.NO_IMU)
            await again.close()
        return served

    served = asyncio.run(scenario())
    result = assert_replays(served, path)
    # The counts of before are not lost, and the cut frame has not eaten a good one.
    assert served.frames == len(flight_frames)
    assert served.daemon.link.counts.connects == 2
    assert result.estimates["phase"][-1] == Phase.RUNNING
    assert served.daemon.drops()["garbage_bytes"] <= 9
    assert [level for level, text in served.said if "trying again" in text or "listening" in text]


def test_a_server_that_comes_later_and_goes_is_waited_for(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    async def scenario() -> None:
        first = await live.Vehicle("tcp", tmp_path).prepare()
        await first.close()
        settings = Settings(link=LinkSettings(uri=first.uri))
        async with live.Served(settings) as served:
            await served.heard("trying again")
            later = await live.Vehicle("tcp", tmp_path).prepare(int(first.uri.rpartition(":")[2]))
            await later.meet(first.uri)
            await live.fly(served, later, flight_frames[:200])
            await later.close()

    asyncio.run(scenario())


def test_a_udp_peer_that_falls_silent_and_returns_from_another_port(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path, half = tmp_path / "session.tlog", len(flight_frames) // 2

    async def scenario() -> Any:
        async with live.session(recorded_in(path), "udpin", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, flight_frames[:half])
            await served.until(lambda: "ATTITUDE" in names(vehicle))
            await vehicle.close()
            await served.heard("health: no IMU data")
            again = await live.Vehicle("udpin", tmp_path).prepare()
            await again.meet(served.daemon.link.uri)
            await live.fly(served, again, flight_frames[half:])
            await served.until(lambda: "ATTITUDE" in names(again))
            await again.close()
        return served

    served = asyncio.run(scenario())
    assert_replays(served, path)
    assert served.frames == len(flight_frames)


def test_a_stall_is_reported_on_the_link_and_ends(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    def texts(vehicle: Any) -> list[tuple[int, str]]:
        return [(m.severity, m.text) for m in vehicle.heard if m.get_type() == "STATUSTEXT"]

    async def scenario() -> Any:
        async with live.session(Settings(), "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, flight_frames[:400])
            await served.heard("health: no IMU data")
            assert served.daemon.health.state is Health.NO_IMU
            beats = names(vehicle).count("HEARTBEAT")
            text = (int(dialect.MAV_SEVERITY_WARNING), "AHRS: no IMU data")
            await served.until(lambda: text in texts(vehicle))
            # The loop still runs, and its heartbeat reports that there is no attitude.
            await served.until(lambda: names(vehicle).count("HEARTBEAT") > beats)
            beat = [m for m in vehicle.heard if m.get_type() == "HEARTBEAT"][-1]
            assert beat.system_status == dialect.MAV_STATE_CRITICAL
            count = len(served.estimates)
            await live.fly(served, vehicle, flight_frames[400:800])
            await served.until(lambda: len(served.estimates) > count)
            await served.until(lambda: served.daemon.health.state in (Health.GOOD, Health.DEGRADED))
        return served

    served = asyncio.run(scenario())
    assert ("warning", "health: no IMU data") in served.said


async def fly_autopilot(served: Any, vehicle: Any, autopilot: Any, seconds: float) -> None:
    """Fly from the start of the autopilot's time, faster than real time, frame by frame."""
    now_s = 0.0
    while now_s < seconds:
        taken, due = served.frames, autopilot.due(now_s)
        for frame in due:
            assert vehicle.send(frame)
        await served.decoded(taken + len(due))
        now_s += 0.02


async def granted(served: Any, autopilot: Any) -> None:
    """Wait until every message that the daemon needs was requested and granted."""
    wanted = len(served.daemon.component.rates())
    await served.until(lambda: autopilot.counts.commands["SET_MESSAGE_INTERVAL ACCEPTED"] >= wanted)


def answers_of(autopilot: Any) -> Any:
    """Its clock, by TIMESYNC, runs as ours does: on a slow machine it does not seem to restart."""
    clock = asyncio.get_running_loop().time
    begin_s = clock()

    def answer(message: Any) -> Any:
        is_sync = message.get_type() == "TIMESYNC"
        return autopilot.on_message(message, clock() - begin_s if is_sync else 1.0)

    return answer


def test_an_autopilot_that_restarts(live: SimpleNamespace, tmp_path: Path) -> None:
    """Its clock restarts and all requests are lost."""
    path, flight = tmp_path / "session.tlog", make_flight("rest", 10.0, rate_hz=400.0)

    async def scenario() -> Any:
        async with live.session(recorded_in(path), "udpin", tmp_path) as (served, vehicle):
            for _ in range(2):
                autopilot = SimulatedAutopilot(flight.rows, flight.rate_hz)
                vehicle.answer = answers_of(autopilot)
                await fly_autopilot(served, vehicle, autopilot, 1.1)
                await granted(served, autopilot)
                await fly_autopilot(served, vehicle, autopilot, 8.0)
                assert autopilot.counts.sent["HIGHRES_IMU"] > 1000
            await served.heard("the autopilot restarted; asking for its messages anew")
            await served.heard("the autopilot's clock jumped")
        return served

    served = asyncio.run(scenario())
    result = assert_replays(served, path)
    flags, phase = result.estimates["flags"], result.estimates["phase"]
    (jumps,) = np.nonzero(flags & Flag.CLOCK_JUMP)
    assert len(jumps) == 1
    # Its samples continued, so the attitude is still valid.
    assert not (flags & Flag.REALIGNED).any()
    (running,) = np.nonzero(phase == Phase.RUNNING)
    assert running[0] < jumps[0]
    assert len(running) == len(phase) - running[0]
    attitudes = result.estimates["ned_from_body"]
    alike = np.abs(attitudes[jumps[0] :] @ attitudes[jumps[0] - 1])
    assert 2.0 * np.arccos(min(alike.min(), 1.0)) < np.radians(1.0)
    assert not any("aligning anew" in text for _, text in served.said)
    assert served.daemon.component.vehicle == (1, 1)
