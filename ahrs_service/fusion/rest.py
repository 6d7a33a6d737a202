"""Rest: neither rotation nor vibration means that the vehicle stands, and its gyro shows bias."""

import math
from typing import Final

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Record

REST_FIELDS: Final = [
    ("mean_rate_rad_s", "f8", 3),
    ("mean_force_m_s2", "f8", 3),
    ("rate_variance", "f8"),
    ("force_variance", "f8"),
    ("rest_s", "f8"),
]
"""Fields of the pipeline's state that this module keeps."""

AVERAGE_S: Final = 0.5
CONFIRM_S: Final = 1.0
FORCE_SIGMA_M_S2: Final = 0.3
"""An idle engine or a hand on the wing shake more than this [m/s^2]."""
RATE_RAD_S: Final = 0.1
FORCE_ERROR_M_S2: Final = 0.5


@kernel
def follow(state: Record, gyro: Floats, accel: Floats, dt_s: float, rate_sigma: float) -> None:
    """Follow mean and variance of rate and force; `rest_s` is how long all were those of rest."""
    weight = dt_s / (AVERAGE_S + dt_s)
    rate2 = force2 = spread_rate2 = spread_force2 = 0.0
    for i in range(3):
        state["mean_rate_rad_s"][i] += weight * (gyro[i] - state["mean_rate_rad_s"][i])
        state["mean_force_m_s2"][i] += weight * (accel[i] - state["mean_force_m_s2"][i])
        spread_rate2 += (gyro[i] - state["mean_rate_rad_s"][i]) ** 2
        spread_force2 += (accel[i] - state["mean_force_m_s2"][i]) ** 2
        rate2 += state["rate_rad_s"][i] ** 2
        force2 += state["mean_force_m_s2"][i] ** 2
    state["rate_variance"] += weight * (spread_rate2 - state["rate_variance"])
    state["force_variance"] += weight * (spread_force2 - state["force_variance"])
    still = (
        state["rate_variance"] < rate_sigma * rate_sigma
        and state["force_variance"] < FORCE_SIGMA_M_S2**2
        and rate2 < RATE_RAD_S**2
        and abs(math.sqrt(force2) - STANDARD_GRAVITY_M_S2) < FORCE_ERROR_M_S2
    )
    state["rest_s"] = state["rest_s"] + dt_s if still else 0.0
