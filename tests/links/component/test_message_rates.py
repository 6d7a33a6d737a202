import dataclasses
import itertools

import pytest

from ahrs_service.links.component.message_rates import ANSWER_S, Intervals
from ahrs_service.links.mavlink.codec import dialect
from ahrs_service.settings import LinkSettings, Settings

ACCEPTED = dialect.MAV_RESULT_ACCEPTED
DENIED = dialect.MAV_RESULT_DENIED
UNSUPPORTED = dialect.MAV_RESULT_UNSUPPORTED
SET_INTERVAL = dialect.MAV_CMD_SET_MESSAGE_INTERVAL


def with_imu_rate(rate_hz):
    return Settings(link=LinkSettings(imu_rate_hz=rate_hz))


def rates(conversation):
    return {rate.name: rate for rate in conversation.component.rates()}


def test_every_message_is_asked_once_granted_and_measured(converse):
    flight = converse()
    flight.run(30.0)
    wanted = {
        "HIGHRES_IMU": 200.0,
        "SCALED_IMU": 5.0,
        "ATTITUDE": 10.0,
        "VFR_HUD": 10.0,
        "LOCAL_POSITION_NED": 10.0,
        "GPS_RAW_INT": 10.0,
        "SYSTEM_TIME": 1.0,
        "SCALED_PRESSURE": 1.0,
    }
    found = rates(flight)
    assert {name: rate.granted_hz for name, rate in found.items()} == wanted
    for name, rate in found.items():
        assert rate.state == "granted"
        assert rate.measured_hz == pytest.approx(wanted[name], rel=0.21)
        assert rate.mean_hz == pytest.approx(wanted[name], rel=0.02)
    assert found["HIGHRES_IMU"].measured_hz == pytest.approx(200.0, rel=0.01)
    assert [len(flight.asked(name)) for name in wanted] == [1] * 8
    assert flight.events == [("info", "adopted vehicle 1/1 (ARDUPILOTMEGA)")]


@pytest.mark.parametrize(
    ("loop_hz", "wanted_hz", "asked_hz"),
    [
        (400.0, 400.0, [400, 333]),
        (400.0, 200.0, [200]),
        (50.0, 200.0, [200, 100, 50, 40]),
        (300.0, 1000.0, [1000, 400, 333, 250]),
    ],
)
def test_a_denied_rate_steps_down_to_what_the_loop_allows(converse, loop_hz, wanted_hz, asked_hz):
    flight = converse(loop_hz, settings=with_imu_rate(wanted_hz))
    flight.run(12.0)
    assert [rate for _, rate in flight.asked("HIGHRES_IMU")] == asked_hz
    imu = rates(flight)["HIGHRES_IMU"]
    assert imu.granted_hz == asked_hz[-1]
    assert imu.measured_hz == pytest.approx(asked_hz[-1], rel=0.02)
    denied = flight.texts(f"HIGHRES_IMU: {wanted_hz:.0f} Hz denied, {asked_hz[-1]} Hz granted")
    assert len(denied) == (len(asked_hz) > 1)


def test_the_denied_imu_is_settled_before_anything_else_is_asked(converse):
    flight = converse(50.0)
    flight.run(3.0)
    names = [int(message.param1) for _, message in flight.named("COMMAND_LONG")]
    assert names[:4] == [dialect.MAVLINK_MSG_ID_HIGHRES_IMU] * 4
    assert len(names) == 11


@pytest.mark.parametrize("result", [UNSUPPORTED, DENIED, dialect.MAV_RESULT_FAILED])
def test_a_refused_imu_message_falls_back_to_the_next_ones(converse, result):
    flight = converse()
    flight.refuse = {"HIGHRES_IMU": result, "SCALED_IMU": result}
    flight.run(20.0)
    found = rates(flight)
    assert found["RAW_IMU"].granted_hz == 200.0
    assert found["RAW_IMU"].measured_hz == pytest.approx(200.0, rel=0.02)
    assert [text.partition(" (")[0] for text in flight.texts("asking for")] == [
        "HIGHRES_IMU does not come",
        "SCALED_IMU does not come",
    ]


def test_a_message_refused_as_temperature_still_falls_back_as_imu(converse):
    flight = converse()
    flight.refuse = {"SCALED_IMU": UNSUPPORTED}
    flight.withhold = {"HIGHRES_IMU"}
    flight.run(20.0)
    assert flight.asked("RAW_IMU")[0][1] == 5
    assert rates(flight)["RAW_IMU"].granted_hz == 200.0


def test_an_imu_message_granted_that_never_comes_is_replaced(converse):
    flight = converse()
    flight.withhold = {"HIGHRES_IMU"}
    flight.run(20.0)
    assert rates(flight)["SCALED_IMU"].granted_hz == 200.0
    assert len(flight.texts("HIGHRES_IMU does not come (granted")) == 1
    assert len(flight.texts("does not come")) == 1


def test_a_slow_imu_is_not_mistaken_for_a_silent_one(converse):
    flight = converse(settings=with_imu_rate(0.5))
    flight.run(60.0)
    assert flight.texts("does not come") == flight.texts("asking again") == []
    assert rates(flight)["HIGHRES_IMU"].mean_hz == pytest.approx(0.5, rel=0.05)


def test_a_stall_of_the_link_costs_no_message(converse):
    flight = converse()
    flight.run(20.0)
    flight.cut = True
    flight.run(4.0)
    flight.cut = False
    flight.run(20.0)
    assert flight.texts("does not come") == flight.texts("asking again") == []
    assert rates(flight)["HIGHRES_IMU"].measured_hz == pytest.approx(200.0, rel=0.02)
    assert rates(flight)["HIGHRES_IMU"].state == "granted"


def test_a_lost_answer_is_asked_for_again(converse):
    flight = converse()
    flight.lose_acks = 2
    flight.run(10.0)
    times = [at_s for at_s, _ in flight.asked("HIGHRES_IMU")]
    assert len(times) == 3
    assert all(0.7 <= b - a < 0.8 for a, b in itertools.pairwise(times))
    confirmations = [message.confirmation for _, message in flight.named("COMMAND_LONG")]
    assert confirmations[:3] == [0, 1, 2]
    assert all(rate.granted_hz for rate in rates(flight).values())


def test_one_request_at_a_time_is_under_way(converse):
    flight = converse()
    flight.lose_acks = 5
    flight.run(30.0)
    asked = [(at_s, message.param1) for at_s, message in flight.named("COMMAND_LONG")]
    for (at_s, number), (next_s, next_number) in itertools.pairwise(asked[:6]):
        assert number == next_number or next_s - at_s >= ANSWER_S
    assert len({at_s for at_s, _ in asked}) == len(asked)


def test_late_answers_to_repeated_requests_are_not_those_of_the_next_one():
    """A radio link with 1 s round trip: both replies to the first request arrive, denied."""
    intervals = Intervals({"HIGHRES_IMU": 100.0, "ATTITUDE": 10.0})
    sent, on_the_way = [], []
    for now_s in (step * 0.05 for step in range(160)):
        for due_s, result in [item for item in on_the_way if item[0] <= now_s]:
            on_the_way.remove((due_s, result))
            intervals.on_ack(SET_INTERVAL, result, now_s)
        for message in intervals.tick(now_s, 1, 1):
            rate_hz = round(1e6 / message.param2)
            sent.append((message.param1, rate_hz))
            on_the_way.append((now_s + 1.0, DENIED if rate_hz == 100 else ACCEPTED))
    assert intervals.find("HIGHRES_IMU").granted_hz == 50.0
    assert intervals.find("ATTITUDE").granted_hz == 10.0
    assert len(sent) == 6


def test_an_autopilot_that_answers_nothing_is_asked_once_by_streams(converse):
    flight = converse()
    flight.deaf = True
    flight.run(100.0)
    streams = flight.named("REQUEST_DATA_STREAM")
    assert [message.req_stream_id for _, message in streams] == [
        dialect.MAV_DATA_STREAM_RAW_SENSORS,
        dialect.MAV_DATA_STREAM_EXTRA1,
        dialect.MAV_DATA_STREAM_EXTRA2,
        dialect.MAV_DATA_STREAM_POSITION,
        dialect.MAV_DATA_STREAM_EXTENDED_STATUS,
    ]
    assert {(m.target_system, m.target_component, m.start_stop) for _, m in streams} == {(1, 1, 1)}
    assert [m.req_message_rate for _, m in streams] == [50, 50, 50, 50, 5]
    assert streams[0][0] - 1000.0 < 18.5
    assert len(flight.texts("REQUEST_DATA_STREAM")) == 1
    assert {rate.state for rate in flight.component.rates()} == {"no answer"}


def test_an_autopilot_that_knows_no_such_command_is_asked_once_by_streams(converse):
    flight = converse()
    names = [rate.name for rate in flight.component.rates()]
    flight.refuse = dict.fromkeys([*names, "RAW_IMU"], UNSUPPORTED)
    flight.run(60.0)
    streams = flight.named("REQUEST_DATA_STREAM")
    assert len(streams) == 5
    assert streams[0][0] - 1000.0 < 2.0
    assert [len(flight.asked(name)) for name in ("ATTITUDE", "RAW_IMU")] == [1, 1]
    assert {rate.state for rate in flight.component.rates()} == {"unsupported"}


@pytest.mark.parametrize("name", ["HIGHRES_IMU", "VFR_HUD"])
def test_one_message_that_is_granted_closes_the_old_way(converse, name):
    flight = converse()
    names = {rate.name for rate in flight.component.rates()} | {"RAW_IMU"}
    flight.refuse = dict.fromkeys(names - {name}, UNSUPPORTED)
    flight.run(30.0)
    assert flight.named("REQUEST_DATA_STREAM") == []
    assert rates(flight)[name].granted_hz == rates(flight)[name].wanted_hz


def test_a_silent_autopilot_is_asked_less_and_less_often(converse):
    flight = converse()
    flight.deaf = True
    flight.run(190.0)
    times = [at_s for at_s, _ in flight.asked("HIGHRES_IMU")]
    rounds = [b - a for a, b in itertools.pairwise(times[2::3]) if b - a > 3.0]
    assert rounds == sorted(rounds)
    assert rounds[0] > 10.0
    assert len(times) <= 15


def test_after_a_restart_the_old_way_is_open_again(converse):
    flight = converse()
    flight.deaf = True
    flight.run(40.0)
    flight.boot()
    flight.run(40.0)
    assert len(flight.named("REQUEST_DATA_STREAM")) == 10


def test_a_gps_is_as_slow_as_it_is_and_asked_again_only_when_silent():
    intervals = Intervals({"GPS_RAW_INT": 10.0})
    number, asked = dialect.MAVLINK_MSG_ID_GPS_RAW_INT, []
    for tick in range(1200):
        now_s = 1000.0 + 0.05 * tick
        if intervals.tick(now_s, 1, 1):
            asked.append(now_s - 1000.0)
            intervals.on_ack(SET_INTERVAL, ACCEPTED, now_s)
        if tick % 20 == 7 and tick < 800:
            intervals.heard(number, now_s)
    assert asked[0] == 0.0
    assert 40.0 < asked[1] < 46.0
    assert intervals.find("GPS_RAW_INT").granted_hz == 10.0


def test_what_a_ground_station_resets_is_asked_again(converse, arrived):
    flight = converse()
    flight.run(20.0)
    slower = dialect.MAVLink_command_long_message(
        1, 1, SET_INTERVAL, 0, dialect.MAVLINK_MSG_ID_HIGHRES_IMU, 100_000, 0, 0, 0, 0, 0
    )
    reset_s = flight.now_s
    flight.autopilot.on_message(arrived(slower, 255, 190), flight.now_s - flight.boot_s)
    flight.run(20.0)
    assert [rate for _, rate in flight.asked("HIGHRES_IMU", reset_s)] == [200]
    (text,) = flight.texts("asking again")
    assert text.startswith("HIGHRES_IMU: 200 Hz granted, ")
    assert rates(flight)["HIGHRES_IMU"].state == "granted"
    assert rates(flight)["HIGHRES_IMU"].measured_hz == pytest.approx(200.0, rel=0.02)


def test_a_rate_that_never_comes_is_asked_again_with_back_off(converse):
    flight = converse()
    flight.withhold = {"VFR_HUD"}
    flight.run(190.0)
    times = [at_s for at_s, _ in flight.asked("VFR_HUD")]
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert 4 <= len(times) <= 6
    assert gaps == sorted(gaps)
    assert rates(flight)["VFR_HUD"].state.startswith("granted, yet 0.0 Hz")
    assert rates(flight)["ATTITUDE"].state == "granted"


def test_one_late_message_of_a_slow_stream_is_no_loss():
    intervals = Intervals({"SYSTEM_TIME": 1.0})
    number = dialect.MAVLINK_MSG_ID_SYSTEM_TIME
    asked = 0
    for step in range(2400):
        now_s = step * 0.05
        if step % 20 == 0 and step // 20 % 7:
            intervals.heard(number, now_s)
        for _ in intervals.tick(now_s, 1, 1):
            asked += 1
            intervals.on_ack(SET_INTERVAL, ACCEPTED, now_s)
    assert asked == 1
    assert list(intervals.events) == []


def test_a_restart_is_seen_by_its_clock_and_all_is_asked_anew(converse):
    flight = converse()
    flight.run(20.0)
    flight.boot()
    boot_s = flight.now_s
    flight.run(20.0)
    for name, rate in rates(flight).items():
        assert len(flight.asked(name, boot_s)) == 1, name
        assert rate.granted_hz == rate.wanted_hz
    assert flight.asked("HIGHRES_IMU", boot_s)[0][0] - boot_s < 2.0
    assert len(flight.texts("the autopilot restarted")) == 1
    assert flight.component.timesync.jumps == 1


def test_a_vehicle_lost_and_returned_is_asked_again(converse):
    flight = converse()
    flight.run(20.0)
    flight.cut = True
    flight.run(10.0)
    assert flight.texts("no heartbeat") == ["no heartbeat of the vehicle for 5 s"]
    assert {rate.measured_hz for rate in flight.component.rates()} == {0.0}
    assert {rate.granted_hz for rate in flight.component.rates()} == {None}
    silent_s = flight.now_s
    flight.run(5.0)
    assert [m.get_type() for at_s, m in flight.sent if at_s > silent_s] == ["HEARTBEAT"] * 5
    flight.cut = False
    back_s = flight.now_s
    flight.run(20.0)
    assert len(flight.texts("vehicle heard again")) == 1
    for name, rate in rates(flight).items():
        assert len(flight.asked(name, back_s)) == 1, name
        assert rate.measured_hz == pytest.approx(rate.wanted_hz, rel=0.21)
    assert rates(flight)["HIGHRES_IMU"].mean_hz == pytest.approx(200.0 * 40 / 55, rel=0.02)


def test_what_one_bad_second_takes_is_not_asked_again(converse):
    flight = converse()
    flight.run(20.0)
    flight.withhold = set(rates(flight))
    flight.run(1.8)
    flight.withhold = set()
    flight.run(10.0)
    assert flight.texts("asking again") == []


@pytest.mark.parametrize("target", [(1, 190), (255, 190), (2, 191), (0, 191), (1, 0)])
def test_answers_to_others_are_not_ours(converse, arrived, target):
    flight = converse()
    flight.lose_acks = 100
    flight.run(1.5)
    ack = dialect.MAVLink_command_ack_message(SET_INTERVAL, ACCEPTED, 0, 0, *target)
    flight.component.on_message(arrived(ack), flight.now_s)
    assert rates(flight)["HIGHRES_IMU"].granted_hz is None
    for sender in ((1, 2), (2, 1), (1, 191)):
        ours = dialect.MAVLink_command_ack_message(SET_INTERVAL, ACCEPTED, 0, 0, 1, 191)
        flight.component.on_message(arrived(ours, *sender), flight.now_s)
    assert rates(flight)["HIGHRES_IMU"].granted_hz is None
    flight.component.on_message(arrived(ours), flight.now_s)
    assert rates(flight)["HIGHRES_IMU"].granted_hz == 200.0


def test_an_answer_in_progress_is_waited_for():
    intervals = Intervals({"ATTITUDE": 10.0})
    assert len(intervals.tick(0.0, 1, 1)) == 1
    intervals.on_ack(SET_INTERVAL, dialect.MAV_RESULT_IN_PROGRESS, 0.5)
    assert intervals.tick(1.1, 1, 1) == []
    intervals.on_ack(SET_INTERVAL, ACCEPTED, 1.15)
    assert intervals.find("ATTITUDE").granted_hz == 10.0


def test_what_is_rejected_for_now_is_asked_again_at_the_same_rate(converse):
    flight = converse()
    flight.refuse = {"HIGHRES_IMU": dialect.MAV_RESULT_TEMPORARILY_REJECTED}
    flight.run(5.0)
    assert rates(flight)["HIGHRES_IMU"].state == "rejected for now"
    assert rates(flight)["ATTITUDE"].granted_hz == 10.0
    flight.refuse = {}
    flight.run(20.0)
    assert [rate for _, rate in flight.asked("HIGHRES_IMU")] == [200, 200]
    assert rates(flight)["HIGHRES_IMU"].granted_hz == 200.0
    assert flight.texts("denied") == flight.texts("does not come") == []


def test_what_is_always_rejected_for_now_is_asked_less_and_less_often(converse):
    flight = converse()
    flight.refuse = {"HIGHRES_IMU": dialect.MAV_RESULT_TEMPORARILY_REJECTED}
    flight.run(190.0)
    times = [at_s for at_s, _ in flight.asked("HIGHRES_IMU")]
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert gaps == pytest.approx([10.0, 20.0, 40.0, 80.0], abs=0.2)


def test_a_rate_of_zero_is_left_alone(converse):
    link = dataclasses.replace(LinkSettings(), temperature_rate_hz=0.0, aiding_rate_hz=0.0)
    flight = converse(settings=Settings(link=link))
    flight.run(5.0)
    assert set(rates(flight)) == {"HIGHRES_IMU", "SYSTEM_TIME", "SCALED_PRESSURE"}
    assert {m.param1 for _, m in flight.named("COMMAND_LONG")} == {
        dialect.MAVLINK_MSG_ID_HIGHRES_IMU,
        dialect.MAVLINK_MSG_ID_SYSTEM_TIME,
        dialect.MAVLINK_MSG_ID_SCALED_PRESSURE,
    }


def test_the_mean_spans_from_the_first_to_the_last_message():
    intervals = Intervals({"ATTITUDE": 10.0})
    rate = intervals.find("ATTITUDE")
    assert rate.mean_hz == 0.0
    number = dialect.MAVLINK_MSG_ID_ATTITUDE
    intervals.heard(number, 50.0)
    assert rate.mean_hz == 0.0
    for at_s in (51.0, 52.0, 60.0):
        intervals.heard(number, at_s)
    intervals.heard(dialect.MAVLINK_MSG_ID_HEARTBEAT, 99.0)
    assert rate.mean_hz == pytest.approx(0.3)
