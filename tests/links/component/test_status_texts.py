"""STATUSTEXT: chunks, the rate of texts, repeated texts."""

import itertools

import pytest

from ahrs_service.links.component.status_texts import StatusTexts
from ahrs_service.links.mavlink.codec import Encoder, decode_frame, dialect


def said(texts, start_s, end_s):
    """(time, severity, text) put together from the chunks, tick by tick."""
    out = []
    for n in range(round((end_s - start_s) / 0.05)):
        now_s = start_s + 0.05 * n
        parts = texts.tick(now_s)
        frames = [decode_frame(Encoder(1, 191).pack(part)) for part in parts]
        if frames:
            assert [frame.chunk_seq for frame in frames] == list(range(len(frames)))
            assert len({(frame.id, frame.severity) for frame in frames}) == 1
            assert (frames[0].id == 0) == (len(frames) == 1)
            assert all(len(frame.text) == 50 for frame in frames[:-1])
            text = "".join(frame.text for frame in frames)
            out.append((round(now_s, 3), frames[0].severity, text))
    return out


@pytest.mark.parametrize("length", [1, 43, 44, 45, 94, 95, 200, 244])
def test_long_texts_come_in_chunks_of_50_bytes(length):
    texts = StatusTexts()
    text = ("0123456789" * 30)[:length]
    texts.announce(text, True, 0.0)
    assert said(texts, 0.0, 0.1) == [(0.0, dialect.MAV_SEVERITY_INFO, f"AHRS: {text}")]


def test_a_text_without_end_is_cut_and_others_letters_are_marked():
    texts = StatusTexts()
    texts.announce("x" * 20_000, False, 0.0)
    texts.announce("zu heiß", False, 0.0)
    (_, severity, cut), (_, _, marked) = said(texts, 0.0, 2.0)
    assert (severity, cut) == (dialect.MAV_SEVERITY_WARNING, "AHRS: " + "x" * 244)
    assert marked == "AHRS: zu hei?"


def test_chunks_of_one_text_share_a_number_that_no_neighbour_has():
    texts = StatusTexts()
    numbers = []
    for n in range(66_000):
        texts.announce(f"{n:060}", True, float(n))
        numbers += [part.id for part in texts.tick(float(n))]
    assert len(numbers) == 132_000
    assert (min(numbers), max(numbers)) == (1, 65535)
    assert numbers[::2] == numbers[1::2]
    assert all(a != b for a, b in itertools.pairwise(numbers[::2]))


def test_one_text_a_second_and_a_burst_keeps_the_newest():
    texts = StatusTexts()
    for n in range(20):
        texts.announce(f"text {n}", True, 0.0)
    heard = said(texts, 0.0, 30.0)
    assert [at_s for at_s, _, _ in heard] == pytest.approx(list(range(8)), abs=0.3)
    assert [text for _, _, text in heard] == [f"AHRS: text {n}" for n in range(12, 20)]


def test_the_same_text_comes_at_most_every_30_s():
    texts = StatusTexts()
    heard = []
    for n in range(100):
        texts.announce("good", True, float(n))
        heard += said(texts, float(n), n + 1.0)
    assert [at_s for at_s, _, _ in heard] == [0.0, 30.0, 60.0, 90.0]


def test_the_last_word_is_what_holds_after_states_that_flicker():
    texts = StatusTexts()
    heard = []
    for n in range(11):
        texts.announce("good" if n % 2 == 0 else "degraded", n % 2 == 0, 2.0 * n)
        heard += said(texts, 2.0 * n, 2.0 * n + 2.0)
    assert [text for _, _, text in heard] == ["AHRS: good", "AHRS: degraded"]
    heard = said(texts, 22.0, 100.0)
    assert heard == [(30.0, dialect.MAV_SEVERITY_INFO, "AHRS: good")]


def test_announcements_reach_the_ground_through_the_tick(converse):
    flight = converse()
    flight.run(5.0)
    flight.component.announce("degraded; gap in the IMU data", False, flight.now_s)
    flight.run(5.0)
    ((_, message),) = flight.named("STATUSTEXT")
    assert message.text == "AHRS: degraded; gap in the IMU data"
    assert message.severity == dialect.MAV_SEVERITY_WARNING
