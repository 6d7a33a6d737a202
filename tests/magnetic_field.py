"""A vehicle whose heading comes from a magnetic field, and one reading of such a field."""

from typing import Any

import numpy as np

from ahrs_service import pipeline
from ahrs_service.fusion import field_lag, hard_iron, heading
from ahrs_service.fusion.states import AIDED
from ahrs_service.settings import Settings
from tests.error_state import attitude, flying, stand

FIELD = np.array([20.0, 0.0, 40.0])
TURN_S = 0.12
OF_A_TURN = 10.0 / TURN_S


def settings_of(declination_rad: float = 0.0) -> Any:
    """The usual parameters of the filter."""
    settings = pipeline.parameters(Settings())[0]
    settings["declination_rad"] = declination_rad
    return settings


def facing(yaw: float = 0.0, variance: float = 0.04, tilt_variance: float = 1e-4) -> Any:
    """Level, the heading by the field since long, all else known."""
    state = flying(31, AIDED)
    stand(state, attitude([0.0, 0.0, yaw]))
    state["covariance"] = 0.0
    for i, value in enumerate((tilt_variance, tilt_variance, variance)):
        state["covariance"][i, i] = value
    heading.begin_average(state)
    hard_iron.start(state)
    field_lag.start(state)
    state["heading_source"] = heading.FIELD
    state["reference_ut"], state["reference_s"] = (20.0, 40.0), 30.0
    state["rate_rad_s"] = state["smooth_rate_rad_s"] = 0.0
    state["iron_covariance"] = state["field_lag_variance_s2"] = 0.0
    return state


def taken(state: Any, field_ned: Any, settings: Any = None) -> Any:
    """Correct by one reading of a field, measured at the estimated attitude."""
    heading.gather(state, state["dcm"].T @ np.asarray(field_ned, np.float64), TURN_S)
    heading.correct(settings_of() if settings is None else settings, state)
    return state["correction"][2]
