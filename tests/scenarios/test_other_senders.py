"""Other vehicles, ground stations, noise and forgery on the same link."""

import copy
import math
import random

import numpy as np
import pytest

from ahrs_service.app.files import config_file
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.links.logs.session_marks import MarkKind, mark_messages
from ahrs_service.settings import GateSettings, Settings

GROUND = (255, 190)


def ground_traffic(packed, messages, system, component):
    """The messages of a ground station, without end."""
    say = [
        messages.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
        messages.MAVLink_param_request_list_message(system, component),
        messages.MAVLink_command_long_message(system, component, 511, 0, 105, 5000, 0, 0, 0, 0, 0),
        messages.MAVLink_request_data_stream_message(system, component, 0, 10, 1),
        messages.MAVLink_manual_control_message(system, 100, -100, 500, 0, 1),
        messages.MAVLink_timesync_message(0, 123456789),
        messages.MAVLink_system_time_message(1_767_261_600_000_000, 77),
        # Some simulators pass an IMU through the ground station.
        messages.MAVLink_raw_imu_message(1, 500, 500, 500, 500, 500, 500, 0, 0, 0, 0, 6000),
        messages.MAVLink_vfr_hud_message(99.0, 99.0, 0, 0, 0.0, 0.0),
    ]
    return [packed(message, *GROUND) for message in say]


def as_another(packed, system, component):
    """The same frame from another sender, with another motion."""

    def make(frame):
        message = frame.message
        if frame.name == "HIGHRES_IMU":
            return [packed(turned(message), system, component)]
        return [packed(message, system, component)]

    return make


def turned(message):
    other = copy.copy(message)
    other.xgyro, other.zacc, other.temperature = 1.0, 5.0, 77.0
    return other


@pytest.mark.parametrize("other", ["another system", "another component"])
def test_a_second_vehicle_is_ignored(base, unedited, packed, other):
    system, component = base.vehicle
    sender = (system + 1, component) if other == "another system" else (system, component + 1)
    outcome = base.insert(as_another(packed, *sender)).replay()
    assert outcome.bytes == unedited(base).bytes
    assert outcome.summary.foreign >= len(unedited(base).estimates)
    assert outcome.result.system == system


def test_the_second_vehicle_is_taken_when_the_settings_say_so(flight, unedited, packed):
    make = as_another(packed, 9, 1)
    both = flight.edit(
        lambda frame: [type(frame)(frame.t_s, frame.received_us, *make(frame)), frame]
    )
    settings = config_file.load(overrides=[f"intake.system={flight.vehicle[0]}"])
    assert both.replay(settings).bytes == unedited(flight).bytes
    assert both.replay().result.system == 9


def test_ground_station_traffic_changes_nothing(base, unedited, packed, messages):
    frames = ground_traffic(packed, messages, *base.vehicle)
    count = [0]

    def talk(frame):
        count[0] += 1
        return [frames[count[0] % len(frames)]]

    assert base.insert(talk).replay().bytes == unedited(base).bytes


def test_damaged_and_forged_frames_are_counted_and_change_nothing(base, unedited, packed):
    chance = random.Random(3)

    def damage(frame):
        if frame.name != "HIGHRES_IMU" or chance.random() > 0.05:
            return []
        flipped = bytearray(frame.data)
        flipped[chance.randrange(10, len(flipped) - 2)] ^= 1 << chance.randrange(8)
        return [bytes(flipped)]

    edited = base.insert(damage)
    outcome = edited.replay()
    assert outcome.bytes == unedited(base).bytes
    assert outcome.summary.damaged["bad_crc"] == len(edited.frames) - len(base.frames)


def test_frames_of_another_dialect_are_no_frames(base, unedited, packed):
    def foreign(frame):
        if frame.name != "HIGHRES_IMU" or frame.t_s % 1.0 > 0.1:
            return []
        message = turned(frame.message)
        message.crc_extra = 1
        return [packed(message, *base.vehicle)]

    edited = base.insert(foreign)
    outcome = edited.replay()
    assert outcome.bytes == unedited(base).bytes
    assert outcome.summary.damaged["bad_crc"] == len(edited.frames) - len(base.frames)


def test_noise_between_frames_hides_none(base, unedited):
    chance = random.Random(4)
    noise = [0]

    def rustle(frame):
        if chance.random() > 0.1:
            return []
        # The first byte marks it as no frame; the others are arbitrary.
        data = b"\x55" + chance.randbytes(chance.randrange(1, 60))
        noise[0] += len(data)
        return [data]

    outcome = base.insert(rustle).replay()
    assert outcome.bytes == unedited(base).bytes
    damaged = outcome.summary.damaged
    assert damaged["garbage_bytes"] >= 0.8 * noise[0]


def test_a_cut_tail_costs_the_cut_frame_alone(base, unedited):
    last = next(one for one in reversed(base.frames) if one.name == "HIGHRES_IMU")
    outcome = base.replay(tail=bytes(8) + last.data[:-5])
    assert outcome.bytes == unedited(base).bytes
    assert outcome.summary.damaged == {"truncated_tail_bytes": len(last.data) + 3}


def test_the_live_service_computes_the_same_and_its_recording_too(base, unedited, packed, messages):
    frames = ground_traffic(packed, messages, *base.vehicle)
    count = [0]

    def talk(frame):
        count[0] += 1
        return [frames[count[0] % len(frames)]] if count[0] % 5 == 0 else []

    daemon, path = base.insert(talk).through_daemon()
    digest = unedited(base).summary.digest
    assert daemon.estimator.digest.hexdigest() == digest
    assert replay_log(path).summary.digest == digest


def test_a_damaged_stream_is_the_same_live_and_recorded(flight):
    start_s = 20.0
    chance = random.Random(5)

    def spoil(message):
        message.xgyro, message.yacc = chance.choice([(25.0, 0.0), (math.nan, 0.0), (0.0, math.nan)])

    edited = (
        flight.drop(("HIGHRES_IMU",), start_s, start_s + 2.0)
        .edit(lambda frame: [frame, frame], 30.0, 32.0)
        .insert(lambda frame: [b"\x55" + chance.randbytes(20)], 35.0, 37.0)
        .shift_clock(1000.0, 40.0)
        .change(("HIGHRES_IMU",), spoil, 45.0, 46.0)
        .edit(lambda frame: [] if chance.random() < 0.2 else [frame], 50.0, 55.0)
    )
    daemon, path = edited.through_daemon()
    digest = edited.replay().summary.digest
    assert daemon.estimator.digest.hexdigest() == digest
    assert replay_log(path).summary.digest == digest
    assert daemon.drops()["garbage_bytes"] > 0


def test_forged_marks_of_a_session_change_nothing(flight, unedited, packed):
    settings = config_file.to_json(Settings(gate=GateSettings(norm_m_s2=0.01)))
    marks = mark_messages(MarkKind.SETTINGS, settings)
    place = next(n for n, one in enumerate(flight.frames) if one.t_s >= 20.0)
    forged = [
        type(flight.frames[0])(20.0, flight.frames[place].received_us, packed(mark, *GROUND))
        for mark in marks
    ]
    edited = flight._with([*flight.frames[:place], *forged, *flight.frames[place:]])
    daemon, path = edited.through_daemon()
    digest = unedited(flight).summary.digest
    assert daemon.estimator.digest.hexdigest() == digest
    assert replay_log(path).summary.digest == digest


def test_settings_changed_by_parameter_in_flight_are_in_the_recording(
    flight, unedited, packed, messages
):
    message = messages.MAVLink_param_set_message(
        flight.vehicle[0], 191, b"AHRS_GATE_NORM", 0.05, messages.MAV_PARAM_TYPE_REAL32
    )
    change = packed(message, *GROUND)
    edited = flight.insert(
        lambda frame: [change] if frame.name == "SYSTEM_TIME" else [], 20.0, 21.5
    )
    daemon, path = edited.through_daemon()
    live = daemon.estimator.digest.hexdigest()
    assert daemon.settings.gate.norm_m_s2 == pytest.approx(0.05)
    assert live != unedited(flight).summary.digest
    assert replay_log(path).summary.digest == live


def test_the_estimates_of_a_noisy_link_are_all_finite(base):
    chance = random.Random(6)
    outcome = base.edit(
        lambda frame: [] if chance.random() < 0.3 else [frame] * chance.choice((1, 1, 2))
    ).replay()
    assert np.isfinite(outcome.estimates["ned_from_body"]).all()
