"""Frames to messages and back, for any bytes; pymavlink itself is the oracle."""

import struct
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ahrs_service.links.mavlink.codec import Decoder, Encoder, decode_frame, dialect

KNOWN_IDS = sorted(dialect.mavlink_map)
UNKNOWN_ID = 59_999
HEARTBEAT = dialect.MAVLink_heartbeat_message(1, 3, 81, 7, 4, 3)


def checksum(body: bytes, extra: int) -> bytes:
    crc = dialect.x25crc(body)
    crc.accumulate(bytes([extra]))
    return struct.pack("<H", crc.crc)


def frame_v2(msgid: int, payload: bytes, seq: int = 0, flags: int = 0, extra: int = -1) -> bytes:
    if extra < 0:
        extra = dialect.mavlink_map[msgid].crc_extra
    head = struct.pack("<BBBBBBHB", len(payload), flags, 0, seq, 1, 2, msgid & 0xFFFF, msgid >> 16)
    signature = b"\x07" + bytes(range(12)) if flags & 1 else b""
    return b"\xfd" + head + payload + checksum(head + payload, extra) + signature


def frame_v1(msgid: int, payload: bytes, seq: int = 0) -> bytes:
    head = struct.pack("<BBBBB", len(payload), seq, 1, 2, msgid)
    extra = dialect.mavlink_map[msgid].crc_extra
    return b"\xfe" + head + payload + checksum(head + payload, extra)


def parts(message: Any) -> dict[str, Any]:
    """All that a message holds; repr, since NaN is a value like any other."""
    content = dict(vars(message))
    content["_header"] = vars(content["_header"])
    return {name: repr(value) for name, value in content.items()}


@st.composite
def frames(draw: st.DrawFn) -> bytes:
    msgid = draw(st.sampled_from(KNOWN_IDS))
    payload = draw(st.binary(min_size=1, max_size=dialect.mavlink_map[msgid].unpacker.size))
    seq = draw(st.integers(0, 255))
    if msgid < 256 and draw(st.booleans()):
        return frame_v1(msgid, payload, seq)
    return frame_v2(msgid, payload, seq, draw(st.sampled_from([0, 1])))


def found(decoder: Decoder, data: bytes, cuts: list[int] | None = None) -> list[bytes]:
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts or []), len(data)]
    pieces = [data[a:b] for a, b in pairwise(edges)]
    return [frame for piece in pieces for _, frame in decoder.feed(piece)]


@pytest.mark.parametrize("kind", ["v1", "v2", "v2 signed", "v2 truncated", "v2 too long"])
def test_every_message_of_the_dialect_decodes_as_pymavlink_does(kind: str) -> None:
    oracle = dialect.MAVLink(None)
    random = np.random.default_rng(1)
    for msgid in KNOWN_IDS:
        size = dialect.mavlink_map[msgid].unpacker.size
        payload = random.bytes(size)
        if kind == "v1":
            if msgid > 255:
                continue
            frame = frame_v1(msgid, payload)
        elif kind == "v2 truncated":
            frame = frame_v2(msgid, payload[: max(1, size // 2)])
        elif kind == "v2 too long":
            frame = frame_v2(msgid, (payload + b"beyond the last field")[:255])
        else:
            frame = frame_v2(msgid, payload, flags=int(kind == "v2 signed"))
        ((message, raw),) = Decoder().feed(frame)
        assert raw == frame
        assert parts(message) == parts(oracle.decode(bytearray(frame))), message.get_type()


NUL_CHARACTER = frame_v2(dialect.MAVLINK_MSG_ID_TEST_TYPES, b"\x00")
"""pymavlink makes the field of one character empty, and cannot pack that again."""


@given(frames(), st.integers(1, 255), st.integers(0, 255))
@example(NUL_CHARACTER, 1, 2)
def test_what_is_packed_is_decoded(frame: bytes, system: int, component: int) -> None:
    message = decode_frame(frame)
    packed = Encoder(system, component).pack(message)
    ((again, raw),) = Decoder().feed(packed)
    assert raw == packed
    assert (again.get_srcSystem(), again.get_srcComponent()) == (system, component)
    assert repr(again.to_dict()) == repr(message.to_dict())


def test_the_encoder_counts_its_frames_and_uses_mavlink_2() -> None:
    encoder = Encoder(3, 191)
    packed = [encoder.pack(HEARTBEAT) for _ in range(300)]
    assert all(frame[0] == 0xFD for frame in packed)
    assert [frame[4] for frame in packed] == [i % 256 for i in range(300)]


@given(st.lists(frames(), max_size=8), st.lists(st.integers(0, 2000), max_size=12))
def test_chunking_changes_nothing(sent: list[bytes], cuts: list[int]) -> None:
    data = b"".join(sent)
    decoder = Decoder()
    assert found(decoder, data, cuts) == sent
    assert decoder.counts["frames"] == len(sent)
    assert decoder.counts["garbage_bytes"] == decoder.counts["bad_crc"] == 0


UNKNOWN_FRAMES = st.builds(
    frame_v2,
    st.just(UNKNOWN_ID),
    st.lists(st.sampled_from([0xFD, 0xFE, 0, 9]), min_size=1, max_size=60).map(bytes),
    extra=st.just(0),
)


@given(
    st.lists(st.one_of(frames(), UNKNOWN_FRAMES, st.binary(max_size=80)), max_size=10),
    st.lists(st.integers(0, 2000), max_size=12),
)
@settings(max_examples=200)
def test_counts_do_not_depend_on_chunking(pieces: list[bytes], cuts: list[int]) -> None:
    data = b"".join(pieces)
    whole, cut = Decoder(), Decoder()
    assert found(whole, data) == found(cut, data, cuts)
    assert whole.counts == cut.counts


@given(st.data())
@settings(max_examples=200)
def test_good_frames_after_any_damage_are_found(data: st.DataObject) -> None:
    before = b"".join(data.draw(st.lists(frames(), max_size=3)))
    damaged = bytearray(b"".join(data.draw(st.lists(frames(), min_size=1, max_size=3))))
    for position in data.draw(st.lists(st.integers(0, len(damaged) - 1), min_size=1, max_size=6)):
        damaged[position] ^= data.draw(st.integers(1, 255))
    after = data.draw(st.lists(frames(), min_size=1, max_size=4))
    # The padding ends what a damaged header might hold back.
    stream = bytes(damaged) + b"".join(after) + bytes(300)
    got = found(Decoder(), before + stream, data.draw(st.lists(st.integers(0, 2000), max_size=6)))
    assert got[len(got) - len(after) :] == after


@given(st.lists(st.binary(max_size=300), max_size=6), st.booleans())
def test_any_bytes_are_survived(pieces: list[bytes], datagrams: bool) -> None:
    decoder = Decoder(datagrams=datagrams)
    for piece in pieces:
        decoder.feed(piece)
    assert found(decoder, bytes(300) + Encoder(1, 1).pack(HEARTBEAT))


@pytest.mark.parametrize("marker", [b"\xfe", b"\xfd"])
def test_a_forged_length_swallows_nothing(marker: bytes) -> None:
    good = [frame_v2(30, bytes([i] * 28), seq=i) for i in range(20)]
    forged = marker + b"\xff\x00\x00\x00\x01\x01\x1e\x00\x00"
    for datagrams in (False, True):
        decoder = Decoder(datagrams=datagrams)
        assert found(decoder, forged + b"".join(good)) == good
        assert decoder.counts["garbage_bytes"] == len(forged)
        assert decoder.counts["bad_crc"] == 1


def test_a_pending_header_holds_back_at_most_280_bytes() -> None:
    decoder = Decoder()
    assert found(decoder, b"\xfd\xff\x01\x00\x00\x01\x01\x1e\x00\x00") == []
    frame = Encoder(1, 1).pack(HEARTBEAT)
    sent, got = 0, []
    while not got:
        got = found(decoder, frame)
        sent += len(frame)
    assert sent <= 280 + len(frame)
    assert len(got) * len(frame) == sent


def test_a_cut_datagram_does_not_eat_the_next() -> None:
    frame = Encoder(1, 1).pack(HEARTBEAT)
    decoder = Decoder(datagrams=True)
    assert found(decoder, frame[:-3]) == []
    assert found(decoder, frame) == [frame]
    assert decoder.counts["garbage_bytes"] == len(frame) - 3


def test_a_character_that_is_nul_is_a_frame_like_any_other() -> None:
    assert NUL_CHARACTER == b"\xfd\x01\x00\x00\x00\x01\x02hB\x00\x00\xd2\xf1"
    for datagrams in (False, True):
        decoder = Decoder(datagrams=datagrams)
        ((message, raw),) = decoder.feed(NUL_CHARACTER)
        assert (message.c, raw) == ("", NUL_CHARACTER)
        assert decoder.counts["frames"] == 1
        ((again, _),) = Decoder().feed(Encoder(1, 2).pack(message))
        assert again.to_dict() == message.to_dict()


def test_more_frames_than_the_scanner_takes_at_once() -> None:
    frame = Encoder(1, 1).pack(HEARTBEAT)
    for datagrams in (False, True):
        assert found(Decoder(datagrams=datagrams), frame * 5000) == [frame] * 5000


def test_bad_crc_is_counted_once_a_frame() -> None:
    frame = bytearray(frame_v2(30, bytes(range(1, 29))))
    frame[15] ^= 1
    decoder = Decoder()
    good = Encoder(1, 1).pack(HEARTBEAT)
    assert found(decoder, bytes(frame) * 3 + good) == [good]
    assert decoder.counts["bad_crc"] == 3
    assert decoder.counts["garbage_bytes"] == 3 * len(frame)


def test_unknown_ids_are_counted_and_hide_nothing() -> None:
    good = Encoder(1, 1).pack(HEARTBEAT)
    unknown = frame_v2(UNKNOWN_ID, b"\x01" * 20, extra=0)
    forged = frame_v2(UNKNOWN_ID, good + b"\x01", extra=0)
    decoder = Decoder()
    assert found(decoder, good + unknown + unknown + good) == [good, good]
    assert decoder.counts["unknown"] == 2
    assert decoder.counts["garbage_bytes"] == 0
    assert found(Decoder(), forged + good) == [good, good]


def test_frames_that_ask_for_an_unknown_feature_are_refused() -> None:
    decoder = Decoder()
    assert found(decoder, frame_v2(0, bytes(range(9)), flags=2)) == []
    assert decoder.counts["frames"] == 0
    assert decoder.counts["garbage_bytes"] > 0


class LinkSeven:
    """A signer that accepts frames of link id 7 and appends its own block."""

    def sign(self, frame: bytes) -> bytes:
        return frame + b"\x07" + bytes(12)

    def accept(self, frame: bytes) -> bool:
        return bool(frame[2] & 1) and frame[-13] == 7


def test_a_signer_judges_every_frame_and_signs_what_goes_out() -> None:
    signed = frame_v2(30, bytes([5] * 28), flags=1)
    forged = bytearray(signed)
    forged[-13] = 8
    decoder = Decoder(LinkSeven())
    ((message, raw),) = decoder.feed(signed + bytes(forged) + frame_v2(30, bytes([5] * 28)))
    assert raw == signed
    assert message.get_signed()
    assert message.get_link_id() == 7
    assert decoder.counts["bad_signature"] == 2
    assert Encoder(1, 1, LinkSeven()).pack(HEARTBEAT).endswith(b"\x07" + bytes(12))


def test_without_a_signer_a_signed_frame_is_taken_but_not_called_signed() -> None:
    ((message, raw),) = Decoder().feed(frame_v2(30, bytes([5] * 28), flags=1))
    assert len(raw) == 10 + 28 + 2 + 13
    assert not message.get_signed()
