"""The filter's errors and its update once more, in dense matrices, for the kernels to agree with.

Nothing here calls the filter. `moved` leads from an estimate to the truth that is an error away, so
each row of a measurement and each column of a transition follows by a finite difference.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ahrs_service import pipeline
from ahrs_service.fusion.states import (
    ACCEL_BIAS,
    AIDED,
    ERROR_STATES,
    GYRO_BIAS,
    GYRO_MATRIX,
    LAG,
    VELOCITY,
    WIND,
)
from ahrs_service.records import Phase

STEP = 1e-6


def attitude(rotvec: Any) -> Any:
    """Quaternion [4] w, x, y, z of a rotation vector [3] [rad], w >= 0."""
    x, y, z, w = Rotation.from_rotvec(rotvec).as_quat(canonical=True)
    return np.array([w, x, y, z])


def matrix_of(q: Any) -> Any:
    """Direction cosine matrix [3, 3] of a quaternion [4] w, x, y, z."""
    return Rotation.from_quat(np.roll(q, -1)).as_matrix()


def flying(seed: int, count: int = AIDED, sigma: float = 0.1) -> Any:
    """A filter of `count` error states in flight, of a random state and covariance."""
    rng = np.random.default_rng(seed)
    state = pipeline.new_state()[0]
    state["states"], state["phase"], state["aligned_samples"] = count, Phase.RUNNING, 100
    stand(state, attitude(rng.normal(0.0, 0.7, 3)))
    state["velocity_ned_m_s"] = rng.normal(0.0, 8.0, 3)
    state["gyro_bias_rad_s"] = rng.normal(0.0, 0.02, 3)
    if count > GYRO_BIAS + 3:
        state["accel_bias_m_s2"] = rng.normal(0.0, 0.2, 3)
        state["gyro_matrix"] = rng.normal(0.0, 0.02, (3, 3))
    if count == AIDED:
        state["wind_ned_m_s"][:2] = rng.normal(0.0, 3.0, 2)
    root = rng.normal(size=(count, count)) * sigma
    state["covariance"][:count, :count] = root @ root.T
    return state


def stand(state: Any, q: Any) -> None:
    """Give the state this attitude."""
    state["ned_from_body"], state["dcm"] = q, matrix_of(q)


def moved(state: Any, error: Any) -> Any:
    """The state at an error of `error` [24]: angles rotate about earth axes, all else adds."""
    other = state.copy()
    turn = Rotation.from_rotvec(error[:3])
    x, y, z, w = (turn * Rotation.from_quat(np.roll(state["ned_from_body"], -1))).as_quat(
        canonical=True
    )
    stand(other, np.array([w, x, y, z]))
    other["gyro_bias_rad_s"] += error[GYRO_BIAS : GYRO_BIAS + 3]
    other["velocity_ned_m_s"] += error[VELOCITY : VELOCITY + 3]
    other["accel_bias_m_s2"] += error[ACCEL_BIAS : ACCEL_BIAS + 3]
    other["gyro_matrix"] += error[GYRO_MATRIX:WIND].reshape(3, 3)
    other["wind_ned_m_s"][:2] += error[WIND : WIND + 2]
    other["velocity_lag_s"] += error[LAG]
    return other


def error_between(state: Any, other: Any) -> Any:
    """The error [24] that leads from `state` to `other`."""
    error = np.zeros(ERROR_STATES)
    turn = Rotation.from_quat(np.roll(other["ned_from_body"], -1)) * (
        Rotation.from_quat(np.roll(state["ned_from_body"], -1)).inv()
    )
    error[:3] = turn.as_rotvec()
    error[GYRO_BIAS : GYRO_BIAS + 3] = other["gyro_bias_rad_s"] - state["gyro_bias_rad_s"]
    error[VELOCITY : VELOCITY + 3] = other["velocity_ned_m_s"] - state["velocity_ned_m_s"]
    error[ACCEL_BIAS : ACCEL_BIAS + 3] = other["accel_bias_m_s2"] - state["accel_bias_m_s2"]
    error[GYRO_MATRIX:WIND] = (other["gyro_matrix"] - state["gyro_matrix"]).ravel()
    error[WIND : WIND + 2] = (other["wind_ned_m_s"] - state["wind_ned_m_s"])[:2]
    error[LAG] = other["velocity_lag_s"] - state["velocity_lag_s"]
    return error


def rows_of(measure: Callable[[Any], Any], state: Any) -> Any:
    """Matrix H [M, 24] by central differences: how `measure` [M] of the truth grows with errors."""
    columns = []
    for n in range(ERROR_STATES):
        error = np.zeros(ERROR_STATES)
        error[n] = STEP
        ahead, behind = measure(moved(state, error)), measure(moved(state, -error))
        columns.append((np.asarray(ahead) - np.asarray(behind)) / (2.0 * STEP))
    return np.stack(columns, axis=1)


def update(p: Any, h: Any, innovations: Any, variances: Any) -> tuple[Any, Any]:
    """Kalman's update in one piece: correction [24] and covariance [24, 24]."""
    s = h @ p @ h.T + np.diag(variances)
    gain = np.linalg.solve(s, h @ p).T
    return gain @ np.asarray(innovations), p - gain @ h @ p


def tilt_of(force_ned: Any) -> Any:
    """Angles about north and east [2] [rad] between a force and up: to first order f x up / g."""
    north, east, down = force_ned
    horizontal = np.hypot(north, east)
    scale = np.arctan2(horizontal, -down) / horizontal
    return scale * np.array([-east, north])
