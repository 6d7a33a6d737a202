"""Signing against pymavlink's own, and against forgers, replays, restarts and wrong clocks."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.errors import SigningError
from ahrs_service.links.mavlink.codec import Encoder, dialect
from ahrs_service.links.mavlink.frames import strip_signature
from ahrs_service.links.mavlink.signing import (
    AHEAD_LIMIT,
    NEW_STREAM_AGE,
    SAVE_FRAMES,
    SAVE_PERIOD,
    TICKS_PER_S,
    Signer,
    clock_ticks,
    is_signed,
    key_from_text,
    message_id,
)

KEY = key_from_text("a passphrase")
NOW = 11 * 365 * 86400 * TICKS_PER_S


class Clock:
    def __init__(self, ticks: int = NOW) -> None:
        self.ticks = ticks

    def __call__(self) -> int:
        return self.ticks


def signer(link_id: int = 1, clock: Any = None, key: bytes = KEY, **options: Any) -> Signer:
    return Signer(key, link_id, clock=clock or Clock(), **options)


def peer(sign: bool, timestamp: int = NOW, link_id: int = 7) -> Any:
    """pymavlink as the other end, checking and signing with its own code."""
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    link.signing.secret_key = KEY
    link.signing.sign_outgoing = sign
    link.signing.link_id = link_id
    link.signing.timestamp = timestamp
    link.signing.allow_unsigned_callback = lambda mav, msgid: False
    return link


MESSAGES: list[Any] = [
    dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3),
    dialect.MAVLink_attitude_message(1000, 0.5, -0.25, 3.0, 0.0, 0.0, 0.0),
    dialect.MAVLink_statustext_message(6, b"aligned", 0, 0),
    dialect.MAVLink_encapsulated_data_message(1, list(range(1, 254))),
    dialect.MAVLink_command_ack_message(511, 0, 0, 0, 1, 1),
]


def frame_at(stamp: int, system: int = 1, link_id: int = 7, key: bytes = KEY) -> bytes:
    """A frame signed at `stamp` by someone who holds `key`."""
    sender = Signer(key, link_id, clock=Clock(stamp))
    return sender.sign(Encoder(system, 1).pack(MESSAGES[0]))


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.get_type())
def test_pymavlink_accepts_what_we_sign(message: Any) -> None:
    ours, theirs = Encoder(1, 191, signer()), peer(sign=False)
    for _ in range(3):
        (heard,) = theirs.parse_buffer(ours.pack(message))
        assert heard.get_type() == message.get_type()
        assert heard.get_signed()
        assert heard.to_dict() == message.to_dict()


@given(st.binary(min_size=253, max_size=253), st.integers(0, 2**16 - 1))
def test_pymavlink_accepts_any_payload_we_sign(data: bytes, sequence: int) -> None:
    message = dialect.MAVLink_encapsulated_data_message(sequence, list(data))
    (heard,) = peer(sign=False).parse_buffer(Encoder(1, 191, signer()).pack(message))
    assert heard.get_signed()
    assert bytes(heard.data) == data


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.get_type())
def test_we_accept_what_pymavlink_signs(message: Any) -> None:
    ours, theirs = signer(), peer(sign=True)
    for _ in range(3):
        assert ours.accept(message.pack(theirs))
    assert ours.counts.accepted == 3


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.get_type())
def test_a_stripped_frame_is_the_frame_before_it_was_signed(message: Any) -> None:
    plain = Encoder(1, 191).pack(message)
    signed = signer().sign(plain)
    assert is_signed(signed)
    assert len(signed) == len(plain) + 13
    assert strip_signature(signed) == plain
    assert strip_signature(plain) == plain
    assert message_id(signed) == message.get_msgId()
    assert signer().sign(signed) == signed


@given(st.integers(0, 2**31), st.data())
def test_a_frame_with_any_bit_changed_is_refused_and_changes_nothing(
    boot_ms: int, data: st.DataObject
) -> None:
    message = dialect.MAVLink_attitude_message(boot_ms, 0.5, -0.25, 3.0, 0.0, 0.0, 0.0)
    good = Encoder(1, 1, signer(7)).pack(message)
    bit = data.draw(st.integers(0, 8 * len(good) - 1))
    forged = bytearray(good)
    forged[bit // 8] ^= 1 << bit % 8
    ours = signer()
    assert not ours.accept(bytes(forged))
    assert ours.accept(good)


@given(st.binary(max_size=320))
def test_any_bytes_are_judged_without_an_error(data: bytes) -> None:
    ours = signer(allow_unsigned=())
    assert not ours.accept(data)
    assert not ours.accept(b"\xfd" + data)


@given(st.integers(0, 33))
def test_truncated_frames_are_refused(keep: int) -> None:
    good = frame_at(NOW)
    assert not signer(allow_unsigned=range(300)).accept(good[:keep])


def test_one_forged_stamp_ahead_locks_nobody_out() -> None:
    ours = signer()
    assert ours.accept(frame_at(NOW))
    assert not ours.accept(frame_at(NOW + 3600 * TICKS_PER_S, key=bytes(32)))
    assert ours.counts.bad_signature == 1
    assert ours.accept(frame_at(NOW + 1))


def test_stamps_must_rise_for_each_stream_alone() -> None:
    ours = signer()
    first = frame_at(NOW + 5)
    assert ours.accept(first)
    assert not ours.accept(first)
    assert not ours.accept(frame_at(NOW + 4))
    assert ours.accept(frame_at(NOW + 4, link_id=8))
    assert ours.accept(frame_at(NOW + 4, system=2))
    assert ours.accept(frame_at(NOW + 6))
    assert ours.counts.replayed == 2


@pytest.mark.parametrize(("age", "taken"), [(NEW_STREAM_AGE, True), (NEW_STREAM_AGE + 1, False)])
def test_a_new_stream_may_be_a_minute_old(age: int, taken: bool) -> None:
    ours = signer()
    assert ours.accept(frame_at(NOW - age)) is taken
    assert ours.counts.too_old == (not taken)


def test_a_sender_an_hour_ahead_is_heard_and_shuts_nobody_out() -> None:
    hour = 3600 * TICKS_PER_S
    ours = signer()
    assert ours.accept(frame_at(NOW + hour))
    assert ours.accept(frame_at(NOW, system=2))
    assert not ours.accept(frame_at(NOW + hour - 1))
    (heard,) = peer(sign=False, timestamp=NOW + hour).parse_buffer(
        Encoder(1, 191, ours).pack(MESSAGES[0])
    )
    assert heard.get_signed()


def test_a_stamp_that_would_run_the_counter_full_is_refused() -> None:
    ours = signer()
    assert not ours.accept(frame_at(NOW + AHEAD_LIMIT + 1))
    assert ours.counts.too_far_ahead == 1
    assert ours.accept(frame_at(NOW))


def test_our_own_frames_thrown_back_at_us_are_refused() -> None:
    ours = signer()
    sent = [ours.sign(Encoder(1, 191).pack(MESSAGES[0])) for _ in range(3)]
    assert not any(ours.accept(frame) for frame in sent)


def stamp_of(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


def test_stamps_rise_when_the_clock_stands_still_or_goes_back() -> None:
    clock = Clock()
    ours, plain = signer(clock=clock), Encoder(1, 191).pack(MESSAGES[0])
    stamps = [stamp_of(ours.sign(plain)) for _ in range(5)]
    clock.ticks -= 10_000
    stamps += [stamp_of(ours.sign(plain)) for _ in range(5)]
    clock.ticks += 30_000
    stamps.append(stamp_of(ours.sign(plain)))
    assert stamps[:10] == list(range(NOW, NOW + 10))
    assert stamps[10] == NOW + 20_000


@pytest.mark.parametrize("ahead", [0, 86400 * TICKS_PER_S])
@pytest.mark.parametrize("back", [0, 7 * 86400 * TICKS_PER_S])
@pytest.mark.parametrize("seconds", [0, 1, 29, 31, 100])
def test_no_stamp_is_used_again_after_a_crash(
    tmp_path: Path, ahead: int, back: int, seconds: int
) -> None:
    """The clock is set back by `back`, a peer was `ahead`, the crash comes without `save`."""
    clock, path = Clock(), tmp_path / "signing.json"
    plain = Encoder(1, 191).pack(MESSAGES[0])
    ours = signer(clock=clock, state_path=path)
    ours.accept(frame_at(NOW + ahead))
    last = stamp_of(ours.sign(plain))
    for _ in range(seconds * 10):
        clock.ticks += TICKS_PER_S // 10
        last = stamp_of(ours.sign(plain))
    clock.ticks += 1 - back
    again = signer(clock=clock, state_path=path)
    first = stamp_of(again.sign(plain))
    assert first > last
    assert first <= last + SAVE_PERIOD + SAVE_FRAMES


def test_crashing_again_and_again_does_not_run_ahead_of_the_clock(tmp_path: Path) -> None:
    clock, plain = Clock(), Encoder(1, 191).pack(MESSAGES[0])
    for _ in range(20):
        clock.ticks += 2 * TICKS_PER_S
        first = stamp_of(signer(clock=clock, state_path=tmp_path / "s.json").sign(plain))
    assert first == clock.ticks


def test_a_recorded_session_cannot_be_replayed_after_a_restart(tmp_path: Path) -> None:
    clock = Clock()
    ours = signer(clock=clock, state_path=tmp_path / "signing.json")
    recorded = [frame_at(NOW + i) for i in range(5)]
    assert all(ours.accept(frame) for frame in recorded)
    mine = ours.sign(Encoder(1, 191).pack(MESSAGES[0]))
    ours.save()
    clock.ticks -= 86400 * TICKS_PER_S
    again = signer(clock=clock, state_path=tmp_path / "signing.json")
    assert not any(again.accept(frame) for frame in [*recorded, mine])
    assert not again.accept(frame_at(NOW - 3600 * TICKS_PER_S, system=9))
    assert again.accept(frame_at(NOW + 6))


@pytest.mark.parametrize("text", ["", "{", "[]", '{"sent": 1}', '{"sent":1,"clock":1,"streams":1}'])
def test_a_damaged_state_is_counted_and_replaced(tmp_path: Path, text: str) -> None:
    path = tmp_path / "signing.json"
    path.write_text(text)
    ours = signer(state_path=path)
    assert ours.counts.state_failures == 1
    assert ours.accept(frame_at(NOW))
    ours.save()
    assert json.loads(path.read_text())["streams"] == [[1, 1, 7, NOW]]
    assert path.stat().st_mode & 0o077 == 0


def test_a_state_that_cannot_be_written_does_not_stop_signing(tmp_path: Path) -> None:
    ours = signer(state_path=tmp_path / "missing" / "signing.json")
    assert is_signed(ours.sign(Encoder(1, 191).pack(MESSAGES[0])))
    assert ours.counts.state_failures == 1


def test_unsigned_frames_are_refused_but_for_the_radio() -> None:
    radio = dialect.MAVLink_radio_status_message(100, 90, 100, 10, 10, 0, 0)
    old = dialect.MAVLink(None, srcSystem=51, srcComponent=68)
    ours = signer()
    assert ours.accept(Encoder(51, 68).pack(radio))
    assert ours.accept(radio.pack(old, force_mavlink1=True))
    assert not ours.accept(Encoder(1, 1).pack(MESSAGES[0]))
    assert not ours.accept(MESSAGES[0].pack(old, force_mavlink1=True))
    assert not signer(allow_unsigned=()).accept(Encoder(51, 68).pack(radio))
    assert ours.counts.unsigned == 2
    assert ours.counts.unsigned_allowed == 2


def test_keys_are_made_as_ground_stations_make_them() -> None:
    assert key_from_text("0123456789abcdef" * 4) == bytes.fromhex("0123456789abcdef" * 4)
    assert key_from_text(" grün\n") == hashlib.sha256("grün".encode()).digest()
    assert key_from_text("z" * 64) == hashlib.sha256(b"z" * 64).digest()
    with pytest.raises(SigningError, match="empty"):
        key_from_text("  ")
    with pytest.raises(SigningError, match="32 bytes, not 5"):
        Signer(b"short", 1)
    with pytest.raises(SigningError, match="256 is not between"):
        Signer(KEY, 256)


def test_the_clock_counts_from_2015() -> None:
    link = peer(sign=True)
    link.signing.timestamp = clock_ticks()
    assert Signer(KEY, 1).accept(MESSAGES[0].pack(link))
