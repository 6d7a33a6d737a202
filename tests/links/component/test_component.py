"""Which sender is our autopilot, and what our component announces."""

import itertools

import pytest

from ahrs_service.links.component.component import Component
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.settings import IntakeSettings, LinkSettings, PublishSettings, Settings
from tests.links.messages import ARDUPILOT, INVALID, estimate, heartbeat


@pytest.mark.parametrize("sender", [(1, 1), (1, 191), (7, 42), (255, 190), (3, 0)])
@pytest.mark.parametrize(
    ("autopilot", "name"), [(ARDUPILOT, "ARDUPILOTMEGA"), (12, "PX4"), (0, "GENERIC"), (250, "")]
)
def test_an_autopilot_is_known_by_its_heartbeat_alone(arrived, sender, autopilot, name):
    component = Component(Settings())
    component.on_message(arrived(heartbeat(autopilot), *sender), 0.0)
    assert component.vehicle == sender
    assert component.system == sender[0]
    assert component.component == 191
    ((level, text),) = component.drain_events()
    assert level == "info"
    assert text == f"adopted vehicle {sender[0]}/{sender[1]} ({name or 'autopilot'})"


@pytest.mark.parametrize(
    ("sender", "kind"),
    [
        ((255, 190), dialect.MAV_TYPE_GCS),
        ((1, 154), dialect.MAV_TYPE_GIMBAL),
        ((1, 1), dialect.MAV_TYPE_ONBOARD_CONTROLLER),
        ((1, 1), dialect.MAV_TYPE_FIXED_WING),
    ],
)
def test_who_is_no_autopilot_is_not_adopted(arrived, sender, kind):
    component = Component(Settings())
    component.on_message(arrived(heartbeat(INVALID, kind), *sender), 0.0)
    assert component.system == 0
    assert component.tick(1.0, "boot") == component.publish(estimate()) == []
    assert component.drain_events() == []


def test_no_other_message_makes_a_vehicle(arrived):
    component = Component(Settings())
    for message in (
        dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_timesync_message(0, 5),
        dialect.MAVLink_system_time_message(0, 5),
    ):
        for sender in ((1, 1), (0, 0)):
            foreign = arrived(message, *sender)
            assert component.on_message(foreign, 0.0) == []
            assert not component.is_vehicle(foreign)
    assert (component.system, component.traffic.vehicle) == (0, 0)


def test_a_vehicle_that_calls_itself_the_address_of_all_is_refused_once(arrived):
    component = Component(Settings(link=LinkSettings(system=5)))
    for _ in range(100):
        component.on_message(arrived(heartbeat(), 0, 1), 0.0)
    assert component.system == 0
    assert [level for level, _ in component.drain_events()] == ["warning"]


def test_the_system_of_the_settings_is_waited_for(arrived):
    component = Component(Settings(intake=IntakeSettings(system=4, component=1)))
    for sender in ((1, 1), (4, 2), (1, 1)):
        component.on_message(arrived(heartbeat(), *sender), 0.0)
    assert component.system == 0
    assert component.drain_events() == [
        ("info", "autopilot 1/1 is not the one of intake.system; ignored"),
        ("info", "autopilot 4/2 is not the one of intake.system; ignored"),
    ]
    component.on_message(arrived(heartbeat(), 4, 1), 0.0)
    assert component.vehicle == (4, 1)


def test_our_own_system_number_may_be_set(arrived):
    component = Component(Settings(link=LinkSettings(system=9, component=195)))
    component.on_message(arrived(heartbeat(), 4, 1), 0.0)
    assert (component.system, component.component, component.vehicle) == (9, 195, (4, 1))
    requests = [m for m in component.tick(0.0, "boot") if m.get_type() == "COMMAND_LONG"]
    assert (requests[0].target_system, requests[0].target_component) == (4, 1)
    ping = dialect.MAVLink_command_long_message(9, 195, 400, 0, 0, 0, 0, 0, 0, 0, 0)
    assert len(component.on_message(arrived(ping, 4, 1), 0.0)) == 1
    ping.target_system = 4
    assert component.on_message(arrived(ping, 4, 1), 0.0) == []


def test_a_second_vehicle_is_ignored_counted_and_reported_once(adopted, arrived):
    component = adopted()
    component.drain_events()
    for _ in range(50):
        component.on_message(arrived(heartbeat(), 2, 1), 1.0)
        component.on_message(arrived(dialect.MAVLink_timesync_message(0, 5), 2, 1), 1.0)
        component.on_message(arrived(heartbeat(INVALID), 1, 154), 1.0)
    assert component.vehicle == (1, 1)
    assert component.drain_events() == [("info", "autopilot 2/1 is also on this link; ignored")]
    traffic = component.traffic
    assert (traffic.vehicle, traffic.same_system, traffic.foreign) == (0, 50, 100)
    assert traffic.by_stranger == {(2, 1): 100, (1, 154): 50}


def test_a_flood_of_systems_takes_no_memory(adopted, arrived):
    component = adopted()
    for system, number in itertools.product(range(256), range(0, 256, 5)):
        if (system, number) != (1, 1):
            component.on_message(arrived(heartbeat(), system, number), 1.0)
    assert len(component.traffic.by_stranger) == 16
    assert component.traffic.foreign + component.traffic.same_system == 256 * 52
    assert len(component.drain_events()) <= 17
    assert component.vehicle == (1, 1)


def test_another_component_of_our_number_is_reported_once(adopted, arrived):
    component = adopted()
    component.drain_events()
    for _ in range(5):
        component.on_message(arrived(heartbeat(INVALID), 2, 191), 1.0)
    assert component.drain_events() == []
    for _ in range(5):
        component.on_message(arrived(heartbeat(INVALID), 1, 191), 1.0)
    ((level, text),) = component.drain_events()
    assert level == "warning"
    assert "another component 191 speaks on system 1" in text
    assert "set link.component" in text


def test_no_announcement_hides_a_second_vehicle(adopted, arrived):
    component = adopted()
    component.drain_events()
    for n in range(40):
        component.announce(f"state {n}", True, 0.1 * n)
    component.on_message(arrived(heartbeat(), 2, 1), 5.0)
    assert len(component.drain_events()) == 1


def test_the_heartbeat_comes_once_a_second_with_the_true_state(converse):
    flight = converse()
    flight.run(10.0, "boot")
    flight.run(10.0, "active")
    flight.run(10.0, "critical")
    beats = flight.named("HEARTBEAT")
    assert len(beats) == 30
    assert {round(b - a, 6) for (a, _), (b, _) in itertools.pairwise(beats)} <= {0.95, 1.0, 1.05}
    assert [message.system_status for _, message in beats] == [
        *[dialect.MAV_STATE_BOOT] * 10,
        *[dialect.MAV_STATE_ACTIVE] * 10,
        *[dialect.MAV_STATE_CRITICAL] * 10,
    ]
    assert {(m.type, m.autopilot, m.base_mode, m.mavlink_version) for _, m in beats} == {
        (dialect.MAV_TYPE_ONBOARD_CONTROLLER, INVALID, 0, 3)
    }


def test_late_ticks_cost_no_rate_and_a_stall_gives_no_burst(adopted):
    component = adopted()
    times = [n * 0.27 for n in range(400)] + [500.0 + n * 0.05 for n in range(200)]
    beats = [
        now_s
        for now_s in times
        for message in component.tick(now_s, "active")
        if message.get_type() == "HEARTBEAT"
    ]
    early = [now_s for now_s in beats if now_s < 200.0]
    assert len(early) == 108
    assert [now_s for now_s in beats if now_s > 200.0] == pytest.approx(
        [500.0 + n for n in range(10)], abs=0.051
    )


def test_before_the_adoption_there_is_only_the_call(arrived):
    component = Component(Settings())
    for now_s in range(100):
        component.announce("no vehicle heard", False, now_s)
        assert component.tick(float(now_s), "boot") == []
    call = arrived(component.call(), 1, 191)
    assert (call.type, call.autopilot, call.system_status) == (18, 8, dialect.MAV_STATE_BOOT)


def test_nothing_but_attitudes_is_published(adopted):
    component = adopted(Settings(publish=PublishSettings(0.0, 0.0, 0.0)))
    assert component.publish(estimate()) == []
    component = adopted()
    assert [m.get_type() for m in component.publish(estimate())] == ["ATTITUDE"]
