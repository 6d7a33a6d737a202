"""A recording of a vehicle that rolls to and fro, made frame by frame."""

import numpy as np
import pytest

from ahrs_service.app import cli
from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.estimator import Estimator
from ahrs_service.links.logs.readings import from_message
from ahrs_service.links.logs.tlog import tlog_record
from ahrs_service.links.mavlink.codec import Decoder, Encoder, dialect
from ahrs_service.records import READING_DTYPE, empty
from ahrs_service.settings import Settings

BOOT_US = 1_700_000_000_000_000
AUTOPILOT = 3


def roll_of(t_s):
    return 0.4 * np.sin(0.8 * t_s)


def imu_message(t_us, t_s):
    roll, rate = roll_of(t_s), 0.32 * np.cos(0.8 * t_s)
    g = STANDARD_GRAVITY_M_S2
    accel = (0.0, -g * np.sin(roll), -g * np.cos(roll))
    return dialect.MAVLink_highres_imu_message(
        t_us, *accel, rate, 0.0, 0.0, *([0.0] * 6), 25.0, 0x103F
    )


def frames_of(seconds=12.0, rate_hz=100.0, clock_us=lambda t_us: t_us, skip=lambda t_s: False):
    """(receipt [us], frame) of a vehicle that rolls to and fro and reports its true attitude."""
    encoder = Encoder(7, 1)
    ground = Encoder(255, 190)
    frames = []
    for n in range(round(seconds * rate_hz)):
        t_s = n / rate_hz
        t_us = round(1e6 * t_s) + 1_000_000
        received_us = (BOOT_US + t_us) & ~3
        if n % round(rate_hz) == 0:
            heart = dialect.MAVLink_heartbeat_message(1, AUTOPILOT, 0, 0, 4, 3)
            frames.append((received_us, encoder.pack(heart)))
            frames.append(
                (received_us, ground.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
            )
        if not skip(t_s):
            stamp_us = clock_us(t_us)
            frames.append((received_us, encoder.pack(imu_message(stamp_us, t_s))))
            if n % 5 == 0:
                attitude = (stamp_us // 1000, roll_of(t_s), 0.0, 0.0, 0.0, 0.0, 0.0)
                message = dialect.MAVLink_attitude_message(*attitude)
                frames.append((received_us, encoder.pack(message)))
    return frames


def write(path, frames):
    path.write_bytes(b"".join(tlog_record(*one) for one in frames))
    return path


@pytest.fixture
def flight(tmp_path):
    return write(tmp_path / "flight.tlog", frames_of())


def live_digest(frames, settings=None):
    """The service's estimates for frames received one by one."""
    estimator, decoder = Estimator(settings or Settings()), Decoder()
    rows = empty(READING_DTYPE, 1)
    for received_us, frame in frames:
        for message, _ in decoder.feed(frame):
            if from_message(message, received_us * 1000, rows):
                estimator.take(rows)
    return estimator.digest.hexdigest()


def replay(*words):
    return cli.main(["replay", *map(str, words)])
