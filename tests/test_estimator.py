"""The estimator as a whole: splitting the readings into calls changes nothing."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahrs_service.errors import StateError
from ahrs_service.estimator import Estimator
from ahrs_service.links.logs.tlog_recording import recording_from_tlog
from ahrs_service.records import READING_DTYPE, Kind, Phase, empty
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.settings import GateSettings, IntakeSettings, Settings

COUNT = 3000
few = settings(max_examples=25, deadline=None)


@pytest.fixture(scope="module")
def readings(simulated_tlog):
    """The first readings of a flight, then a gap, a clock jump, a repeat and a NaN."""
    rows = recording_from_tlog(simulated_tlog).readings[:COUNT].copy()
    imu = np.flatnonzero(rows["kind"] == Kind.IMU)
    rows["time_ns"][imu[imu > 1000]] += 2_000_000_000
    rows["time_ns"][imu[imu > 2000]] -= 1_500_000_000
    rows["gyro_rad_s"][imu[1500]] = np.nan
    return np.concatenate([rows[:1800], rows[1799:]])


@pytest.fixture(scope="module")
def whole(readings):
    """Estimates and estimator after one call with all readings."""
    estimator = Estimator(Settings())
    return estimator.take(readings).tobytes(), estimator


@few
@given(cuts=st.lists(st.integers(0, COUNT + 1), max_size=30))
def test_any_cut_into_calls_gives_the_same_bytes(readings, whole, cuts):
    estimator, parts, positions = Estimator(Settings()), [], []
    edges = [0, *sorted(cuts), len(readings)]
    for first, last in pairwise(edges):
        parts.append(estimator.take(readings[first:last]).tobytes())
        positions.extend((estimator.positions + first).tolist())
    assert b"".join(parts) == whole[0]
    assert estimator.digest.hexdigest() == whole[1].digest.hexdigest()
    assert estimator.save() == whole[1].save()
    assert positions == whole[1].positions.tolist()


def test_one_reading_at_a_time_gives_the_same_bytes(readings, whole):
    estimator = Estimator(Settings())
    parts = [estimator.take(readings[n : n + 1]).tobytes() for n in range(len(readings))]
    assert b"".join(parts) == whole[0]


@few
@given(cut=st.integers(0, COUNT))
def test_a_restored_state_goes_on_as_if_nothing_had_been(readings, whole, cut):
    before = Estimator(Settings())
    head = before.take(readings[:cut]).tobytes()
    after = Estimator(Settings())
    after.restore(before.save())
    assert head + after.take(readings[cut:]).tobytes() == whole[0]


def test_saving_changes_nothing(readings, whole):
    estimator = Estimator(Settings())
    head = estimator.take(readings[:500]).tobytes()
    assert estimator.save() == estimator.save()
    assert head + estimator.take(readings[500:]).tobytes() == whole[0]


@pytest.mark.parametrize(
    "spoil",
    [lambda saved: saved[:-1], lambda saved: saved + b"\0", lambda saved: b"x" + saved[1:],
     lambda saved: b""],
    ids=["cut", "longer", "another version", "nothing"],
)  # fmt: skip
def test_a_state_that_does_not_fit_is_refused_and_changes_nothing(spoil, readings, whole):
    estimator = Estimator(Settings())
    head = estimator.take(readings[:500]).tobytes()
    with pytest.raises(StateError, match="state"):
        estimator.restore(spoil(estimator.save()))
    assert head + estimator.take(readings[500:]).tobytes() == whole[0]


def test_two_estimators_do_not_know_of_each_other(readings, whole):
    one, other = Estimator(Settings()), Estimator(Settings())
    parts = []
    for first in range(0, len(readings), 100):
        parts.append(one.take(readings[first : first + 100]).tobytes())
        other.take(readings[:50])
    assert b"".join(parts) == whole[0]


def test_no_readings_give_no_estimates():
    estimator = Estimator(Settings())
    before = estimator.save()
    assert len(estimator.take(empty(READING_DTYPE, 0))) == 0
    assert estimator.save() == before


def test_new_settings_hold_from_the_next_sample_on(readings, whole):
    estimator = Estimator(Settings())
    head = estimator.take(readings[:900]).copy()
    estimator.configure(Settings(gate=GateSettings(norm_m_s2=1e-6)))
    tail = estimator.take(readings[900:]).copy()
    assert head.tobytes() == whole[0][: head.nbytes]
    # The gate is evaluated once per update.
    judged = tail["time_ns"] > tail["time_ns"][0] + 100_000_000
    assert (tail["gate"][judged & (tail["phase"] == Phase.RUNNING)] != 0).all()


def test_a_calibration_is_used(readings, whole):
    ideal = Estimator(Settings(), Calibration.ideal())
    assert ideal.take(readings).tobytes() == whole[0]


def test_another_vehicle_gives_nothing(readings):
    estimator = Estimator(Settings(intake=IntakeSettings(system=99)))
    assert len(estimator.take(readings)) == 0
    assert estimator.intake_state["foreign"][0] == len(readings)


@pytest.mark.parametrize("vehicle", [-1, 256, 2**40])
def test_a_saved_state_of_no_known_vehicle_is_refused(vehicle):
    """The kernels look the airframe up by it, unchecked."""
    estimator = Estimator(Settings())
    estimator.intake_state["vehicle"] = vehicle
    with pytest.raises(StateError, match=f"vehicle {vehicle}"):
        Estimator(Settings()).restore(estimator.save())
