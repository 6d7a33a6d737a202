"""Settings: what is accepted, and the errors for the rest."""

import dataclasses
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.app.files.config_file import from_json, load, to_json
from ahrs_service.errors import ConfigError
from ahrs_service.settings import GateSettings, LinkSettings, Settings

SECTIONS = [field.name for field in dataclasses.fields(Settings)]


def test_nothing_given_means_the_defaults():
    assert load() == Settings()


def test_a_file_and_the_command_line_above_it(tmp_path):
    path = tmp_path / "flight.toml"
    path.write_text('[gate]\nnorm_m_s2 = 0.7\nrate_rad_s = 1\n[link]\nuri = "tcp:10.0.0.1:5760"\n')
    settings = load(path, ["gate.norm_m_s2=0.9", "intake.imu_source=scaled_imu2"])
    assert settings.gate.norm_m_s2 == 0.9
    assert settings.gate.rate_rad_s == 1.0
    assert settings.link.uri == "tcp:10.0.0.1:5760"
    assert settings.intake.imu_source == "scaled_imu2"
    assert settings.publish == Settings().publish


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("gate.norm_m_s2=-1", ["gate.norm_m_s2", "-1", "greater than 0"]),
        ("gate.norm_m_s2=soft", ["gate.norm_m_s2", "'soft'", "number"]),
        ("gate.norm_m_s2=inf", ["gate.norm_m_s2", "finite"]),
        ("gate.norm_m_s2=nan", ["gate.norm_m_s2"]),
        ("gate.nrom_m_s2=1", ["gate.nrom_m_s2", "no such field", "norm_m_s2"]),
        ("gates.norm_m_s2=1", ["gates", "no such field", "gate"]),
        ("intake.system=256", ["intake.system", "256", "255"]),
        ("intake.imu_source=gyro", ["intake.imu_source", "'gyro'", "HIGHRES_IMU"]),
        ("intake.temperature_source=barometer", ["temperature_source", "'barometer'"]),
        ("viewer.port=70000", ["viewer.port", "70000", "65535"]),
        ("fusion.magnetometer=perhaps", ["fusion.magnetometer", "'perhaps'"]),
        ("norm_m_s2=1", ["--set norm_m_s2=1", "section.key=value"]),
        ("gate.norm_m_s2", ["section.key=value"]),
        ("gate.a.b=1", ["section.key=value"]),
        ("", ["section.key=value"]),
    ],
)
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(override, words):
    with pytest.raises(ConfigError) as caught:
        load(overrides=[override])
    for word in words:
        assert word in str(caught.value)


def test_every_wrong_setting_of_a_file_is_named_at_once(tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text("[gate]\nnorm_m_s2 = 0\nrate_rad_s = 'x'\n[extra]\na = 1\n")
    with pytest.raises(ConfigError) as caught:
        load(path)
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    assert all(line.startswith(f"{path}: ") for line in lines)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"gate = [", "not valid TOML"),
        (b"\xff\xfe", "not valid TOML"),
        (b"gate = 3\n", "gate"),
        (b"[gate]\n[gate]\n", "not valid TOML"),
    ],
)
def test_files_that_are_no_settings_are_named(tmp_path, content, words):
    path = tmp_path / "odd.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=words) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_files_that_cannot_be_read_are_named(tmp_path):
    for path in (tmp_path / "absent.toml", tmp_path):
        with pytest.raises(ConfigError, match="give a readable TOML file") as caught:
            load(path)
        assert str(path) in str(caught.value)


def test_a_section_that_the_file_made_a_value_takes_no_override(tmp_path):
    path = tmp_path / "odd.toml"
    path.write_text("gate = 3\n")
    with pytest.raises(ConfigError, match="gate is not a section"):
        load(path, ["gate.norm_m_s2=1"])


@given(
    norm=st.floats(0.001, 100.0),
    system=st.integers(0, 255),
    uri=st.text(max_size=40).filter(lambda text: text.isprintable()),
    magnetometer=st.booleans(),
)
def test_what_a_recording_carries_comes_back(norm, system, uri, magnetometer):
    settings = Settings()
    settings = dataclasses.replace(
        settings,
        gate=dataclasses.replace(settings.gate, norm_m_s2=norm),
        intake=dataclasses.replace(settings.intake, system=system),
        link=dataclasses.replace(settings.link, uri=uri),
        fusion=dataclasses.replace(settings.fusion, magnetometer=magnetometer),
    )
    assert from_json(to_json(settings), "here") == settings


def test_the_signing_key_never_leaves():
    settings = Settings(link=LinkSettings(signing_key="a secret of mine"))
    assert b"secret" not in to_json(settings)
    assert from_json(to_json(settings), "here").link.signing_key == ""


def test_equal_settings_are_equal_bytes_and_hold_every_section():
    assert to_json(Settings()) == to_json(Settings(gate=GateSettings()))
    assert set(json.loads(to_json(Settings()))) == set(SECTIONS)


@pytest.mark.parametrize("text", [b"", b"{", b"\xff", b"[1]", b'"x"', b"null", b'{"gate": 3}'])
def test_recorded_settings_that_are_damaged_are_an_error_with_a_name(text):
    with pytest.raises(ConfigError, match=r"flight\.tlog"):
        from_json(text, "flight.tlog")
