"""The real daemon among damaged, forged and strange bytes."""

import asyncio
import dataclasses
import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ahrs_service.health import Health
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.links.mavlink.signing import Signer, key_from_text
from ahrs_service.settings import LinkSettings
from tests.live import assert_replays, names, recorded_in

NO_MARKERS = bytes(0 if byte in (0xFD, 0xFE) else byte for byte in range(256))


def damaged(frame: bytes, kind: int, noise: random.Random) -> bytes:
    """Return bytes that are no frame, of one of five kinds."""
    if kind == 0:
        # Without start markers, which would count as frames of unknown id.
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
                # A forged length holds back the following bytes until that many arrived.
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
