"""A level vehicle at rest with a fully known state."""

from typing import Any

from ahrs_service import pipeline
from ahrs_service.fusion.states import UNAIDED
from ahrs_service.records import Airframe
from ahrs_service.settings import Settings
from tests.error_state import attitude, flying, stand

G = 9.80665
WING = int(Airframe.FIXED_WING)


def settings_of(**given: Any) -> Any:
    """The usual parameters of the filter but for those given, the same for each class."""
    settings = pipeline.parameters(Settings())[0]
    for name, value in given.items():
        if settings[name].shape:
            settings[name][:] = value
        else:
            settings[name] = value
    return settings


def standing(count: int = UNAIDED) -> Any:
    """Level and at rest, every variance zero."""
    state = flying(51, count)
    stand(state, attitude([0.0, 0.0, 0.0]))
    for name in ("covariance", "velocity_ned_m_s", "wind_ned_m_s", "gyro_bias_rad_s"):
        state[name] = 0.0
    state["force_ned_m_s2"] = state["mean_force_m_s2"] = (0.0, 0.0, -G)
    state["time_ns"] = 60 * 10**9
    return state
