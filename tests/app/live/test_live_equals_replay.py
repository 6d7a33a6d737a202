"""A live session and the replay of its recording give the same bytes, in every kind of session."""

import asyncio
import contextlib
import dataclasses
import math
import os
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ahrs_service.app.files.config_file import to_json
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.errors import StateError
from ahrs_service.estimator import Estimator
from ahrs_service.intake import STATE_DTYPE as INTAKE_STATE
from ahrs_service.links.logs.session_marks import MarkKind, mark_messages
from ahrs_service.links.logs.tlog import read_tlog
from ahrs_service.links.logs.tlog_recording import recording_from_tlog
from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect
from ahrs_service.links.mavlink.signing import Signer, key_from_text
from ahrs_service.pipeline import STATE_DTYPE as PIPELINE_STATE
from ahrs_service.records import Gate, Phase
from ahrs_service.settings import (
    GateSettings,
    IntakeSettings,
    LinkSettings,
    RecorderSettings,
    Settings,
)
from tests.live import assert_replays

KINDS = ["udpin", "udpout", "tcp", "tcpin", "serial"]
MARK_IDS = {int(kind) for kind in MarkKind}


def recorded_in(path: Path, **more: Any) -> Settings:
    """Settings of a recorded session; a tight innovation gate makes a calm flight meet it too."""
    return Settings(
        gate=GateSettings(innovation_sigma=1.5),
        recorder=RecorderSettings(directory=str(path), **more),
    )


def frames_in(path: Path) -> list[bytes]:
    """Frames of a recording without the marks of the service."""
    log = read_tlog(path)
    assert not any(log.damaged.values())
    spans = zip(log.frames["offset"].tolist(), log.frames["length"].tolist(), strict=True)
    frames = [log.data[start : start + length].tobytes() for start, length in spans]
    return [frame for frame in frames if not is_own_mark(frame)]


def is_own_mark(frame: bytes) -> bool:
    number = int.from_bytes(frame[7:10], "little")
    return number == dialect.MAVLINK_MSG_ID_TUNNEL and int.from_bytes(frame[10:12], "little") in (
        MARK_IDS
    )


def with_company(frames: list[bytes]) -> list[bytes]:
    """Interleave frames of a ground station and of a second vehicle with its own IMU."""
    station, other = Encoder(255, 190), Encoder(2, 1)
    crowd = []
    for i, frame in enumerate(frames):
        crowd.append(frame)
        if i % 10 == 3:
            crowd.append(other.pack(imu(i * 1000)))
        if i % 100 == 5:
            crowd.append(other.pack(heartbeat()))
            crowd.append(station.pack(heartbeat(dialect.MAV_AUTOPILOT_INVALID)))
            crowd.append(station.pack(dialect.MAVLink_param_request_list_message(1, 1)))
    return crowd


def heartbeat(autopilot: int = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA) -> Any:
    return dialect.MAVLink_heartbeat_message(1, autopilot, 0, 0, 4, 3)


def imu(time_us: int, zacc: float = 9.0) -> Any:
    return dialect.MAVLink_highres_imu_message(
        time_us, 1.0, 2.0, zacc, 0.3, 0.2, 0.1, 0.1, 0.2, 0.3, 1000.0, 0.0, 0.0, 20.0, 0x1FFF
    )


@pytest.mark.parametrize("kind", KINDS)
def test_over_every_link(
    kind: str, live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path, frames = tmp_path / "session.tlog", with_company(flight_frames)

    async def scenario() -> Any:
        async with live.session(recorded_in(path), kind, tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, frames)
            await served.until(lambda: any(m.get_type() == "ATTITUDE" for m in vehicle.heard))
        return served

    served = asyncio.run(scenario())
    result = assert_replays(served, path)
    assert frames_in(path) == frames
    assert result.system == 1
    rows = served.rows
    assert 1500 < len(rows) <= 2000
    assert set(np.unique(rows["phase"])) == {Phase.ALIGNING, Phase.RUNNING}
    assert {Gate.OPEN, Gate.NORM, Gate.RATE, Gate.INNOVATION} <= set(np.unique(rows["gate"]))
    assert served.daemon.component.traffic.foreign > 400


def test_every_file_of_a_rotated_recording(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    folder = tmp_path / "flights"

    async def scenario() -> Any:
        settings = recorded_in(folder, rotate_mb=0.05)
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, flight_frames)
        return served

    served = asyncio.run(scenario())
    files = sorted(folder.iterdir())
    assert len(files) >= 4
    assert [frame for file in files for frame in frames_in(file)] == flight_frames
    parts = [replay_log(file) for file in files]
    assert all(len(part.estimates) for part in parts)
    assert b"".join(part.estimates.tobytes() for part in parts) == b"".join(served.estimates)
    assert all(part.system == 1 for part in parts)


def param_set(name: str, value: float) -> bytes:
    message = dialect.MAVLink_param_set_message(1, 191, name.encode(), value, 9)
    return Encoder(255, 190).pack(message)


@pytest.mark.parametrize("rotate_mb", [0.0, 0.02])
def test_a_gate_limit_changed_in_flight(
    rotate_mb: float, live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    folder = tmp_path / "flights"
    third = len(flight_frames) // 3

    async def scenario() -> Any:
        settings = recorded_in(folder, rotate_mb=rotate_mb)
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, flight_frames[:third])
            await live.fly(served, vehicle, [param_set("AHRS_GATE_NORM", 0.02)])
            await live.fly(served, vehicle, flight_frames[third : 2 * third])
            await live.fly(served, vehicle, [param_set("AHRS_GATE_NORM", 7.25)])
            await live.fly(served, vehicle, [param_set("AHRS_GATE_RATE", float("nan"))])
            await live.fly(served, vehicle, flight_frames[2 * third :])
            await served.heard("AHRS_GATE_NORM set to 7.25")
        return served

    served = asyncio.run(scenario())
    parts = [replay_log(file) for file in sorted(folder.iterdir())]
    assert (len(parts) > 1) == (rotate_mb > 0)
    assert b"".join(part.estimates.tobytes() for part in parts) == b"".join(served.estimates)
    assert parts[-1].settings.gate.norm_m_s2 == 7.25
    assert parts[-1].settings.gate.rate_rad_s == Settings().gate.rate_rad_s
    assert parts[-1].summary.settings_origin == "those of the recording"
    rows = served.rows
    closed = rows["gate"] & Gate.NORM != 0
    early, late = closed[700:1300], closed[1400:]
    assert early.mean() > 0.9
    assert late.mean() < 0.1
    if not rotate_mb:
        # The marks matter: with one setting for all of it the replay differs.
        (whole,) = folder.iterdir()
        other = replay_log(whole, Settings())
        assert other.estimates.tobytes() != b"".join(served.estimates)


def param_value(name: str, value: float) -> bytes:
    message = dialect.MAVLink_param_value_message(name.encode(), value, 9, 2, 0)
    return Encoder(1, 1).pack(message)


@pytest.mark.parametrize("rotate_mb", [0.0, 0.02])
def test_a_trim_that_is_reported_in_flight(
    rotate_mb: float, live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    folder = tmp_path / "flights"
    half = len(flight_frames) // 2
    trim = [param_value("AHRS_TRIM_X", 0.05), param_value("AHRS_TRIM_Y", -0.1)]

    async def scenario() -> Any:
        settings = recorded_in(folder, rotate_mb=rotate_mb)
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, [*flight_frames[:half], *trim, *flight_frames[half:]])
        return served

    served = asyncio.run(scenario())
    parts = [replay_log(file) for file in sorted(folder.iterdir())]
    assert (len(parts) > 1) == (rotate_mb > 0)
    estimates = b"".join(part.estimates.tobytes() for part in parts)
    assert estimates == b"".join(served.estimates)
    if not rotate_mb:
        (part,) = parts
        ours = part.estimates["accel_m_s2"]
        readings = part.recording.readings[part.positions]
        turned = np.abs(ours - readings["accel_m_s2"]).max(axis=1) > 0.3
        # Before the trim they differ by the estimated bias only, after it by 6 degrees of gravity.
        assert not turned[: len(turned) // 3].any()
        assert turned[-len(turned) // 3 :].all()


def test_a_signed_session_whose_recording_is_unsigned(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path, key = tmp_path / "session.tlog", key_from_text("a long secret")
    signer = Signer(key, 7)
    signed = [signer.sign(frame) for frame in flight_frames]
    settings = dataclasses.replace(
        recorded_in(path), link=LinkSettings(signing_key="a long secret")
    )

    async def scenario() -> Any:
        async with live.session(settings, "tcpin", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, signed)
            await served.until(lambda: any(m.get_type() == "ATTITUDE" for m in vehicle.heard))
        assert served.daemon.decoder.counts["bad_signature"] == 0
        return served, vehicle

    served, vehicle = asyncio.run(scenario())
    assert_replays(served, path)
    assert frames_in(path) == flight_frames
    assert len(served.rows) > 1500
    judge = Signer(key, 8)
    ours = [bytes(m.get_msgbuf()) for m in vehicle.heard]
    assert ours
    assert all(judge.accept(frame) for frame in ours)
    assert b"a long secret" not in path.read_bytes()


def marks_of(sender: tuple[int, int], kind: MarkKind, data: bytes) -> list[bytes]:
    encoder = Encoder(*sender)
    return [encoder.pack(message) for message in mark_messages(kind, data)]


@pytest.mark.parametrize("sender", [(1, 1), (1, 191), (255, 190)])
def test_marks_that_arrive_over_the_link_are_not_recorded(
    sender: tuple[int, int], live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    path = tmp_path / "session.tlog"
    wrong = dataclasses.replace(
        Settings(),
        intake=IntakeSettings(system=9),
        gate=dataclasses.replace(Settings().gate, norm_m_s2=40.0),
    )
    forged = marks_of(sender, MarkKind.SETTINGS, to_json(wrong))
    forged += marks_of(sender, MarkKind.STATE, Estimator(wrong).save())
    forged += marks_of(sender, MarkKind.STATE, b"not a state")
    tunnel = dialect.MAVLink_tunnel_message(0, 0, 1, 5, [7] * 128)
    harmless = Encoder(*sender).pack(tunnel)

    async def scenario() -> Any:
        async with live.session(recorded_in(path), "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, forged)
            await live.fly(served, vehicle, flight_frames[:2000])
            await live.fly(served, vehicle, [*forged, harmless])
            await live.fly(served, vehicle, flight_frames[2000:])
        return served

    served = asyncio.run(scenario())
    assert_replays(served, path)
    assert frames_in(path) == [*flight_frames[:2000], harmless, *flight_frames[2000:]]
    assert served.daemon.drops()["forged_marks"] == 2 * len(forged)


def test_the_recording_of_a_recording_that_is_played(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    """The marks of the first session must not rule in the second."""

    async def scenario(settings: Settings, frames: list[bytes]) -> Any:
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, frames)
        return served

    first, second = tmp_path / "first.tlog", tmp_path / "second.tlog"
    strict = dataclasses.replace(
        recorded_in(first), gate=dataclasses.replace(Settings().gate, norm_m_s2=0.1)
    )
    asyncio.run(scenario(strict, flight_frames))
    log = read_tlog(first)
    every_frame = live.frames_of(log, np.ones(len(log.frames), bool))
    served = asyncio.run(scenario(recorded_in(second), every_frame))
    result = assert_replays(served, second)
    assert result.settings.gate == recorded_in(second).gate


@pytest.fixture(scope="module")
def readings(simulated_tlog: Path) -> Any:
    return recording_from_tlog(simulated_tlog).readings[:6000]


@pytest.fixture(scope="module")
def uninterrupted(readings: Any) -> bytes:
    return Estimator(Settings()).take(readings).tobytes()


@given(cuts=st.lists(st.integers(0, 6000), min_size=1, max_size=4).map(sorted))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_a_state_saved_in_flight_goes_on_as_if_nothing_was(
    cuts: list[int], readings: Any, uninterrupted: bytes
) -> None:
    estimator, made, start = Estimator(Settings()), b"", 0
    for cut in [*cuts, len(readings)]:
        made += estimator.take(readings[start:cut]).tobytes()
        start, saved = cut, estimator.save()
        estimator = Estimator(Settings())
        estimator.restore(saved)
        assert estimator.save() == saved
    assert made == uninterrupted


def test_a_state_that_cannot_be_used_changes_nothing(readings: Any) -> None:
    estimator = Estimator(Settings())
    estimator.take(readings[:3000])
    saved = estimator.save()
    at_source = saved_offset("source", pipeline=False)
    at_phase, at_states, at_place, at_turn = map(
        saved_offset, ("phase", "states", "history_next", "update_s")
    )
    not_a_number = struct.unpack("<q", struct.pack("<d", math.nan))[0]
    bad = [
        b"",
        saved[:-1],
        saved + b"\0",
        bytes(len(saved)),
        os.urandom(len(saved)),
        bytes([saved[0] ^ 1]) + saved[1:],
        *(patched(saved, at_source, value) for value in (-1, 16, 2**40, -(2**63))),
        *(patched(saved, at_phase, value) for value in (-1, 3)),
        *(patched(saved, at_states, value) for value in (-1, 22, 2**40)),
        *(patched(saved, at_place, value) for value in (-1, 32, 2**40)),
        patched(saved, at_turn, not_a_number),
    ]
    for wrong in bad:
        with pytest.raises(StateError, match="start from the beginning"):
            estimator.restore(wrong)
        assert estimator.save() == saved


def patched(saved: bytes, offset: int, value: int) -> bytes:
    return saved[:offset] + struct.pack("<q", value) + saved[offset + 8 :]


def saved_offset(field: str, pipeline: bool = True) -> int:
    """Where the saved bytes hold a field of the pipeline's state, or of the intake's."""
    mark = 8
    if not pipeline:
        return mark + INTAKE_STATE.fields[field][1]
    return mark + INTAKE_STATE.itemsize + PIPELINE_STATE.fields[field][1]


@given(bits=st.lists(st.integers(0, 2**20), min_size=1, max_size=30), tail=st.binary(max_size=20))
@settings(max_examples=50, deadline=None)
def test_damaged_state_bytes_never_break_the_kernels(
    bits: list[int], tail: bytes, readings: Any
) -> None:
    estimator = Estimator(Settings())
    estimator.take(readings[:1000])
    saved = bytearray(estimator.save())
    for bit in bits:
        saved[bit // 8 % len(saved)] ^= 1 << bit % 8
    with contextlib.suppress(StateError):
        estimator.restore(bytes(saved) + tail)
    assert len(estimator.take(readings[1000:1200])) <= 200


def test_the_decoder_and_the_recording_hold_the_same_frames(flight_frames: list[bytes]) -> None:
    """The frames sent above decode to the intended messages, so the equality is meaningful."""
    decoder = Decoder()
    assert [frame for _, frame in decoder.feed(b"".join(flight_frames))] == flight_frames
