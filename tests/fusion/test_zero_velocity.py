"""A vehicle that brakes without a shake is not at rest: its tilt may not follow the force."""

import numpy as np
import pytest

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.estimator import Estimator
from ahrs_service.records import SAMPLE_DTYPE, Airframe, empty

RATE_HZ = 100
STANDING, ROLLING, BRAKING, STOPPED = slice(0, 600), slice(600, 1200), slice(1200, 1600), 1600


def rolled(along_m_s2, airframe):
    """Samples [N] of a level vehicle: it stands, rolls on rough ground, brakes smoothly, stands."""
    samples = empty(SAMPLE_DTYPE, STOPPED + 400)
    rng, count = np.random.default_rng(3), len(samples)
    samples["time_ns"] = np.arange(count) * (10**9 // RATE_HZ)
    samples["gyro_rad_s"] = rng.normal(0.0, 2e-3, (count, 3))
    samples["accel_m_s2"] = rng.normal(0.0, 0.02, (count, 3))
    samples["accel_m_s2"][:, 2] -= STANDARD_GRAVITY_M_S2
    shaken = samples["accel_m_s2"][ROLLING]
    shaken += rng.normal(0.0, 1.0, shaken.shape)
    samples["accel_m_s2"][ROLLING, 0] += along_m_s2 * 4.0 / 6.0
    samples["accel_m_s2"][BRAKING, 0] -= along_m_s2
    samples["airframe"] = airframe
    return samples


@pytest.mark.parametrize("airframe", [Airframe.FIXED_WING, Airframe.MULTIROTOR, Airframe.OTHER])
@pytest.mark.parametrize("along_m_s2", [1.5, 3.0])
def test_a_smooth_braking_is_no_rest(along_m_s2, airframe):
    samples = rolled(along_m_s2, airframe)
    estimator = Estimator()
    estimates, state = estimator.run(samples[:STOPPED]), estimator.state
    assert state[0]["at_rest"] == 0
    _, x, y, _ = estimates["ned_from_body"][BRAKING].T
    # Taken for gravity, 1.5 m/s^2 are 8.7 deg.
    assert np.degrees(2.0 * np.hypot(x, y)).max() < 2.0
    estimator.run(samples[STOPPED:])
    assert state[0]["at_rest"] == 1
    np.testing.assert_allclose(state[0]["velocity_ned_m_s"], 0.0, atol=0.2)
