"""Marks in the service's own recordings: settings, state, and who may set them."""

import pytest

from ahrs_service.app.files import config_file
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.errors import RecordingError
from ahrs_service.estimator import Estimator
from ahrs_service.links.logs.readings import from_message
from ahrs_service.links.logs.session_marks import MarkKind, mark_messages
from ahrs_service.links.mavlink.codec import Decoder, Encoder
from ahrs_service.records import READING_DTYPE, empty
from ahrs_service.settings import GateSettings, Settings
from tests.app.replay.conftest import BOOT_US, frames_of, live_digest, write


def marked(kind, data, received_us):
    encoder = Encoder(7, 191)
    return [(received_us, encoder.pack(message)) for message in mark_messages(kind, data)]


STRICT = Settings(gate=GateSettings(rate_rad_s=0.01))


def test_recorded_settings_hold_from_their_place_on(tmp_path):
    frames = frames_of()
    half = len(frames) // 2
    first = marked(MarkKind.SETTINGS, config_file.to_json(Settings()), frames[0][0])
    mark = marked(MarkKind.SETTINGS, config_file.to_json(STRICT), frames[half][0])
    path = write(tmp_path / "own.tlog", [*first, *frames[:half], *mark, *frames[half:]])
    estimator, decoder = Estimator(Settings()), Decoder()
    rows = empty(READING_DTYPE, 1)
    for n, (received_us, frame) in enumerate(frames):
        if n == half:
            estimator.configure(STRICT)
        for message, _ in decoder.feed(frame):
            if from_message(message, received_us * 1000, rows):
                estimator.take(rows)
    result = replay_log(path)
    assert result.summary.digest == estimator.digest.hexdigest()
    assert result.summary.digest != live_digest(frames)
    assert result.settings == STRICT
    assert result.summary.settings_origin == "those of the recording"


def test_marks_in_a_recording_that_is_not_ours_are_passed_over(tmp_path):
    """A ground station records messages of any sender: these must not change a replay."""
    frames = frames_of()
    mark = marked(MarkKind.SETTINGS, config_file.to_json(STRICT), frames[1][0])
    path = write(tmp_path / "theirs.tlog", [*frames[:1], *mark, *frames[1:]])
    assert replay_log(path).summary.digest == live_digest(frames)
    other = Encoder(7, 66)
    forged = [
        (frames[2][0], other.pack(message))
        for message in mark_messages(MarkKind.SETTINGS, config_file.to_json(STRICT))
    ]
    first = marked(MarkKind.SETTINGS, config_file.to_json(Settings()), frames[0][0])
    path = write(tmp_path / "ours.tlog", [*first, *frames[:2], *forged, *frames[2:]])
    assert replay_log(path).summary.digest == live_digest(frames)


def test_settings_given_win_over_the_recorded(tmp_path):
    frames = frames_of()
    mark = marked(MarkKind.SETTINGS, config_file.to_json(STRICT), frames[0][0])
    path = write(tmp_path / "own.tlog", [*mark, *frames])
    assert replay_log(path, Settings()).summary.digest == live_digest(frames)
    assert replay_log(path).summary.digest == live_digest(frames, STRICT)


def test_a_rotated_file_goes_on_from_the_recorded_state(tmp_path):
    frames = frames_of()
    half = len(frames) // 2
    first = replay_log(write(tmp_path / "whole.tlog", frames))
    before = replay_log(write(tmp_path / "before.tlog", frames[:half]))
    estimator = Estimator(Settings())
    estimator.take(before.recording.readings)
    mark = marked(MarkKind.STATE, estimator.save(), frames[half][0])
    after = replay_log(write(tmp_path / "after.tlog", [*mark, *frames[half:]]))
    joined = before.estimates.tobytes() + after.estimates.tobytes()
    assert joined == first.estimates.tobytes()


def test_a_state_of_another_version_is_refused_with_what_to_do(tmp_path):
    mark = marked(MarkKind.STATE, b"old" * 20, BOOT_US)
    path = write(tmp_path / "old.tlog", [*mark, *frames_of()])
    with pytest.raises(RecordingError, match=r"old\.tlog.*another layout.*--config"):
        replay_log(path)
