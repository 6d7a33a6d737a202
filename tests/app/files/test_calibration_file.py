"""Calibration files: exact round trips, refusals in a sentence, and writing that leaves no half."""

import os
import stat
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ahrs_service.app.files import calibration_file
from ahrs_service.errors import ConfigError
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import NIL, Calibration, TriadCalibration
from ahrs_service.sensor.provenance import Provenance, SourceRecording, Uncertainty, Verdict

numbers = st.floats(-1e3, 1e3, allow_nan=False)
small = st.floats(-0.02, 0.02, allow_nan=False)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
HASH = "0123456789abcdef" * 4


def rows(elements, count, width):
    return st.lists(
        st.lists(elements, min_size=width, max_size=width).map(tuple),
        min_size=count,
        max_size=count,
    ).map(tuple)


@st.composite
def curves(draw, columns, elements=small, breaks=(-40.0, 0.1, 70.0)):
    if draw(st.booleans()):
        return Curve()
    powers = draw(st.integers(1, 4))
    # Over 70 K the cubic of a sane curve has coefficients this much smaller.
    scale = [70.0**-k for k in range(powers)]
    pieces = tuple(
        tuple(
            tuple(x * s for x, s in zip(column, scale, strict=True))
            for column in draw(rows(elements, columns, powers))
        )
        for _ in range(len(breaks) - 1)
    )
    return Curve(breaks, pieces)


@st.composite
def uncertainties(draw):
    count = draw(st.integers(0, 3))
    root = np.reshape(draw(st.lists(numbers, min_size=count**2, max_size=count**2)), (count, count))
    covariance = root @ root.T if count else np.zeros((0, 0))
    sigmas = st.one_of(st.none(), st.tuples(*[st.floats(0.0, 1.0)] * 3))
    return Uncertainty(
        bias_residual=draw(sigmas),
        bias_turn_on=draw(sigmas),
        bias_sigma=draw(curves(3)),
        scale_sigma=draw(curves(3)),
        parameters=tuple(f"bias.{i}" for i in range(count)),
        covariance=tuple(map(tuple, covariance.tolist())),
    )


@st.composite
def triads(draw, sensitive):
    matrix = np.eye(3) + np.array(draw(rows(small, 3, 3)))
    return TriadCalibration(
        matrix=tuple(map(tuple, matrix.tolist())),
        bias=draw(st.tuples(*[numbers] * 3)),
        a=draw(curves(3)),
        b=draw(curves(3)),
        c=draw(curves(3, numbers)),
        matrix_drift=draw(curves(9)),
        g_sensitivity=draw(rows(small, 3, 3)) if sensitive else NIL,
        thermal_lag_s=draw(st.floats(-3600.0, 3600.0)),
        model=draw(texts),
        uncertainty=draw(uncertainties()),
    )


calibrations = st.builds(
    Calibration,
    gyro=triads(True),
    accel=triads(False),
    serial=texts,
    uid=texts,
    source=texts,
    room_degc=numbers,
    provenance=st.builds(
        Provenance,
        date=st.sampled_from(["", "2024-05-31", "2024-05-31T10:00:00Z"]),
        procedures=st.lists(texts, max_size=3).map(tuple),
        recordings=st.lists(
            st.builds(SourceRecording, texts, st.just(HASH), texts), max_size=3
        ).map(tuple),
    ),
    verdict=st.builds(
        Verdict,
        st.booleans(),
        st.lists(texts, max_size=3).map(tuple),
        st.dictionaries(texts, numbers, max_size=3),
    ),
)


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(calibrations)
def test_a_round_trip_is_exact(calibration):
    text = calibration_file.to_toml(calibration)
    assert calibration_file.from_toml(text, "test") == calibration
    assert calibration_file.from_json(calibration_file.to_json(calibration), "x") == calibration


def example():
    breaks = np.linspace(-40.0, 70.0, 23)
    curve = Curve.linear(breaks, np.outer(np.sin(breaks / 30.0), (0.01, 0.02, -0.01)))
    return Calibration(
        gyro=TriadCalibration(bias=(0.01, -0.02, 0.003), c=curve, model="improved"),
        serial="A0042",
        provenance=Provenance("2024-05-31", ("six-position",), (SourceRecording("a.bin", HASH),)),
        verdict=Verdict(True, ("good over -40 to 70 degC",), {"condition": 1.2}),
    )


def test_the_file_is_read_by_people_too(tmp_path):
    path = tmp_path / "unit.toml"
    calibration_file.save(path, example())
    assert calibration_file.load(path) == example()
    text = path.read_text()
    assert 'serial = "A0042"' in text
    assert "[gyro.c]" in text
    assert "[[provenance.recordings]]" in text
    assert "accel" not in text
    assert len(tomllib.loads(text)["gyro"]["c"]["pieces"]) == 22
    assert len(text.splitlines()) < 60


def test_writing_replaces_whole_and_leaves_nothing_beside(tmp_path):
    path = tmp_path / "unit.toml"
    calibration_file.save(path, Calibration())
    calibration_file.save(path, example())
    assert calibration_file.load(path) == example()
    assert os.listdir(tmp_path) == ["unit.toml"]
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_a_place_that_cannot_be_written_is_reported_and_the_old_file_stays(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere/unit\.toml: cannot be written"):
        calibration_file.save(tmp_path / "nowhere" / "unit.toml", example())
    folder = tmp_path / "unit.toml"
    (folder / "inside").mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"unit\.toml: cannot be written"):
        calibration_file.save(folder, example())
    assert os.listdir(tmp_path) == ["unit.toml"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("serial = ", "not valid TOML"),
        ("serail = 'x'", "serail: no such field; known are gyro, accel, serial"),
        ("[gyro.c]\nknots = [1]", r"gyro\.c\.knots: no such field; known are breaks_degc, pieces"),
        ("[gyro]\nbias = [0.1, 'much', 0.0]", r"gyro\.bias\.1 = 'much'"),
        ("[gyro]\nbias = [0.1, nan, 0.0]", "gyro: bias = .*nan.*give 3 finite"),
        ("[accel]\nmatrix = [[1,0,0],[1,0,0],[1,0,0]]", "accel: matrix .* cannot be inverted"),
        ("[gyro.c]\nbreaks_degc = [1, 2]", r"gyro\.c: breaks_degc has 2 borders for 0 pieces"),
        ("[[provenance.recordings]]\nname = 'a'", r"recordings\.0\.sha256: is missing"),
        ("[verdict.figures]\nx = inf", r"figures\.x = inf"),
    ],
)
def test_what_is_wrong_is_reported_with_file_and_field(text, words, tmp_path):
    path = tmp_path / "unit.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as refused:
        calibration_file.load(path)
    assert str(path) in str(refused.value)
    assert len(str(refused.value)) < 400


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        calibration_file.load(tmp_path / "none.toml")
    path = tmp_path / "unit.toml"
    Path(path).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not valid TOML"):
        calibration_file.load(path)
