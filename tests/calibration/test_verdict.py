"""Refusals, warnings, and the round trip of a verdict through TOML and JSON."""

import json
import math
import tomllib

import pytest
from pydantic import TypeAdapter

from ahrs_service.calibration.verdict import (
    Finding,
    Level,
    TemperatureResidual,
    TriadVerdict,
    Verdict,
    judge,
    span_finding,
)


def triad(**changes):
    values = {
        "triad": "accel",
        "unit": "m/s^2",
        "count": 12,
        "rms_before": (0.1, 0.1, 0.1),
        "rms_after": (0.01, 0.01, 0.01),
        "condition": 3.0,
        "coverage": 0.8,
        "held_out_before": 0.1,
        "held_out_after": 0.02,
    }
    return TriadVerdict(**(values | changes))


def test_a_good_fit_is_used():
    verdict = judge("six-position", (triad(),))
    assert not verdict.is_refused
    assert verdict.words == "use"
    assert verdict.triads[0].gain == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"held_out_after": 0.11}, "held out got worse"),
        ({"held_out_before": 0.0}, "held out got worse"),
        ({"condition": 2000.0}, "take poses or turns in more directions"),
        ({"condition": math.nan}, "take poses or turns in more directions"),
        ({"standard_errors": {"bias x": math.inf, "bias y": 1.0}}, "say nothing about bias x"),
    ],
)
def test_what_would_do_harm_is_refused(changes, words):
    verdict = judge("multi-pose", (triad(**changes),))
    assert verdict.is_refused
    assert verdict.words.startswith("do not use: ")
    assert words in verdict.words


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"held_out_after": None}, "no gain is shown"),
        ({"condition": 100.0}, "hardly separable"),
        ({"coverage": 0.1}, "cover 10% of all directions"),
    ],
)
def test_what_is_doubtful_is_said(changes, words):
    verdict = judge("multi-pose", (triad(**changes),))
    assert not verdict.is_refused
    assert verdict.words.startswith("use with care: ")
    assert words in verdict.words


def test_a_small_span_is_refused_in_plain_words():
    verdict = judge("thermal", (triad(),), (span_finding((21.0, 29.0)),))
    assert verdict.words.startswith("do not use: span 8 degC")
    assert span_finding((21.0, 31.0)).level is Level.NOTE
    assert span_finding((math.nan, 31.0)).level is Level.REFUSAL


def test_a_verdict_survives_json_and_toml():
    verdict = Verdict(
        "thermal",
        (
            triad(
                by_temperature=(TemperatureResidual(20.0, 25.0, 7, (0.1, 0.2, 0.3)),),
                span_degc=(20.0, 45.0),
                standard_errors={"bias x": 1e-4},
                hysteresis=(0.0, 0.01, 0.02),
            ),
            triad(triad="gyro", unit="rad/s", held_out_before=None, held_out_after=None),
        ),
        (Finding(Level.WARNING, "a remark"),),
    )
    reader = TypeAdapter(Verdict)
    plain = json.loads(json.dumps(verdict.to_dict()))
    assert reader.validate_python(plain) == verdict
    lines = [f"{key} = {json.dumps(value)}" for key, value in plain.items() if key == "procedure"]
    assert tomllib.loads("\n".join(lines)) == {"procedure": "thermal"}
    assert "hysteresis" not in plain["triads"][1]
