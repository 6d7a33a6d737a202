"""Files as dataclasses: every error has the form `file: field = value: what to do`."""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import pytest
from annotated_types import Gt

from ahrs_service.app.files import toml_file
from ahrs_service.app.files.field_names import fields_at
from ahrs_service.errors import ConfigError
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.settings import Settings
from ahrs_service.simulation.script import Script


@dataclass(frozen=True)
class Inner:
    __pydantic_config__: ClassVar = {"extra": "forbid"}
    size: Annotated[float, Gt(0.0)]


@dataclass(frozen=True)
class Outer:
    __pydantic_config__: ClassVar = {"extra": "forbid"}
    one: Inner
    many: tuple[Inner, ...] = ()
    maybe: Inner | None = None
    names: dict[str, int] = field(default_factory=dict)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("one.size = 1.0\ntwo = 2", "F: two: no such field; known are one, many, maybe, names"),
        ("one.size = 1.0\none.width = 2", "F: one.width: no such field; known are size"),
        ("one.size = 1.0\nmany = [{ width = 2, size = 1.0 }]", "F: many.0.width: no such field; "
         "known are size"),
        ("one.size = 1.0\nmaybe = { width = 2, size = 1.0 }", "known are size"),
        ("many = []", "F: one: is missing; give it"),
        ("one = 3", "F: one = 3: write a table, [one]"),
        ("one.size = -1.0", "F: one.size = -1.0: Input should be greater than 0"),
        ("one.size = '" + 300 * "x" + "'", "F: one.size = '" + 99 * "x" + "...: Input should be"),
        ("one.size = ", "F: not valid TOML: "),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_form(text, line):
    with pytest.raises(ConfigError) as caught:
        toml_file.validate(toml_file.parse(text, "F"), Outer, "F")
    assert line in str(caught.value)


def test_each_problem_has_its_line():
    with pytest.raises(ConfigError) as caught:
        toml_file.validate({"one": {"size": -1.0}, "two": 2, "names": {"a": "b"}}, Outer, "F")
    assert len(str(caught.value).splitlines()) == 3
    assert all(line.startswith("F: ") for line in str(caught.value).splitlines())


@pytest.mark.parametrize(
    ("kind", "location", "names"),
    [
        (Settings, (), ["intake", "sensor"]),
        (Settings, ("gate_budget",), ["acceleration_m_s2", "tilt_deg"]),
        (Calibration, ("provenance", "recordings", 0), ["name"]),
        (Calibration, ("gyro", "c"), ["breaks_degc", "pieces"]),
        (Script, ("phases", 3), ["name", "seconds"]),
        (Outer, ("names", "a"), []),
        (Outer, ("nowhere",), []),
    ],
)
def test_the_fields_at_a_place_are_found(kind, location, names):
    found = fields_at(kind, location)
    assert found[: len(names)] == names
    assert bool(found) == bool(names)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(
        ConfigError, match=r"absent\.toml: No such file.*; give a readable TOML file"
    ):
        toml_file.read(tmp_path / "absent.toml")
    (tmp_path / "latin.toml").write_bytes(b'a = "\xe9"')
    with pytest.raises(ConfigError, match=r"latin\.toml: not valid TOML: "):
        toml_file.read(tmp_path / "latin.toml")


@pytest.mark.parametrize(("text", "why"), [(b"{", "no JSON"), (b"[1]", "is no table of fields")])
def test_json_that_is_no_table_is_refused(text, why):
    with pytest.raises(ConfigError, match=f"F: .*{why}"):
        toml_file.parse_json(text, "F")
