"""The real daemon on real sockets and ptys while links, clocks and bytes go wrong."""

import asyncio
import dataclasses
import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ahrs_service.app.config_file import ConfigError
from ahrs_service.app.replay_log import replay_log
from ahrs_service.health import Health
from ahrs_service.records import Flag, Phase
from ahrs_service.settings import LinkSettings, RecorderSettings, Settings, ViewerSettings
from ahrs_service.simulation.scenario import make_flight
from links.autopilot import SimulatedAutopilot
from links.errors import LinkOpenError
from links.link import LinkState
from links.mavlink_codec import Encoder, dialect
from links.signing import Signer, key_from_text
from links.tlog import read_tlog

NO_MARKERS = bytes(0 if byte in (0xFD, 0xFE) else byte for byte in range(256))


def recorded_in(path: Path) -> Settings:
    return Settings(recorder=RecorderSettings(directory=str(path)))


def assert_replays(served: Any, path: Path) -> Any:
    result = replay_log(path)
    assert result.estimates.tobytes() == b"".join(served.estimates)
    assert result.summary.digest == served.digest
    return result


def names(vehicle: Any) -> list[str]:
    return [message.get_type() for message in vehicle.heard]


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


def test_a_stall_is_told_on_the_link_and_ends(
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
            # The working loop still turns, and says in its heartbeat that attitude is not there.
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
    """Wait until every message that the daemon wants was asked for and granted."""
    wanted = len(served.daemon.component.rates())
    await served.until(lambda: autopilot.counts.commands["SET_MESSAGE_INTERVAL ACCEPTED"] >= wanted)


def test_an_autopilot_that_restarts(live: SimpleNamespace, tmp_path: Path) -> None:
    """Its clock begins anew and it forgot what was asked of it."""
    path, flight = tmp_path / "session.tlog", make_flight("rest", 10.0, rate_hz=400.0)

    async def scenario() -> Any:
        async with live.session(recorded_in(path), "udpin", tmp_path) as (served, vehicle):
            for _ in range(2):
                autopilot = SimulatedAutopilot(flight.rows, flight.rate_hz)
                vehicle.answer = lambda message, to=autopilot: to.on_message(message, 1.0)
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
    # Its samples kept coming, so what was known of the attitude still holds.
    assert not (flags & Flag.REALIGNED).any()
    (running,) = np.nonzero(phase == Phase.RUNNING)
    assert running[0] < jumps[0]
    assert len(running) == len(phase) - running[0]
    attitudes = result.estimates["ned_from_body"]
    alike = np.abs(attitudes[jumps[0] :] @ attitudes[jumps[0] - 1])
    assert 2.0 * np.arccos(min(alike.min(), 1.0)) < np.radians(1.0)
    assert not any("aligning anew" in text for _, text in served.said)
    assert served.daemon.component.vehicle == (1, 1)


def damaged(frame: bytes, kind: int, noise: random.Random) -> bytes:
    """Return bytes that are no frame, of one of five kinds."""
    if kind == 0:
        # Without markers, so that none of it counts as a frame of unknown id.
        return noise.randbytes(noise.randrange(1, 60)).translate(NO_MARKERS)
    if kind == 1:
        return frame[: noise.randrange(10, len(frame))]
    if kind == 2:
        at = noise.randrange(10, len(frame))
        return frame[:at] + bytes([frame[at] ^ 1 << noise.randrange(8)]) + frame[at + 1 :]
    if kind == 3:
        return bytes([0xFD, 255, 0, 0, *noise.randbytes(3), 105, 0, 0])
    return bytes([0xFE, 255, 0, 1, 1, 27])


@pytest.mark.parametrize("kind", ["tcp", "serial", "udpin"])
def test_damage_between_good_frames(
    kind: str, live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path, noise = tmp_path / "session.tlog", random.Random(1)
    pieces: list[bytes] = []
    bad_bytes = 0
    for i, frame in enumerate(flight_frames):
        bad = b""
        if i % 3 == 0 and i < len(flight_frames) - 20:
            bad = damaged(frame, i // 3 % 5, noise)
        bad_bytes += len(bad)
        pieces.append(bad + frame)

    async def scenario() -> Any:
        async with live.session(recorded_in(path), kind, tmp_path) as (served, vehicle):
            for start in range(0, len(pieces), 50):
                for piece in pieces[start : start + 50]:
                    # Streams cut where they like.
                    cut = len(piece) // 2 if kind != "udpin" else len(piece)
                    for part in (piece[:cut], piece[cut:]):
                        while part and not vehicle.send(part):
                            await asyncio.sleep(0.001)
                # A forged length holds back what follows until so many bytes came.
                sent = sum(map(len, pieces[: start + 50]))
                await served.received(sent)
            await served.decoded(len(flight_frames))
        return served

    served = asyncio.run(scenario())
    result = assert_replays(served, path)
    counts = served.daemon.decoder.counts
    assert counts["frames"] == len(flight_frames)
    assert counts["garbage_bytes"] == bad_bytes
    assert counts["bad_crc"] > 0
    assert sum(result.recording.message_counts.values()) > len(flight_frames)


def test_a_flood_of_random_bytes(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path, noise = tmp_path / "session.tlog", random.Random(5)
    frames = flight_frames[:1000]

    async def scenario() -> Any:
        async with live.session(recorded_in(path), "udpin", tmp_path) as (served, vehicle):
            stranger = await live.Vehicle("udpin", tmp_path).prepare()
            await stranger.meet(served.daemon.link.uri)
            for start in range(0, len(frames), 50):
                before = served.daemon.link.counts.bytes_in
                for _ in range(50):
                    stranger.send(noise.randbytes(1000))
                await served.received(before + 50_000)
                await live.fly(served, vehicle, frames[start : start + 50])
            assert not stranger.heard
            await stranger.close()
        return served

    served = asyncio.run(scenario())
    assert_replays(served, path)
    assert served.frames == len(frames)
    counts = served.daemon.decoder.counts
    assert counts["garbage_bytes"] > 900_000
    assert served.daemon.component.vehicle == (1, 1)


def test_a_wrong_key_is_believed_in_nothing(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path, frames = tmp_path / "session.tlog", flight_frames[:500]
    settings = dataclasses.replace(recorded_in(path), link=LinkSettings(signing_key="right"))
    ahead = Signer(key_from_text("wrong"), 1, clock=lambda: 2**45)
    forged = [ahead.sign(frame) for frame in frames]
    right = Signer(key_from_text("right"), 1)

    async def scenario() -> Any:
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, [*forged, *frames])
            assert served.daemon.decoder.counts["bad_signature"] == 1000
            assert not served.estimates
            assert served.daemon.component.system == 0
            assert served.daemon.health.state is Health.NO_VEHICLE
            assert not list(tmp_path.glob("*.tlog"))
            # A forged stamp far ahead has not locked the right key out.
            await live.fly(served, vehicle, [right.sign(frame) for frame in frames])
            await served.until(lambda: "ATTITUDE" in names(vehicle))
        return served

    served = asyncio.run(scenario())
    assert_replays(served, path)
    assert len(read_tlog(path).tables[1, 1, "HIGHRES_IMU"]) > 200
    assert served.daemon.drops()["bad_signature"] == 1000


def any_message(message_class: Any, noise: random.Random, for_us: bool) -> Any:
    """Return a message of a class with fields of random bytes, also NaN and infinities."""
    unpacked = message_class.unpacker.unpack(noise.randbytes(message_class.unpacker.size))
    values: list[Any] = []
    position = 0
    for name, length in zip(message_class.ordered_fieldnames, message_class.lengths, strict=True):
        value: Any = unpacked[position]
        if not isinstance(value, bytes) and length > 1:
            value = list(unpacked[position : position + length])
        position += 1 if isinstance(unpacked[position], bytes) else length
        if for_us and name in ("target_system", "target_component"):
            value = {"target_system": 1, "target_component": 191}[name]
        values.append(value)
    return message_class(*(values[place] for place in message_class.orders))


def test_every_message_with_any_content_is_survived(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path, noise = tmp_path / "session.tlog", random.Random(3)
    senders = [Encoder(1, 1), Encoder(255, 190), Encoder(1, 191)]
    strange = []
    for _ in range(2):
        for message_class in dialect.mavlink_map.values():
            for sender in senders:
                message = any_message(message_class, noise, noise.random() < 0.5)
                strange.append(sender.pack(message))
    noise.shuffle(strange)

    async def scenario() -> Any:
        async with live.session(recorded_in(path), "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, flight_frames[:800])
            await live.fly(served, vehicle, strange)
            await live.fly(served, vehicle, flight_frames[800:])
        return served

    served = asyncio.run(scenario())
    assert_replays(served, path)
    assert served.frames == len(flight_frames) + len(strange)
    assert np.isfinite(served.rows["ned_from_body"]).all()


def test_what_cannot_be_opened_ends_the_service_with_a_reason(
    live: SimpleNamespace, tmp_path: Path
) -> None:
    async def scenario() -> None:
        holder = await live.Vehicle("tcp", tmp_path).prepare()
        port = int(holder.uri.rpartition(":")[2])
        in_use = LinkSettings(uri=f"tcpin:127.0.0.1:{port}")
        with pytest.raises(LinkOpenError, match="cannot listen"):
            async with live.Served(Settings(link=in_use)):
                pass
        loopback = LinkSettings(uri="udpin:127.0.0.1:0")
        with pytest.raises(ConfigError, match=f"port {port}"):
            async with live.Served(Settings(link=loopback, viewer=ViewerSettings(port=port))):
                pass
        viewer = ViewerSettings(rrd=str(tmp_path / "missing" / "x.rrd"))
        with pytest.raises(ConfigError, match="cannot write"):
            async with live.Served(Settings(link=loopback, viewer=viewer)):
                pass
        await holder.close()

    asyncio.run(scenario())


def test_a_disk_that_takes_no_recording_costs_the_recording_alone(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    """The folder is a file, so not even root can write there; the flight goes on."""
    (tmp_path / "flights").write_text("no folder")

    async def scenario() -> Any:
        settings = recorded_in(tmp_path / "flights" / "in")
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, flight_frames[:500])
            await served.until(lambda: "ATTITUDE" in names(vehicle))
        return served

    served = asyncio.run(scenario())
    assert served.daemon.drops()["not_recorded"] == 500
    assert any(level == "warning" and "recording ended" in text for level, text in served.said)


def test_signing_stamps_that_cannot_be_kept_are_told(
    live: SimpleNamespace,
    flight_frames: list[bytes],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "file"))
    settings = Settings(link=LinkSettings(signing_key="secret"))
    signer = Signer(key_from_text("secret"), 1)

    async def scenario() -> Any:
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            signed = [signer.sign(frame) for frame in flight_frames[:300]]
            await live.fly(served, vehicle, signed)
            await served.until(lambda: "ATTITUDE" in names(vehicle))
        return served

    served = asyncio.run(scenario())
    assert any(level == "warning" and "signing" in text for level, text in served.said)
