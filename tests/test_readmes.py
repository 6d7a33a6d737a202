"""The documents: links that lead somewhere, commands that are understood, tables as the code is."""

import argparse
import importlib
import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest

from ahrs_service.app import cli
from ahrs_service.app.replay.export_columns import _schema
from ahrs_service.calibration import verdict
from ahrs_service.calibration.thermal import lag, smooth_choice
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.diagnosis.hypotheses import named_vs_unknown
from ahrs_service.diagnosis.judgement import classes, uncertainty
from ahrs_service.diagnosis.search import forward_search
from ahrs_service.effects.catalogue import EFFECTS
from ahrs_service.fusion import (
    alignment,
    ground_velocity,
    hard_iron,
    heading,
    plausibility,
    propagation,
    velocity_constraints,
)
from ahrs_service.links.component.component import _wanted
from ahrs_service.links.component.own_parameters import PARAMETERS
from ahrs_service.links.logs.reading_rules import RULES
from ahrs_service.links.logs.recording_formats import READERS
from ahrs_service.links.transport.registry import SCHEMES
from ahrs_service.records import Flag, Gate, ImuSource, Phase
from ahrs_service.sensor import thermometer
from ahrs_service.settings import Settings

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
LINKS = (ROOT / "links" / "README.md").read_text()
PLACES = [
    ".", "configs", "links", "tests/benchmarks",
    "ahrs_service/fusion", "ahrs_service/calibration", "ahrs_service/diagnosis",
]  # fmt: skip
READMES = [ROOT / place / "README.md" for place in PLACES]
each_readme = pytest.mark.parametrize("path", READMES, ids=PLACES)


def without_code(text):
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def anchors(path):
    """Anchors of a document's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", without_code(path.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def section(text, heading):
    """Lines below a heading, up to the next one."""
    found = re.search(rf"^#+ {re.escape(heading)}\n(.*?)(?=^#|\Z)", text, re.MULTILINE | re.DOTALL)
    assert found is not None, heading
    return found[1]


def rows(text, heading):
    """Cells of the first table below a heading, without its head."""
    lines = [line for line in section(text, heading).splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def words(cell):
    """Names in a cell that holds several."""
    return [word.strip("`") for word in cell.split(", ")]


def test_the_front_page_is_short():
    assert len(README.read_bytes()) < 10240
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert ROOT / project["readme"] == README


def test_the_two_commands_stand_where_the_checks_look_for_them():
    lines = README.read_text().splitlines()
    begun = [line for line in lines if line.startswith("    python3 -m venv .venv && ")]
    assert len(begun) == 2
    assert begun[0].endswith(".venv/bin/ahrs-service demo")
    assert begun[1].endswith(".venv/bin/python -m pytest")


@each_readme
def test_links_lead_somewhere(path):
    targets = re.findall(r"\]\(([^)]+)\)", without_code(path.read_text()))
    assert targets
    for target in targets:
        if target.startswith("https://"):
            continue
        name, _, anchor = target.partition("#")
        there = (path.parent / name).resolve() if name else path
        assert there.exists(), target
        assert there.is_relative_to(ROOT), target
        if anchor:
            document = there / "README.md" if there.is_dir() else there
            assert anchor in anchors(document), target


@each_readme
def test_scripts_that_are_named_exist(path):
    for name in re.findall(r"tests/benchmarks/\w+\.py", path.read_text()):
        assert (ROOT / name).is_file(), name


@each_readme
def test_no_line_of_prose_is_endless(path):
    for line in path.read_text().splitlines():
        assert line.startswith(("|", "![")) or len(line) <= 120, line


@each_readme
def test_no_document_mentions_a_machine(path):
    for folder in (ROOT.parent, Path.home(), Path(sys.prefix)):
        assert f"{folder}/" not in path.read_text()


def shown_commands():
    """Every command of ours in a block of shell, as words."""
    for path in READMES:
        for block in re.findall(r"```sh\n(.*?)```", path.read_text(), re.DOTALL):
            for line in block.splitlines():
                command = shlex.split(line, comments=True)
                if command[:1] == ["ahrs-service"]:
                    yield pytest.param(command[1:], id=line.split("#")[0].strip())


@pytest.mark.parametrize("command", list(shown_commands()))
def test_commands_that_are_shown_are_understood(command):
    module = importlib.import_module(cli.COMMANDS[command[0]][0])
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    parser.parse_args(command[1:])


def test_every_command_is_shown():
    shown = " ".join(path.read_text() for path in READMES)
    for name in cli.COMMANDS:
        assert f"ahrs-service {name}" in shown, name


@pytest.mark.parametrize(
    ("heading", "codes"),
    [("gate", Gate), ("flags", Flag), ("phase", Phase), ("source", ImuSource)],
)
def test_codes(heading, codes):
    observed = [(int(code), name) for code, name, _ in rows(LINKS, heading)]
    assert observed == [(value.value, name) for name, value in codes.__members__.items()]


def test_columns_of_exports():
    table = rows(LINKS, "Columns of CSV and Parquet")
    observed = {name: kind for names, kind, _, _ in table for name in words(names)}
    assert observed == {field.name: str(field.type) for field in _schema()}
    for names, _, unit, _ in table:
        plain = unit.replace("²", "2").replace("/", "_").lower()
        assert unit in ("1", "code", "ns") or plain in names, names


def test_messages_that_are_read():
    observed = {name for cells in rows(LINKS, "Messages received") for name in words(cells[0])}
    assert set(RULES) <= observed
    component = (ROOT / "links" / "component" / "component.py").read_text()
    handled = set(re.findall(r"MAVLINK_MSG_ID_(\w+)\): self\._on", component))
    assert handled
    assert handled <= observed


def test_messages_that_are_sent():
    observed = {name for cells in rows(LINKS, "Messages sent") for name in words(cells[0])}
    sent = set()
    for folder in ("component", "logs"):
        for path in (ROOT / "links" / folder).glob("*.py"):
            names = re.findall(r"MAVLink_(\w+)_message\(", path.read_text())
            sent |= {name.upper() for name in names}
    assert observed == sent


def test_messages_that_are_wanted():
    text = section(LINKS, "Messages sent")
    assert all(name in text for name in _wanted(Settings()))
    link = Settings().link
    assert link.component == 191
    assert "component id 191" in text


def test_parameters_and_their_ranges():
    observed = {
        cells[0].strip("`"): (cells[1].strip("`"), *map(float, cells[2].split(" to ")))
        for cells in rows(LINKS, "Parameters")
    }
    assert observed == {
        name: (f"{one.section}.{one.key}", one.low, one.high) for name, one in PARAMETERS.items()
    }


def test_links_and_formats():
    uris = {cells[0].strip("`").partition(":")[0] for cells in rows(LINKS, "Link URIs")}
    assert uris == set(SCHEMES)
    assert {cells[0].strip("`") for cells in rows(LINKS, "Recordings read")} == set(READERS)


def test_exit_codes():
    observed = {int(cells[0]) for cells in rows(LINKS, "Exit codes")}
    stated = re.compile(r"^ *(?:EXIT_\w+: Final|exit_code: ClassVar\[int\]) = (\d+)", re.MULTILINE)
    found = {
        int(code)
        for path in (ROOT / "ahrs_service").rglob("*.py")
        for code in stated.findall(path.read_text())
    }
    assert observed == found


def test_every_effect_is_in_the_table():
    text = (ROOT / "ahrs_service" / "diagnosis" / "README.md").read_text()
    observed = {(cells[0].strip("`"), cells[1]) for cells in rows(text, "The effects")}
    triads = {}
    for effect in EFFECTS.values():
        triads.setdefault(effect.name, set()).add(effect.triad)
    plain = {"imu": "both", "gyro": "gyro", "accel": "accelerometer"}
    assert observed == {
        (name, "each" if len(found) > 1 else plain[found.pop()]) for name, found in triads.items()
    }


@pytest.mark.parametrize(
    ("place", "words", "values"),
    [
        ("fusion", "update of {:g} s", [propagation.UPDATE_S]),
        (
            "fusion",
            "1-sigma {:g} m/s over {:g} s",
            [velocity_constraints.AIRSPEED_SIGMA_M_S, velocity_constraints.AIRSPEED_CORRELATION_S],
        ),
        ("fusion", "T is taken as right to {:.0f} %", [100.0 * velocity_constraints.DRAG_SHARE]),
        ("fusion", "({:g} by_drag)²", [velocity_constraints.DRAG_SHARE]),
        ("fusion", "({:g} velocity_sigma))²", [velocity_constraints.DRAG_LARGE]),
        ("fusion", "outlier beyond {:g} sigma", [ground_velocity.OUTLIER_SIGMA]),
        (
            "fusion",
            "({:g} m/s and faster, 1-sigma {:g} rad)",
            [ground_velocity.COURSE_SPEED_M_S, ground_velocity.COURSE_SIGMA_RAD],
        ),
        ("fusion", "variance = {:g}² + d²", [heading.AZIMUTH_SIGMA_RAD]),
        ("fusion", "undisturbed field over {:g} s", [heading.FOLLOW_S]),
        ("fusion", "two windows of {:g} s", [hard_iron.WINDOW_S]),
        ("fusion", "b walks by {:g} uT/sqrt(s)", [hard_iron.IRON_WALK_UT_RTS]),
        ("fusion", "explains the force better (by {:g} m/s²)", [alignment.HELD_M_S2]),
        ("fusion", "jumps by {:g} rad/s", [plausibility.SPIKE_RATE_RAD_S]),
        ("fusion", "g = {:g} m/s²", [STANDARD_GRAVITY_M_S2]),
        ("fusion", "wind: {:g}² t", [propagation.WIND_WALK_M_S_RTS]),
        (
            "calibration",
            "cut into {} contiguous blocks, dealt out to {} folds",
            [smooth_choice.SESSION_BLOCKS, smooth_choice.FOLDS],
        ),
        ("calibration", "within ±{:g} s", [lag.LARGEST_LAG_S]),
        ("calibration", "(1 + {:g} p s)", [thermometer.LEAD_GAIN]),
        ("calibration", "spans below {:g} degC", [verdict.SMALLEST_SPAN_K]),
        ("calibration", "a condition above {:g}", [verdict.LARGEST_CONDITION]),
        ("diagnosis", "A named effect needs a surprise of {:.1f} nats", [forward_search.ALARM]),
        ("diagnosis", "an unknown dependence {:g}", [forward_search.UNKNOWN_ALARM]),
        ("diagnosis", '"Clearly" is {:g} nats', [named_vs_unknown.CLEARLY]),
        ("diagnosis", "by the gains found (within {:g} nats", [classes.ALIKE]),
        ("diagnosis", "{:g}² max(marginal, blocks)", [uncertainty.CHOSEN]),
    ],
)
def test_numbers_of_the_theory_are_those_of_the_code(place, words, values):
    text = " ".join((ROOT / "ahrs_service" / place / "README.md").read_text().split())
    assert words.format(*values) in text
