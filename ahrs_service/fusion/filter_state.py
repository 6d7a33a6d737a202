"""What the filter estimates, with its covariance: how it begins, widens, and takes in the wind.

`fusion.propagation` predicts it and `fusion.mekf` corrects it; every other module asks here.
"""

import math
from typing import Final

from ahrs_service.fusion import mekf
from ahrs_service.fusion.states import AIDED, ERROR_STATES, GYRO_BIAS, LAG, UNAIDED, VELOCITY, WIND
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Floats, Record

FILTER_FIELDS: Final = [
    ("ned_from_body", "f8", 4),
    ("dcm", "f8", (3, 3)),
    ("velocity_ned_m_s", "f8", 3),
    ("wind_ned_m_s", "f8", 3),
    ("velocity_lag_s", "f8"),
    ("gyro_bias_rad_s", "f8", 3),
    ("accel_bias_m_s2", "f8", 3),
    ("gyro_matrix", "f8", (3, 3)),
    ("states", "i8"),
    ("covariance", "f8", (ERROR_STATES, ERROR_STATES)),
    ("applied", "f8", ERROR_STATES),
    ("rotated_rad", "f8"),
]
"""Fields of the pipeline's state: what is estimated, how many error states are in use with their
covariance; the last two: what was corrected since the covariance last grew, and how far all was
rotated about down [rad]."""

HEADING_SIGMA_RAD: Final = math.pi
"""Of a heading that nothing was known about [rad]."""


@kernel
def reset(state: Record, states: int) -> None:
    """Forget velocity, wind and every variance; `states` are in use from here on."""
    p = state["covariance"]
    for i in range(ERROR_STATES):
        mekf.forget(p, i, 0.0)
    for i in range(3):
        state["velocity_ned_m_s"][i] = 0.0
    state["wind_ned_m_s"][0] = state["wind_ned_m_s"][1] = 0.0
    state["states"] = states


@kernel
def reset_sensors(state: Record) -> None:
    """Set the errors of the sensors to zero; their variances are kept."""
    for i in range(3):
        state["gyro_bias_rad_s"][i] = state["accel_bias_m_s2"][i] = 0.0
        for j in range(3):
            state["gyro_matrix"][i, j] = 0.0


@kernel
def clear(state: Record) -> None:
    """Set what no alignment sets anew to what it is before the first sample."""
    for i in range(4):
        state["ned_from_body"][i] = 1.0 if i == 0 else 0.0
    state["velocity_lag_s"] = 0.0
    reset_sensors(state)


@kernel
def set_gyro_bias(state: Record, axis: int, bias_rad_s: float, sigma_rad_s: float) -> None:
    """Take the bias [rad/s] of one axis as measured, independent of all else."""
    state["applied"][GYRO_BIAS + axis] += bias_rad_s - state["gyro_bias_rad_s"][axis]
    state["gyro_bias_rad_s"][axis] = bias_rad_s
    mekf.forget(state["covariance"], GYRO_BIAS + axis, sigma_rad_s**2)


@inlined_kernel
def widen(state: Record, which: int, variance: float) -> None:
    """Add to the variance of one error state."""
    state["covariance"][which, which] += variance


@kernel
def bring_wind_in(state: Record, wind_sigma_m_s: float, lag_sigma_s: float, at_rest: bool) -> None:
    """Make wind and lag states: velocity over ground = velocity through the air + wind.

    At rest the velocity is that over ground already.
    """
    p = state["covariance"]
    for i in range(2):
        v, w = VELOCITY + i, WIND + i
        mekf.forget(p, w, wind_sigma_m_s**2)
        state["wind_ned_m_s"][i] = 0.0
        if not at_rest:
            p[v, v] += wind_sigma_m_s**2
            p[v, w] = p[w, v] = wind_sigma_m_s**2
    mekf.forget(p, LAG, lag_sigma_s**2)
    state["states"] = AIDED


@kernel
def let_wind_go(state: Record) -> None:
    """Go on with the velocity through the air: that over ground without the wind."""
    p, velocity, wind = state["covariance"], state["velocity_ned_m_s"], state["wind_ned_m_s"]
    for i in range(2):
        v, w = VELOCITY + i, WIND + i
        for j in range(ERROR_STATES):
            p[v, j] -= p[w, j]
        for j in range(ERROR_STATES):
            p[j, v] -= p[j, w]
        velocity[i] -= wind[i]
        wind[i] = 0.0
    for i in range(UNAIDED, ERROR_STATES):
        mekf.forget(p, i, 0.0)
    state["states"] = UNAIDED


@inlined_kernel
def bound_attitude(p: Floats, states: int) -> None:
    """Keep the attitude variances at what no knowledge at all means."""
    for axis in range(3):
        limit = HEADING_SIGMA_RAD**2
        if p[axis, axis] > limit:
            scale = math.sqrt(limit / p[axis, axis])
            for j in range(states):
                p[axis, j] *= scale
                p[j, axis] *= scale
