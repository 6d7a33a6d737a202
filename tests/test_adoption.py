"""Who is adopted: the live component, the intake and the readers of recordings follow one rule."""

import numpy as np
import pytest

from ahrs_service import intake
from ahrs_service.adoption import NO_VEHICLE, first_vehicle, may_adopt, of_vehicle
from ahrs_service.chosen_imu import choose_imu
from ahrs_service.links.component.component import Component
from ahrs_service.links.logs.readings import from_message
from ahrs_service.links.mavlink.codec import Encoder, decode_frame, dialect
from ahrs_service.records import READING_DTYPE, SAMPLE_DTYPE, ImuSource, empty
from ahrs_service.settings import IntakeSettings, Settings

ARDUPILOT, INVALID, GENERIC = 3, 8, 0
BEATS = {
    "a ground station first": [(255, 190, INVALID), (1, 1, ARDUPILOT), (2, 1, ARDUPILOT)],
    "system 0 first": [(0, 1, ARDUPILOT), (4, 1, ARDUPILOT)],
    "two of one system": [(3, 1, ARDUPILOT), (3, 2, GENERIC)],
    "the second first": [(2, 1, ARDUPILOT), (1, 1, ARDUPILOT), (2, 1, ARDUPILOT)],
    "none": [(1, 154, INVALID)],
}


@pytest.mark.parametrize("beats", BEATS.values(), ids=BEATS)
@pytest.mark.parametrize("wanted", [(0, 0), (1, 0), (2, 1), (0, 2), (3, 2), (9, 0)])
def test_live_and_replay_adopt_the_same(beats, wanted):
    settings = Settings(intake=IntakeSettings(*wanted))
    component, rows = Component(settings), empty(READING_DTYPE, len(beats))
    for n, (system, number, autopilot) in enumerate(beats):
        message = dialect.MAVLink_heartbeat_message(1, autopilot, 0, 0, 4, 3)
        message = decode_frame(Encoder(system, number).pack(message))
        component.on_message(message, 0.1 * n)
        assert from_message(message, n, rows[n : n + 1])
    state = intake.new_state()
    intake.select(
        intake.parameters(settings.intake),
        state,
        rows,
        empty(SAMPLE_DTYPE, 1),
        np.zeros(1, np.int64),
    )
    adopted = int(state["system"][0]), int(state["component"][0])
    assert first_vehicle(rows, settings.intake) == adopted
    assert component.vehicle == (adopted if adopted != NO_VEHICLE else (-1, -1))
    allowed = [beat[:2] for beat in beats if may_adopt(*beat, *wanted)]
    assert adopted == (allowed[0] if allowed else NO_VEHICLE)


def test_one_message_is_taken_throughout():
    """The estimator begins with the first message heard; the whole recording has a better one."""
    rows = empty(READING_DTYPE, 401)
    rows["system"], rows["component"] = 7, 1
    rows["kind"], rows["autopilot"] = 2, ARDUPILOT
    rows["kind"][0] = 1
    rows["source"][1:] = ImuSource.SCALED_IMU
    rows["source"][2::2] = ImuSource.HIGHRES_IMU
    rows["time_ns"] = rows["received_ns"] = np.arange(401) * 5_000_000
    rows["gyro_rad_s"], rows["accel_m_s2"] = 0.0, (0.0, 0.0, -9.8)
    chosen = choose_imu(rows, IntakeSettings())
    assert (chosen.vehicle, chosen.source) == ((7, 1), ImuSource.HIGHRES_IMU)
    assert chosen.positions.tolist() == list(range(2, 401, 2))
    assert not len(choose_imu(rows, IntakeSettings(system=1)).samples)
    assert choose_imu(rows[:0], IntakeSettings()).source == ImuSource.NONE
    assert len(of_vehicle(rows, (7, 1))) == 401
    assert not len(of_vehicle(rows, (7, 2)))
