"""The truth file of a recording, read or refused."""

import json

import numpy as np
import pytest

from ahrs_service.app.files import truth_file
from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.errors import RecordingError


def recorded_for(seconds, rate_hz=100.0):
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    nothing = np.zeros((len(time_s), 3))
    series = Series(time_s, nothing)
    return Recorded(
        "a.tlog", time_s, nothing, nothing, series, series, series, *(Series() for _ in range(5))
    )


def test_a_truth_is_read_as_its_effects_and_what_has_no_equation(tmp_path):
    path = tmp_path / "a.truth.json"
    effects = [
        {"effect": "imu_time_offset", "params": {"offset_s": 0.01, "meaning": "late"}},
        {"effect": "unknown", "params": {"depends_on": "airspeed", "sensor": "accel"}},
        {"effect": "none", "params": {"note": "glitches"}},
    ]
    content = {"kind": "flight", "level": 1, "seconds": 20, "imu_rate_hz": 100, "effects": effects}
    path.write_text(json.dumps(content))
    truth = truth_file.read(path, recorded_for(20.0))
    assert [(effect.id, float(values["offset_s"])) for effect, values in truth.effects] == [
        ("imu_time_offset", 0.01)
    ]
    assert truth.outside == ("accel: something that depends on airspeed",)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seconds": 600}, "seconds 600, but a.tlog has 19.99; give the truth of this recording"),
        ({"imu_rate_hz": 200}, "imu_rate_hz 200, but a.tlog has 100"),
        ({"effects": [{"effect": "gyro_magic", "params": {}}]}, "gyro_magic is not in the catal"),
        ({"effects": [{"effect": "gyro_scale_factor"}]}, "no 'params'"),
        ({"effects": [{"effect": "gyro_scale_factor", "params": {}}]}, "has no scale_error"),
        (
            {"effects": [{"effect": "gyro_scale_factor", "params": {"scale_error": 1}}]},
            "scale_error: 1 has shape ()",
        ),
        ({"effects": 3}, "effects"),
    ],
)
def test_a_truth_of_another_recording_or_none_is_refused(tmp_path, changes, words):
    path = tmp_path / "a.truth.json"
    content = {"kind": "flight", "level": 1, "seconds": 20, "imu_rate_hz": 100, "effects": []}
    path.write_text(json.dumps(content | changes))
    with pytest.raises(RecordingError) as refused:
        truth_file.read(path, recorded_for(20.0))
    assert words in str(refused.value)
    assert str(path) in str(refused.value)
