"""The health reported by the service, and when it changes."""

import pytest

from ahrs_service.health import FLAG_HOLD_S, IMU_SILENCE_S, Health, HealthMonitor
from ahrs_service.records import ESTIMATE_DTYPE, Flag, Phase, empty

TOLD = {
    Flag.GAP: "gap",
    Flag.CLOCK_JUMP: "the autopilot's clock jumped",
    Flag.REALIGNED: "aligning anew",
    Flag.ACCEL_MISSING: "accelerometer",
    Flag.NOT_FINITE: "not finite",
    Flag.SATURATED: "out of its range",
    Flag.SPIKE: "spike",
    Flag.SOURCE_CHANGED: "message changed",
    Flag.IMU_CHANGED: "another IMU",
    Flag.TEMPERATURE_STALE: "temperature stale",
    Flag.TEMPERATURE_OUT_OF_RANGE: "outside the calibrated range",
    Flag.UNCOMPENSATED: "not compensated",
    Flag.LOW_RATE: "below 20 Hz",
}
NOT_TOLD = {Flag.DUPLICATE, Flag.REORDERED}
"""A single one of these is harmless."""


def estimate(flags=0, phase=Phase.RUNNING):
    row = empty(ESTIMATE_DTYPE)
    row["flags"], row["phase"] = flags, phase
    return row[0]


def fed(seconds=1.0, rate_hz=50.0, **fields):
    """A monitor that saw good samples for a while, and the time of the last."""
    monitor, now_s = HealthMonitor(), 100.0
    for n in range(int(seconds * rate_hz)):
        now_s = 100.0 + n / rate_hz
        monitor.sample(estimate(**fields), now_s)
    monitor.update(True, now_s)
    return monitor, now_s


def test_from_nothing_to_good():
    monitor = HealthMonitor()
    assert monitor.state is Health.NO_VEHICLE
    assert monitor.update(False, 0.0) == ""
    assert monitor.update(True, 0.1) == "no IMU data"
    monitor.sample(estimate(phase=Phase.ALIGNING), 0.2)
    assert monitor.update(True, 0.2) == "aligning"
    monitor.sample(estimate(), 0.3)
    assert monitor.update(True, 0.3) == "good"
    assert monitor.update(True, 0.35) == ""


@pytest.mark.parametrize("flag", TOLD, ids=lambda flag: flag.name)
def test_a_fault_is_reported_held_and_taken_back(flag):
    monitor, now_s = fed()
    assert monitor.state is Health.GOOD
    monitor.sample(estimate(flags=flag), now_s + 0.02)
    said = monitor.update(True, now_s + 0.02)
    assert said.startswith("degraded; ")
    assert TOLD[flag] in said
    steps = int(FLAG_HOLD_S / 0.1)
    for n in range(1, steps):
        monitor.sample(estimate(), now_s + 0.1 * n)
        assert monitor.update(True, now_s + 0.1 * n) == ""
    monitor.sample(estimate(), now_s + FLAG_HOLD_S + 0.1)
    assert monitor.update(True, now_s + FLAG_HOLD_S + 0.1) == "good"


def test_every_flag_is_either_reported_or_harmless():
    assert set(TOLD) | NOT_TOLD == set(Flag) - {Flag.NONE}
    for flag in NOT_TOLD:
        monitor, now_s = fed()
        monitor.sample(estimate(flags=flag), now_s + 0.02)
        assert monitor.update(True, now_s + 0.02) == ""


def test_several_faults_are_reported_together():
    monitor, now_s = fed()
    monitor.sample(estimate(flags=Flag.GAP | Flag.SATURATED), now_s)
    said = monitor.update(True, now_s)
    assert said == "degraded; gap in the IMU data; IMU out of its range"
    assert monitor.reasons == ("gap in the IMU data", "IMU out of its range")


@pytest.mark.parametrize(
    ("flags", "phase", "said"),
    [
        (Flag.CLOCK_JUMP, Phase.RUNNING, "degraded; the autopilot's clock jumped"),
        (
            Flag.CLOCK_JUMP | Flag.GAP,
            Phase.RUNNING,
            "degraded; gap in the IMU data; the autopilot's clock jumped",
        ),
        (
            Flag.CLOCK_JUMP | Flag.GAP | Flag.REALIGNED,
            Phase.ALIGNING,
            "aligning; gap in the IMU data; the autopilot's clock jumped; aligning anew",
        ),
        (
            Flag.IMU_CHANGED | Flag.REALIGNED,
            Phase.ALIGNING,
            "aligning; aligning anew; another IMU is in use",
        ),
    ],
)
def test_only_what_aligns_anew_says_so(flags, phase, said):
    monitor, now_s = fed()
    monitor.sample(estimate(flags, phase), now_s)
    assert monitor.update(True, now_s) == said


def test_silence_is_reported_after_half_a_second():
    monitor, now_s = fed()
    assert monitor.update(True, now_s + IMU_SILENCE_S - 0.01) == ""
    assert monitor.update(True, now_s + IMU_SILENCE_S + 0.01) == "no IMU data"
    monitor.sample(estimate(), now_s + 3.0)
    assert monitor.update(True, now_s + 3.0) == "good"
    # One pause does not make the service patient.
    assert monitor.update(True, now_s + 3.0 + IMU_SILENCE_S + 0.01) == "no IMU data"


@pytest.mark.parametrize("rate_hz", [1.0, 2.0])
def test_a_slow_stream_is_not_silence(rate_hz):
    monitor, now_s = fed(seconds=20.0, rate_hz=rate_hz)
    assert monitor.update(True, now_s + 1.5 / rate_hz) == ""
    assert monitor.update(True, now_s + 3.5 / rate_hz) == "no IMU data"


def test_a_vehicle_that_is_not_heard_comes_before_all_else():
    monitor, now_s = fed(phase=Phase.ALIGNING)
    assert monitor.update(False, now_s) == "no vehicle heard"
