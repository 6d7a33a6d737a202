import dataclasses
import math

import numpy as np
import pytest

from ahrs_service.app.files import config_file
from ahrs_service.links.component.component import Component
from ahrs_service.links.component.own_parameters import PARAMETERS, change, read
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.settings import Settings

REAL32 = dialect.MAV_PARAM_TYPE_REAL32
NAMES = list(PARAMETERS)


@pytest.fixture
def component(arrived):
    component = Component(Settings())
    component.on_message(arrived(dialect.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)), 0.0)
    component.drain_events()
    return component


@pytest.fixture
def ask(component, arrived):
    """Function that sends a message from the ground and returns the values that come back."""

    def ask(message, ticks=10):
        assert component.on_message(arrived(message, 255, 190), 1.0) == []
        values = []
        for _ in range(ticks):
            out = component.tick(1.0, "active")
            values.append([arrived(m, 1, 191) for m in out if m.get_type() == "PARAM_VALUE"])
        return values

    return ask


def flat(values):
    return [value for some in values for value in some]


def set_message(name, value, system=1, component=191, kind=REAL32):
    return dialect.MAVLink_param_set_message(system, component, name, value, kind)


def test_every_parameter_stands_in_the_settings_within_its_bounds():
    for name, parameter in PARAMETERS.items():
        assert len(name) <= 16
        assert name.isascii()
        section = getattr(Settings(), parameter.section)
        assert parameter.key in {field.name for field in dataclasses.fields(section)}
        assert parameter.low <= read(Settings(), name) <= parameter.high
        assert isinstance(read(Settings(), name), float)


@pytest.mark.parametrize("name", NAMES)
def test_both_bounds_are_settings_that_a_file_may_hold(name):
    for bound in (PARAMETERS[name].low, PARAMETERS[name].high):
        settings = change(Settings(), name, bound)
        assert read(settings, name) == bound
        parameter = PARAMETERS[name]
        loaded = config_file.load(None, [f"{parameter.section}.{parameter.key}={bound!r}"])
        assert read(loaded, name) == bound


def test_a_change_touches_one_setting():
    settings = change(Settings(), "AHRS_GATE_NORM", 1.5)
    assert settings.gate.norm_m_s2 == 1.5
    back = dataclasses.replace(
        settings, gate=dataclasses.replace(settings.gate, norm_m_s2=Settings().gate.norm_m_s2)
    )
    assert back == Settings()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("AHRS_GATE_NORM", math.nan, "AHRS_GATE_NORM = nan is not in 0.01..50"),
        ("AHRS_GATE_NORM", math.inf, "AHRS_GATE_NORM = inf"),
        ("AHRS_PUB_ATT", -1.0, "AHRS_PUB_ATT = -1 is not in 0..1000"),
        ("AHRS_NO", 1.0, "no parameter 'AHRS_NO'; known are AHRS_GATE_NORM, "),
    ],
)
def test_a_wrong_value_is_named_with_its_bounds(name, value, words):
    with pytest.raises(ValueError, match=words.replace(".", r"\.")):
        change(Settings(), name, value)


@pytest.mark.parametrize("target", [(1, 191), (1, 0), (0, 0), (0, 191)])
def test_the_list_comes_in_small_parts(ask, target):
    values = ask(dialect.MAVLink_param_request_list_message(*target))
    assert [len(some) for some in values] == [5, 2, *[0] * 8]
    assert [value.param_id for value in flat(values)] == NAMES
    assert [value.param_index for value in flat(values)] == list(range(7))
    assert {value.param_count for value in flat(values)} == {7}
    assert {value.param_type for value in flat(values)} == {REAL32}
    for value in flat(values):
        assert value.param_value == np.float32(read(Settings(), value.param_id))


def test_a_list_asked_for_without_end_still_comes_to_its_end(component, arrived):
    request = arrived(dialect.MAVLink_param_request_list_message(1, 191), 255, 190)
    seen = []
    for _ in range(3):
        for _ in range(100):
            component.on_message(request, 1.0)
        out = component.tick(1.0, "active")
        seen += [message.param_index for message in out if message.get_type() == "PARAM_VALUE"]
    assert set(seen) == set(range(7))


@pytest.mark.parametrize(
    "message",
    [
        dialect.MAVLink_param_request_read_message(1, 191, b"", 2),
        dialect.MAVLink_param_request_read_message(1, 191, b"AHRS_GATE_ANGAC", -1),
        dialect.MAVLink_param_request_read_message(1, 191, b"AHRS_PUB_ATT", 2),
    ],
)
def test_one_is_read_by_index_or_by_name(ask, message):
    (value,) = flat(ask(message))
    assert value.param_id == "AHRS_GATE_ANGAC"
    assert value.param_value == 2.0


@pytest.mark.parametrize(
    "message",
    [
        dialect.MAVLink_param_request_read_message(1, 191, b"", -1),
        dialect.MAVLink_param_request_read_message(1, 191, b"AHRS_PUB_ATT", 7),
        dialect.MAVLink_param_request_read_message(1, 191, b"AHRS_PUB_ATT", -2),
        dialect.MAVLink_param_request_read_message(1, 191, b"SYSID_THISMAV", -1),
        dialect.MAVLink_param_request_read_message(1, 191, b"\xff" * 16, -1),
        dialect.MAVLink_param_request_read_message(1, 1, b"AHRS_PUB_ATT", -1),
        dialect.MAVLink_param_request_read_message(2, 191, b"AHRS_PUB_ATT", -1),
        dialect.MAVLink_param_request_read_message(1, 0, b"AHRS_PUB_ATT", -1),
        dialect.MAVLink_param_request_list_message(1, 1),
        dialect.MAVLink_param_request_list_message(2, 0),
        dialect.MAVLink_param_request_list_message(255, 191),
        set_message(b"AHRS_PUB_ATT", 5.0, 1, 1),
        set_message(b"AHRS_PUB_ATT", 5.0, 2, 191),
        set_message(b"AHRS_PUB_ATT", 5.0, 0, 0),
    ],
)
def test_what_is_unknown_or_not_for_us_gets_no_answer(component, ask, message):
    assert flat(ask(message)) == []
    assert component.settings == Settings()


def test_a_value_set_is_in_force_and_answered(component, ask):
    (value,) = flat(ask(set_message(b"AHRS_GATE_NORM", 0.35)))
    assert value.param_value == np.float32(0.35)
    assert component.settings.gate.norm_m_s2 == 0.35
    assert component.drain_events() == [("info", "AHRS_GATE_NORM set to 0.35")]


@pytest.mark.parametrize("name", NAMES)
def test_a_value_at_its_bound_survives_32_bits(component, ask, name):
    for bound in (PARAMETERS[name].low, PARAMETERS[name].high):
        ask(set_message(name.encode(), bound))
        assert read(component.settings, name) == bound


def test_writing_back_what_was_read_changes_nothing(component, ask):
    before = component.settings
    for value in flat(ask(dialect.MAVLink_param_request_list_message(1, 191))):
        ask(set_message(value.param_id.encode(), value.param_value, kind=value.param_type))
    assert component.settings is before
    assert component.drain_events() == []


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 0.0, -1.0, 51.0, 3e38])
def test_a_refused_value_leaves_the_old_one_and_says_so(component, ask, value):
    before = component.settings
    (answer,) = flat(ask(set_message(b"AHRS_GATE_NORM", value)))
    assert answer.param_value == np.float32(before.gate.norm_m_s2)
    assert component.settings is before
    ((level, text),) = component.drain_events()
    assert level == "warning"
    assert text.startswith("PARAM_SET refused: AHRS_GATE_NORM = ")


def test_an_unknown_name_is_reported_and_not_answered(component, ask):
    assert flat(ask(set_message(b"AHRS_NO\0rest", 1.0))) == []
    ((level, text),) = component.drain_events()
    assert (level, text[:46]) == ("warning", "PARAM_SET refused: no parameter 'AHRS_NO'; kno")


def test_nothing_is_listed_before_a_vehicle_is_adopted(arrived):
    component = Component(Settings())
    for target in ((0, 0), (0, 191), (1, 191)):
        message = dialect.MAVLink_param_request_list_message(*target)
        assert component.on_message(arrived(message, 255, 190), 0.0) == []
    component.on_message(arrived(dialect.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)), 0.0)
    names = {message.get_type() for message in component.tick(0.0, "active")}
    assert "PARAM_VALUE" not in names


def texts_of(component, start_s, seconds):
    """STATUSTEXTs of a number of ticks, chunks put together."""
    texts = {}
    for tick in range(round(seconds / 0.05)):
        now_s = start_s + 0.05 * tick
        for message in component.tick(now_s, "active"):
            if message.get_type() == "STATUSTEXT":
                at_s = round(now_s, 2)
                texts[at_s] = texts.get(at_s, "") + message.text
    return texts


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        (b"AHRS_GATE_NORM", math.nan, "AHRS_GATE_NORM = nan is not in 0.01..50"),
        (b"AHRS_NO", 1.0, "no parameter 'AHRS_NO'; known are AHRS_GATE_NORM, "),
    ],
)
def test_a_refusal_is_reported_to_the_ground(component, arrived, name, value, reason):
    component.on_message(arrived(set_message(name, value), 255, 190), 1.0)
    (text,) = texts_of(component, 1.0, 20.0).values()
    assert text.startswith(f"AHRS: PARAM_SET refused: {reason}")


def test_a_value_that_is_taken_makes_no_text(component, arrived):
    component.on_message(arrived(set_message(b"AHRS_GATE_NORM", 1.0), 255, 190), 1.0)
    assert texts_of(component, 1.0, 5.0) == {}


def test_a_flood_of_refusals_is_sparse_and_holds_no_state_back(component, arrived):
    texts = {}
    for second in range(1, 41):
        for n in range(50):
            bad = set_message(b"AHRS_GATE_NORM", -1.0 - n - 100.0 * second)
            component.on_message(arrived(bad, 255, 190), float(second))
        if second in (10, 12):
            component.announce("degraded" if second == 10 else "good", second == 12, float(second))
        texts |= texts_of(component, float(second), 1.0)
    refusals = [at_s for at_s, text in texts.items() if "refused" in text]
    assert len(refusals) == 8
    assert {text: at_s for at_s, text in texts.items() if "refused" not in text} == {
        "AHRS: degraded": pytest.approx(10.0, abs=1.01),
        "AHRS: good": pytest.approx(12.0, abs=1.01),
    }
