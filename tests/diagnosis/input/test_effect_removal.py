"""What a twin knows is taken out of a recording as it was put in."""

import numpy as np
import pytest

from ahrs_service.diagnosis.input.diagnosis_input import Recorded, Series
from ahrs_service.diagnosis.input.effect_removal import with_effects, without_effects
from ahrs_service.effects.catalogue import effect_of
from ahrs_service.sensor.noise import gauss_markov

RATE_HZ, SECONDS = 50.0, 300.0


def recording(seed=1):
    """Gentle turns, a rising temperature, throttle steps; noise with a slow wander."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
    count = len(time_s)
    rate = gauss_markov(rng, (count, 3), 0.3, 2.0, RATE_HZ)
    force = gauss_markov(rng, (count, 3), 1.0, 3.0, RATE_HZ) - [0.0, 0.0, 9.8]
    throttle = 0.5 + 0.5 * np.sign(np.sin(time_s / 15.0))
    still = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return Recorded(
        "made",
        time_s,
        rate,
        force,
        Series(time_s, still),
        Series(),
        Series(),
        Series(time_s, 20.0 + 0.05 * time_s),
        Series(time_s, np.tile(2.0 * throttle[:, None], (1, 3))),
        Series(),
        Series(time_s, throttle),
        Series(),
    )


@pytest.mark.parametrize(
    ("identifier", "values"),
    [
        ("gyro_scale_factor", {"scale_error": [0.02, -0.01, 0.01]}),
        ("imu_mounting_rotation", {"rotvec_rad": [0.02, -0.01, 0.03]}),
        ("accel_thermal_bias", {"linear": [0.01, 0.0, -0.01]}),
        ("accel_vibration_rectification", {"per_vibration_variance": [0.1, 0.0, -0.1]}),
        ("imu_time_offset", {"offset_s": 0.013}),
        ("imu_clock_drift", {"ppm": 80.0}),
    ],
)
def test_what_a_twin_knows_is_taken_out_as_it_was_put_in(identifier, values):
    recorded = recording()
    effect = effect_of(identifier)
    known = [(effect, effect.checked(values))]
    felt = with_effects(recorded, known)
    moved = felt.imu_time_s - recorded.imu_time_s
    added = np.abs(felt.gyro_rad_s - recorded.gyro_rad_s).max()
    added += np.abs(felt.accel_m_s2 - recorded.accel_m_s2).max()
    assert added > 1e-3 or np.abs(moved).max() > 1e-3
    back = without_effects(felt, known)
    np.testing.assert_allclose(back.imu_time_s, recorded.imu_time_s, atol=2e-6)
    # What is left is the effect's square: 3 % of 3 % of the motion.
    np.testing.assert_allclose(back.gyro_rad_s, recorded.gyro_rad_s, atol=1e-4)
    np.testing.assert_allclose(back.accel_m_s2, recorded.accel_m_s2, atol=1e-3)


def test_an_effect_that_needs_what_is_not_recorded_is_refused():
    effect = effect_of("gyro_current_coupling")
    known = [(effect, effect.checked({"per_ampere": [1e-3, 0.0, 0.0]}))]
    with pytest.raises(ValueError, match="gyro_current_coupling needs current_a"):
        without_effects(recording(), known)
