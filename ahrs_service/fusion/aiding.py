"""Velocity over ground as it is measured: by satellites, late, or by the autopilot's own filter.

The filter's velocity is that through the air as long as nothing measures it; with the first
measurement the wind becomes a state, so that what the airframe can do still bounds the velocity
through the air and the filter falls back to that where the measurements vanish.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.fusion.mekf import correct_by
from ahrs_service.fusion.strapdown import ERROR_STATES, LAG, WIND
from ahrs_service.kernel import kernel
from ahrs_service.records import Airframe, Floats, Record
from ahrs_service.rotation import from_rotation_vector, matrix, multiply, normalise

HISTORY: Final = 64
AIDING_FIELDS: Final = [
    ("wind_m_s", "f8", 2),
    ("measured_velocity_m_s", "f8", 3),
    ("measured_time_ns", "i8"),
    ("measured_new", "i8"),
    ("history_time_ns", "i8", HISTORY),
    ("history_m_s", "f8", (HISTORY, 3)),
    ("history_next", "i8"),
    ("match_before_m_s", "f8", 4),
    ("match_time_ns", "i8"),
    ("match", "f8", 4),
    ("lag_s", "f8"),
    ("velocity_doubted", "i8"),
    ("velocity_surprise", "f8"),
]
WIND_SIGMA_M_S: Final = 5.0
VELOCITY_SIGMA_M_S: Final = 0.5
VELOCITY_CORRELATION_S: Final = 1.0
COURSE_SPEED_M_S: Final = 8.0
COURSE_SIGMA_RAD: Final = 0.35
LAG_SIGMA_S: Final = 0.15
SURPRISE_LIMIT: Final = 8.0
MATCH_ENOUGH: Final = 30.0
_FIXED_WING = int(Airframe.FIXED_WING)


@kernel
def hear_velocity(state: Record, sample: Record) -> None:
    """Keep a new velocity [3] [m/s]; the same numbers again are no new measurement."""
    v, known = sample["velocity_ned_m_s"], state["measured_velocity_m_s"]
    if not (math.isfinite(v[0]) and math.isfinite(v[1])):
        return
    if v[0] == known[0] and v[1] == known[1]:
        return
    for i in range(3):
        known[i] = v[i]
    state["measured_time_ns"] = sample["time_ns"]
    state["measured_new"] = 1


@kernel
def remember(state: Record) -> None:
    k = state["history_next"]
    state["history_time_ns"][k] = state["time_ns"]
    for i in range(3):
        state["history_m_s"][k, i] = state["velocity_ned_m_s"][i]
    state["history_next"] = (k + 1) % HISTORY


@kernel
def _velocity_at(state: Record, time_ns: int, out: Floats) -> bool:
    """Velocity at a past time, between two turns; False where it is not remembered."""
    newest = (state["history_next"] - 1) % HISTORY
    k = newest
    for _ in range(HISTORY - 1):
        before = (k - 1) % HISTORY
        t0, t1 = state["history_time_ns"][before], state["history_time_ns"][k]
        if t0 == 0 or t1 <= t0:
            return False
        if t0 <= time_ns <= t1:
            share = (time_ns - t0) / (t1 - t0)
            for i in range(3):
                a, b = state["history_m_s"][before, i], state["history_m_s"][k, i]
                out[i] = a + share * (b - a)
            return True
        k = before
    return False


@kernel
def _turn_heading(state: Record, angle: float) -> None:
    """Turn all that is about the earth's axes by `angle` [rad] about down."""
    q = state["ned_from_body"]
    multiply(from_rotation_vector(0.0, 0.0, angle), q, q)
    normalise(q)
    matrix(q, state["dcm"])
    c, s = math.cos(angle), math.sin(angle)
    p = state["covariance"]
    for first in (0, 6):
        for j in range(ERROR_STATES):
            a, b = p[first, j], p[first + 1, j]
            p[first, j], p[first + 1, j] = c * a - s * b, s * a + c * b
        for i in range(ERROR_STATES):
            a, b = p[i, first], p[i, first + 1]
            p[i, first], p[i, first + 1] = c * a - s * b, s * a + c * b
    for name_k in range(2):
        v = state["velocity_ned_m_s"] if name_k == 0 else state["force_ned_m_s2"]
        a, b = v[0], v[1]
        v[0], v[1] = c * a - s * b, s * a + c * b
    for k in range(HISTORY):
        a, b = state["history_m_s"][k, 0], state["history_m_s"][k, 1]
        state["history_m_s"][k, 0], state["history_m_s"][k, 1] = c * a - s * b, s * a + c * b


@kernel
def _begin(state: Record, heading_sigma: float) -> None:
    """Bring the wind in: velocity over ground = velocity through the air + wind."""
    p = state["covariance"]
    if heading_sigma > 0.0:
        for j in range(ERROR_STATES):
            p[2, j] = 0.0
            p[j, 2] = 0.0
        p[2, 2] = heading_sigma**2
        state["heading_source"] = 2
    for i in range(2):
        for j in range(ERROR_STATES):
            p[WIND + i, j] = 0.0
            p[j, WIND + i] = 0.0
        if state["at_rest"] == 0:
            p[6 + i, 6 + i] += WIND_SIGMA_M_S**2
            p[6 + i, WIND + i] = p[WIND + i, 6 + i] = WIND_SIGMA_M_S**2
        p[WIND + i, WIND + i] = WIND_SIGMA_M_S**2
        state["wind_m_s"][i] = 0.0
    for j in range(ERROR_STATES):
        p[LAG, j] = 0.0
        p[j, LAG] = 0.0
    p[LAG, LAG] = LAG_SIGMA_S**2
    state["states"] = ERROR_STATES


@kernel
def _find_heading(state: Record, airframe: int, delayed: Floats) -> bool:
    """Find the heading by course or by comparing changes of velocity."""
    v = state["measured_velocity_m_s"]
    if airframe == _FIXED_WING and state["velocity_doubted"] == 0 and v[0] * v[0] + v[1] * v[1] > COURSE_SPEED_M_S**2:
        yaw = math.atan2(state["dcm"][1, 0], state["dcm"][0, 0])
        _turn_heading(state, math.atan2(v[1], v[0]) - yaw)
        _begin(state, COURSE_SIGMA_RAD)
        return True
    before = state["match_before_m_s"]
    dt_s = (state["measured_time_ns"] - state["match_time_ns"]) * 1e-9
    if 0.0 < dt_s < 3.0:
        a, b = v[0] - before[0], v[1] - before[1]
        c, d = delayed[0] - before[2], delayed[1] - before[3]
        m = state["match"]
        m[0] += a * c + b * d
        m[1] += b * c - a * d
        m[2] += a * a + b * b
        m[3] += c * c + d * d
        fade = math.exp(-dt_s / 60.0)
        for i in range(4):
            m[i] *= fade
        strength = math.hypot(m[0], m[1])
        if strength > MATCH_ENOUGH and strength > 0.85 * math.sqrt(m[2] * m[3]):
            _turn_heading(state, math.atan2(m[1], m[0]))
            _begin(state, 0.3)
            return True
    before[0], before[1], before[2], before[3] = v[0], v[1], delayed[0], delayed[1]
    state["match_time_ns"] = state["measured_time_ns"]
    return False


@kernel
def correct_velocity(settings: Record, state: Record, airframe: int, correction: Floats) -> None:
    """Correct by a new measurement of the velocity over ground."""
    if state["measured_new"] == 0:
        return
    delayed, later = np.empty(3), np.empty(3)
    if state["lag_s"] == 0.0:
        state["lag_s"] = settings["velocity_lag_s"]
    taken_ns = state["measured_time_ns"] - int(state["lag_s"] * 1e9)
    known = _velocity_at(state, taken_ns, delayed)
    known = _velocity_at(state, min(taken_ns + 50_000_000, state["time_ns"]), later) and known
    if not known:
        return
    state["measured_new"] = 0
    if state["states"] < ERROR_STATES:
        if state["heading_source"] != 0:
            _begin(state, 0.0)
        else:
            _find_heading(state, airframe, delayed)
        # The turned state is corrected from the next measurement on.
        return
    h = np.zeros(ERROR_STATES)
    surprise = 0.0
    variance = VELOCITY_SIGMA_M_S**2 * settings["velocity_aid_factor"]
    for i in range(3):
        if math.isfinite(state["measured_velocity_m_s"][i]):
            h[6 + i] = 1.0
            h[LAG] = -(later[i] - delayed[i]) / 0.05
            nu = state["measured_velocity_m_s"][i] - delayed[i]
            nis = correct_by(state["covariance"], correction, ERROR_STATES, h, nu, variance, 4.0)
            surprise = max(surprise, nis)
            h[6 + i] = 0.0
    h[LAG] = 0.0
    state["velocity_surprise"] += 0.05 * (min(surprise, 50.0) - state["velocity_surprise"])
    if state["velocity_surprise"] > SURPRISE_LIMIT:
        # The heading is wrong: find it anew.
        state["velocity_surprise"] = 0.0
        state["heading_source"] = 0
        state["velocity_doubted"] = 1
        state["states"] = WIND
        for j in range(ERROR_STATES):
            state["covariance"][2, j] = state["covariance"][j, 2] = 0.0
        state["covariance"][2, 2] = math.pi**2
        for i in range(4):
            state["match"][i] = 0.0
        for i in range(2):
            state["velocity_ned_m_s"][i] -= state["wind_m_s"][i]
            state["wind_m_s"][i] = 0.0


@kernel
def shift(state: Record, correction: Floats) -> None:
    """Correct the remembered velocities as the present one."""
    for k in range(HISTORY):
        for i in range(3):
            state["history_m_s"][k, i] += correction[6 + i]
