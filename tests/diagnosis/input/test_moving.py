"""Noise on an axis at rest is no motion: no motion-dependent effect is named for it."""

from dataclasses import fields

import numpy as np
import pytest

from ahrs_service.diagnosis.input.reference_motion import moving
from ahrs_service.effects.base import Columns


def columns(rate):
    """Columns at 50 Hz that hold only `rate` [N, 3]."""
    nothing = np.full(len(rate), np.nan)
    values = {field.name: nothing for field in fields(Columns)}
    values |= {"time_s": np.arange(len(rate)) / 50.0, "rate_rad_s": rate, "force_m_s2": rate}
    return Columns(**values)


def test_axes_at_rest_are_constant_and_axes_that_move_are_left_as_they_were():
    rng = np.random.default_rng(3)
    swing = np.zeros((3000, 3))
    swing[:, 1] = np.sin(0.05 * np.arange(3000))
    read = swing + rng.normal(0.0, 1e-3, swing.shape)
    found = moving(columns(read), columns(swing + rng.normal(0.0, 1e-3, swing.shape)))
    assert np.array_equal(found.rate_rad_s[:, 1], read[:, 1])
    assert np.ptp(found.rate_rad_s[:, [0, 2]], axis=0) == pytest.approx(0.0, abs=1e-15)
    # d/dt sin(2.5 t) at the start, plus the noise's slope.
    assert found.angular_acceleration_rad_s2[:, 1].std() == pytest.approx(
        2.5 / np.sqrt(2), rel=0.05
    )
    assert np.abs(found.angular_acceleration_rad_s2[:, [0, 2]]).max() < 1e-9


def test_an_axis_that_shakes_as_much_as_it_moves_is_followed_slowly():
    """Vibration left in the motion would be a regressor that explains itself."""
    rng = np.random.default_rng(4)
    sway = np.tile(np.sin(2.0 * np.pi * 0.1 * np.arange(6000) / 50.0)[:, None], 3)
    shake = 0.7 * rng.normal(size=sway.shape)
    found = moving(columns(sway + shake), columns(sway)).rate_rad_s
    kept = np.sum((found - sway) * shake) / np.sum(shake**2)
    assert kept < 0.15
    assert np.corrcoef(found[:, 0], sway[:, 0])[0, 1] > 0.95
