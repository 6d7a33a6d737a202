"""`ahrs-service settings`: complete, with a meaning for each, and a file that reads back."""

import dataclasses
import re
from pathlib import Path

import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.files import config_file
from ahrs_service.app.settings.listing import heading, listed
from ahrs_service.settings import Settings

README = Path(__file__).resolve().parents[2] / "configs" / "README.md"
ROWS = {(row.section, row.name): row for row in listed(Settings())}


def test_every_field_of_every_section_is_there_with_a_meaning():
    fields = {
        (section.name, field.name)
        for section in dataclasses.fields(Settings)
        for field in dataclasses.fields(getattr(Settings(), section.name))
    }
    assert set(ROWS) == fields
    for row in ROWS.values():
        assert len(row.meaning) > 10, row
        assert heading(row.section)


def test_units_agree_with_the_names():
    """A name that ends in a unit has that unit."""
    ends = {"_hz": "Hz", "_mb": "MB", "_deg": "deg", "_m": "m", "_rad_s": "rad/s", "_m_s2": "m/s^2"}
    for row in ROWS.values():
        if row.name.endswith("_per_rtdegc_rad_s"):
            continue
        for end, unit in sorted(ends.items(), key=lambda pair: -len(pair[0])):
            if row.name.endswith(end):
                assert row.unit == unit, row
                break


@pytest.mark.parametrize(
    ("section", "name", "kind", "unit", "value"),
    [
        ("link", "component", "whole number 0 to 255", "", "191"),
        ("link", "uri", "text", "", '"udpin:127.0.0.1:14550"'),
        ("fusion", "gyro_sample", '"mean" or "instant"', "", '"instant"'),
        ("fusion", "magnetometer", "true or false", "", "true"),
        ("gate", "norm_m_s2", "number > 0", "m/s^2", "0.3"),
        ("gate_budget", "tilt_deg", "number > 0, <= 60 or none", "deg", "none"),
        ("multirotor", "drag_s", "3 numbers >= 0", "s", "[4.0, 4.0, 0.0]"),
    ],
)
def test_type_unit_and_value(section, name, kind, unit, value):
    row = ROWS[section, name]
    assert (row.kind, row.unit, row.value) == (kind, unit, value)


@pytest.mark.parametrize(
    "options",
    [[], ["--profile", "multirotor"], ["--set", "link.uri=tcp:10.0.0.1:5760"]],
)
def test_the_settings_file_reads_back(options, tmp_path, capsys):
    assert main(["settings", "--toml", *options]) == 0
    path = tmp_path / "config.toml"
    path.write_text(capsys.readouterr().out)
    profile = options[1] if "--profile" in options else None
    overrides = options[1:] if "--set" in options else []
    assert config_file.load(path) == config_file.load(None, overrides, profile)


def test_the_readme_shows_what_the_command_prints(capsys):
    assert main(["settings", "--markdown"]) == 0
    printed = capsys.readouterr().out.strip()
    block = re.search(r"<!-- settings -->\n(.*?)\n<!-- end -->", README.read_text(), re.DOTALL)
    assert block is not None
    assert block[1].strip() == printed, "write the output of `ahrs-service settings --markdown`"


def test_the_terminal_shows_every_name(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    assert main(["settings"]) == 0
    shown = capsys.readouterr().out
    assert "[gate_budget]" in shown
    for _, name in ROWS:
        assert name in shown
