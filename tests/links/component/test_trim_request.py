"""The trim is requested until it is reported, from ArduPilot only."""

import itertools

import pytest

from ahrs_service.links.component.component import Component
from ahrs_service.links.component.trim_request import ATTEMPTS
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.settings import Settings

NAMES = ["AHRS_TRIM_X", "AHRS_TRIM_Y"]


def heartbeat(autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA):
    return dialect.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3)


def parameter(name):
    return dialect.MAVLink_param_value_message(name.encode(), 0.01, 9, 900, 17)


def requests(component, start_s, seconds, arrived=None):
    """(time, parameter) of what is asked; the vehicle's heart beats where `arrived` is given."""
    asked = []
    for tick in range(int(seconds * 20)):
        now_s = start_s + 0.05 * tick
        if arrived is not None and tick % 20 == 0:
            component.on_message(arrived(heartbeat()), now_s)
        for message in component.tick(now_s, "active"):
            if message.get_type() == "PARAM_REQUEST_READ":
                assert (message.target_system, message.target_component) == (1, 1)
                assert message.param_index == -1
                asked.append((now_s - start_s, message.param_id))
    return asked


def test_both_are_asked_once_where_they_are_answered(converse):
    flight = converse()
    flight.run(20.0)
    asked = [message.param_id for _, message in flight.named("PARAM_REQUEST_READ")]
    assert asked == NAMES
    assert flight.heard["PARAM_VALUE"] == 2


def test_only_the_one_that_is_missing_is_asked_again(arrived):
    component = Component(Settings())
    component.on_message(arrived(heartbeat()), 0.0)
    assert [name for _, name in requests(component, 0.0, 0.5)] == NAMES
    component.on_message(arrived(parameter("AHRS_TRIM_X")), 0.5)
    component.on_message(arrived(parameter("AHRS_TRIM_Y"), 2, 1), 0.5)
    assert [name for _, name in requests(component, 0.5, 0.9)] == ["AHRS_TRIM_Y"]
    component.on_message(arrived(parameter("AHRS_TRIM_Y")), 1.5)
    assert requests(component, 1.5, 3.0) == []


def test_who_does_not_answer_is_asked_ever_less_and_not_for_ever(arrived):
    component = Component(Settings())
    times = [at_s for at_s, name in requests(component, 0.0, 400.0, arrived) if name == NAMES[0]]
    assert len(times) == ATTEMPTS
    for n, (first, second) in enumerate(itertools.pairwise(times)):
        assert second - first == pytest.approx(2.0**n, abs=0.06)


@pytest.mark.parametrize("autopilot", [dialect.MAV_AUTOPILOT_PX4, dialect.MAV_AUTOPILOT_GENERIC])
def test_other_autopilots_have_no_trim_to_ask_for(arrived, autopilot):
    component = Component(Settings())
    component.on_message(arrived(heartbeat(autopilot)), 0.0)
    assert component.system == 1
    assert requests(component, 0.0, 2.0) == []


def test_after_a_restart_it_is_asked_again(converse):
    flight = converse()
    flight.run(15.0)
    flight.boot()
    flight.run(15.0)
    assert [message.param_id for _, message in flight.named("PARAM_REQUEST_READ")] == 2 * NAMES
