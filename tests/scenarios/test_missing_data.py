"""Messages that stop, thin out or come without some of their values."""

import numpy as np
import pytest

from ahrs_service.records import Flag, Gate, ImuSource

IMU = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU")
TEMPERATURE = ("SCALED_IMU", "RAW_IMU")


def test_two_seconds_without_imu(base, unedited):
    start_s = base.calm_s
    original, outcome = unedited(base), base.drop(IMU, start_s, start_s + 2.0).replay()
    assert outcome.new_flags(original) == {"gap": 1}
    assert outcome.counters() == {**original.counters(), "gaps": 1}
    assert outcome.when(Flag.GAP) == pytest.approx([start_s + 2.0], abs=0.05)
    assert outcome.is_as(original, 0.0, start_s)
    assert outcome.tilt_from(original, start_s + 2.0, start_s + 3.0) < 5.0
    assert outcome.tilt_from(original, start_s + 6.0, start_s + 8.0) < 4.0


def test_a_gap_widens_what_the_filter_claims_of_itself(base):
    outcome = base.drop(IMU, base.calm_s, base.calm_s + 2.0).replay()
    n = int(np.flatnonzero(outcome.estimates["flags"] & Flag.GAP)[0])
    sigma = outcome.estimates["attitude_sigma_rad"][:, 0]
    assert sigma[n] > 1.2 * sigma[n - 1]


@pytest.mark.parametrize("start_s", [10.0, 23.0, 29.0, 46.0])
def test_after_a_loss_in_a_climb_or_turn_the_horizon_returns(flight, unedited, start_s):
    outcome = flight.drop(IMU, start_s, start_s + 2.0).replay()
    assert outcome.counters()["gaps"] == 1
    assert outcome.tilt_from(unedited(flight), start_s + 13.0, start_s + 14.0) < 8.0


def test_the_service_says_that_the_imu_is_gone_and_back(base):
    start_s = base.calm_s
    outcome = base.drop(IMU, start_s, start_s + 2.0).replay()
    said = [(t_s, text) for t_s, text in outcome.health() if t_s > start_s]
    assert [text for _, text in said[:2]] == ["no IMU data", "degraded; gap in the IMU data"]
    assert said[0][0] == pytest.approx(start_s + 0.5, abs=0.11)
    assert said[1][0] == pytest.approx(start_s + 2.0, abs=0.11)
    assert said[2][1] == "good"


def test_a_long_loss_is_aligned_anew(base, unedited):
    start_s = base.calm_s
    outcome = base.drop(IMU, start_s, start_s + 5.5).replay()
    found = outcome.new_flags(unedited(base))
    assert (found["gap"], found["realigned"]) == (1, 1)
    assert outcome.when(Flag.REALIGNED) == pytest.approx([start_s + 5.5], abs=0.05)


def test_highres_imu_disappears_and_another_message_of_the_same_imu_steps_in(flight, unedited):
    original, outcome = unedited(flight), flight.drop(("HIGHRES_IMU",), 20.0, 30.0).replay()
    changed_s = outcome.when(Flag.SOURCE_CHANGED)
    changed_s = changed_s[changed_s > 19.0]
    assert changed_s[0] == pytest.approx(20.3, abs=0.1)
    assert changed_s[-1] == pytest.approx(30.0, abs=0.1)
    between = (outcome.t_s > 20.6) & (outcome.t_s < 29.9)
    assert set(outcome.estimates["source"][between]) == {ImuSource.RAW_IMU}
    assert outcome.estimates["source"][-1] == ImuSource.HIGHRES_IMU
    # The same sensor by another message: no new alignment, and no rotation is lost.
    assert not {"realigned", "imu_changed", "gap"} & set(outcome.summary.flags)
    assert outcome.tilt_from(original, 20.0, 30.0) < 5.0
    assert outcome.tilt_from(original, 31.0) < 3.0
    said = [text for t_s, text in outcome.health() if 20.0 < t_s < 22.0]
    assert said == ["degraded; IMU message changed"]


def test_a_dead_link_does_not_change_the_source(flight, unedited):
    outcome = flight.drop(IMU, 20.0, 24.0).replay()
    assert outcome.summary.source_changes == unedited(flight).summary.source_changes


def test_without_accelerometer_bits_the_gyro_goes_on_alone(base, unedited):
    original = unedited(base)
    only = base.drop(TEMPERATURE, 1.0)
    start_s = base.calm_s

    def no_accel(message):
        message.fields_updated = (message.fields_updated or 0xFFFF) & ~0x07

    outcome = only.change(("HIGHRES_IMU",), no_accel, start_s, start_s + 2.0).replay()
    missing = outcome.with_flag(Flag.ACCEL_MISSING)
    edited = (original.t_s >= start_s) & (original.t_s < start_s + 2.0)
    assert len(missing) == np.count_nonzero(edited)
    assert (missing["gate"] & Gate.STALE != 0).all()
    assert np.isnan(missing["accel_m_s2"]).all()
    assert np.isfinite(outcome.estimates["ned_from_body"]).all()
    assert outcome.tilt_from(original, start_s, start_s + 2.0) < 3.0
    said = [text for t_s, text in outcome.health() if 0.0 <= t_s - start_s < 1.0]
    assert said == ["degraded; accelerometer values are missing"]


def test_a_message_without_accelerometer_gives_way_to_one_with(flight, unedited):
    def no_accel(message):
        message.fields_updated &= ~0x07

    outcome = flight.change(("HIGHRES_IMU",), no_accel).replay()
    assert outcome.summary.sources == {"RAW_IMU": 3001}
    assert outcome.tilt_from(unedited(flight), 5.0) < 5.0


def test_a_vehicle_without_any_accelerometer_never_claims_an_attitude(base):
    def no_accel(message):
        message.fields_updated = (message.fields_updated or 0xFFFF) & ~0x07

    outcome = base.drop(TEMPERATURE).change(("HIGHRES_IMU",), no_accel).replay()
    assert outcome.summary.running_s == 0.0
    assert any("there is no attitude" in warning for warning in outcome.summary.warnings)
    assert outcome.health()[-1][1] == "aligning; accelerometer values are missing"


def test_imu_at_2_hz_is_flagged_and_warned_of(base):
    last_s = [-1.0]

    def thin(frame):
        if not frame.is_imu:
            return [frame]
        if frame.name != "HIGHRES_IMU" or frame.t_s < last_s[0] + 0.5:
            return []
        last_s[0] = frame.t_s
        return [frame]

    outcome = base.edit(thin).replay()
    assert (outcome.estimates["flags"][2:] & Flag.LOW_RATE != 0).all()
    assert "gap" not in outcome.summary.flags
    warning = outcome.summary.warnings[0]
    assert warning.startswith(("IMU at 2.0 Hz", "IMU at 1.9 Hz"))
    assert "follows the accelerometer alone and is meaningless in manoeuvres" in warning
    said = [text for t_s, text in outcome.health() if t_s > 2.0]
    assert all("IMU below 20 Hz" in text and "no IMU" not in text for text in said)


def test_a_frozen_temperature_is_reported_after_half_a_minute(flight, unedited):
    def freeze(message):
        message.temperature = 2900

    outcome = flight.change(TEMPERATURE, freeze, 15.0).replay()
    stale_s = outcome.when(Flag.TEMPERATURE_STALE)
    assert stale_s[0] == pytest.approx(45.0, abs=0.1)
    assert stale_s[-1] == outcome.t_s[-1]
    assert set(outcome.new_flags(unedited(flight))) == {"temperature_stale"}
    assert outcome.health()[-1][1] == "degraded; IMU temperature stale or frozen"


def test_a_temperature_that_stops_coming_is_reported_after_ten_seconds(flight, unedited):
    original, outcome = unedited(flight), flight.drop(TEMPERATURE, 20.0, 40.0).replay()
    stale_s = outcome.when(Flag.TEMPERATURE_STALE)
    assert stale_s[0] == pytest.approx(30.0, abs=0.1)
    assert stale_s[-1] == pytest.approx(40.0, abs=0.1)
    assert outcome.new_flags(original) == {"temperature_stale": len(stale_s)}
    # Warming widens the bias a little, and that warming is now seen later.
    assert outcome.turn_from(original, 0.0) < 0.05
    assert (30.0, "degraded; IMU temperature stale or frozen") in [
        (round(t_s, 1), text) for t_s, text in outcome.health()
    ]


def test_the_barometers_temperature_is_never_used_as_the_imus(base, unedited):
    def hot(message):
        message.temperature = 99.0
        message.fields_updated = (message.fields_updated or 0xEFFF) | 0x1000

    hotter = base.change(("HIGHRES_IMU",), hot)
    assert hotter.replay().bytes == unedited(base).bytes
    alone = hotter.drop(TEMPERATURE).replay()
    assert np.isnan(alone.estimates["temperature_degc"]).all()
    assert any("HIGHRES_IMU carries 99.0 to 99.0 degC" in one for one in alone.summary.warnings)
