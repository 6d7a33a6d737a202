"""An autopilot that restarts, jumps in time, disappears and returns."""

import pytest

from ahrs_service.links.mavlink.codec import dialect

BOOT_WRAP_MS = 2**32


def system_time(component, arrived, boot_ms, sender=(1, 1), now_s=100.0):
    message = dialect.MAVLink_system_time_message(0, boot_ms)
    component.on_message(arrived(message, *sender), now_s)
    return [text for _, text in component.drain_events() if "restarted" in text]


def test_time_since_boot_that_goes_back_is_a_restart(adopted, arrived):
    component = adopted()
    for boot_ms in (60_000, 61_000, 60_500, 62_000):
        assert system_time(component, arrived, boot_ms) == []
    assert system_time(component, arrived, 500, (2, 1)) == []
    assert len(system_time(component, arrived, 500)) == 1
    assert system_time(component, arrived, 1500) == []


def test_time_since_boot_that_wraps_is_no_restart(adopted, arrived):
    component = adopted()
    for boot_ms in (BOOT_WRAP_MS - 1500, BOOT_WRAP_MS - 500, 500, 1500):
        assert system_time(component, arrived, boot_ms) == []
    component = adopted()
    assert system_time(component, arrived, BOOT_WRAP_MS - 100_000) == []
    assert len(system_time(component, arrived, 500)) == 1


def test_a_restart_is_reported_with_the_jump_of_its_clock(converse):
    flight = converse()
    flight.run(60.0)
    flight.withhold = {"SYSTEM_TIME"}
    flight.boot()
    flight.run(20.0)
    (text,) = flight.texts("clock jumped")
    assert text == "the autopilot's clock jumped by -60.0 s against ours"
    assert len(flight.texts("the autopilot restarted")) == 1
    assert flight.component.timesync.jumps == 1


def test_a_clock_that_leaps_ahead_is_no_restart(converse):
    flight = converse()
    flight.run(30.0)
    asked = len(flight.named("COMMAND_LONG"))
    flight.boot_s -= 100.0
    flight.run(20.0)
    assert flight.texts("clock jumped") == ["the autopilot's clock jumped by +100.0 s against ours"]
    assert flight.texts("restarted") == []
    assert len(flight.named("COMMAND_LONG")) == asked


def test_two_restarts_are_two(converse):
    flight = converse()
    for _ in range(3):
        flight.run(25.0)
        flight.boot()
    flight.run(10.0)
    assert len(flight.texts("the autopilot restarted")) == 3


def test_the_vehicle_comes_and_goes_often(converse):
    flight = converse()
    for _ in range(5):
        flight.run(12.0)
        flight.cut = True
        flight.run(8.0)
        flight.cut = False
    flight.run(12.0)
    assert len(flight.texts("no heartbeat")) == len(flight.texts("heard again")) == 5
    for rate in flight.component.rates():
        assert rate.granted_hz == rate.wanted_hz
    assert flight.texts("asking again") == []


@pytest.mark.parametrize("start_s", [0.0, 3e7, 1.7e9])
def test_the_zero_of_the_clock_does_not_matter(converse, start_s):
    flight = converse()
    flight.now_s = start_s
    flight.boot()
    flight.run(10.0)
    assert len(flight.named("HEARTBEAT")) == 10
    assert {rate.state for rate in flight.component.rates()} == {"granted"}
    assert flight.component.timesync.offset_ns is not None
