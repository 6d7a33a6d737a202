"""The first attitude: gravity at once, then averaged; at rest also the gyro's bias.

A fixed wing that turns is in the air: the force along y and z is that of the turn as well.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import (
    filter_state,
    force_scale,
    ground_velocity,
    heading,
    mekf,
    propagation,
    zero_velocity,
)
from ahrs_service.fusion.filter_state import HEADING_SIGMA_RAD
from ahrs_service.fusion.states import (
    ACCEL_BIAS,
    ERROR_STATES,
    GATED,
    GYRO_BIAS,
    GYRO_MATRIX,
    UNAIDED,
    VELOCITY,
)
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Floats, Record
from ahrs_service.rotation import from_euler, matrix, to_euler

ALIGNMENT_FIELDS: Final = [
    ("aligned_samples", "i8"),
    ("alignment_start_ns", "i8"),
    ("gyro_sum_rad_s", "f8", 3),
    ("gyro_square_sum", "f8", 3),
    ("force_error_sum", "f8"),
]
"""Fields of the pipeline's state that this module keeps."""

TILT_SIGMA_RAD: Final = 0.5
"""Of the attitude from one reading of a vehicle that may be moving [rad]."""
MIN_SAMPLES: Final = 3
"""A choice: a mean and a spread need more than two, however short `alignment_s` is set."""
REST_RATE_SPREAD_RAD_S: Final = 0.02
"""At rest the gyro's spread is below this even on a vibrating ground [rad/s]."""
REST_RATE_RAD_S: Final = 0.15
"""Turn-on bias of a consumer MEMS gyro stays below this: 5 deg/s and some reserve [rad/s]."""
REST_FORCE_ERROR_M_S2: Final = 0.5
"""A choice: 51 mg, 1.3 force_scale.SIGMA of g; zero_velocity allows more, but waits for a rest."""
REST_BIAS_SIGMA_RAD_S: Final = 0.002
"""Of a bias averaged at rest over about a second [rad/s]."""
FLOWN_RATE_RAD_S: Final = 0.06
"""Three 1-sigma of a gyro's bias: what turns its path so flies, at 15 m/s with 5 deg of bank."""
HELD_M_S2: Final = 0.6
"""S() of the force's norm in steady flight: by so much gravity alone explains the force better."""
REST_BIAS_SIGMAS: Final = 2.0
"""A fixed wing's mean rate beyond so many 1-sigma of the bias is rather a smooth wide turn."""


@kernel
def forget_sensors(settings: Record, state: Record, airframe: int) -> None:
    """Know no more of the sensors than before the first sample; the attitude is kept."""
    filter_state.reset_sensors(state)
    if state["states"] > 0:
        _doubt_sensors(settings, state["covariance"], airframe)


@kernel
def _doubt_sensors(settings: Record, p: Floats, airframe: int) -> None:
    """Set the errors of the sensors to what is left by their calibration, independent of all."""
    gyro_matrix_sigma = settings["gyro_matrix_sigma"][airframe]
    sigmas = (
        (GYRO_BIAS, settings["gyro_bias_sigma_rad_s"]),
        (ACCEL_BIAS, settings["accel_bias_sigma_m_s2"][airframe]),
        (GYRO_MATRIX, gyro_matrix_sigma),
        (GYRO_MATRIX + 3, gyro_matrix_sigma),
        (GYRO_MATRIX + 6, gyro_matrix_sigma),
    )
    for first, sigma in sigmas:
        for i in range(first, first + 3):
            mekf.forget(p, i, sigma**2)


@kernel
def start(settings: Record, state: Record, airframe: int) -> None:
    """Forget attitude and velocity and begin to align; what was found of the sensors is kept."""
    p = state["covariance"]
    force_scale.start(settings, state, airframe)
    filter_state.reset(state, UNAIDED if settings["use_velocity"] != 0 else GATED)
    for i in range(2):
        mekf.forget(p, i, TILT_SIGMA_RAD**2)
    mekf.forget(p, 2, HEADING_SIGMA_RAD**2)
    speed = max(
        settings["forward_speed_m_s"][airframe], settings["velocity_sigma_m_s"][airframe, 0]
    )
    for i in range(VELOCITY, VELOCITY + 3):
        mekf.forget(p, i, speed**2)
    _doubt_sensors(settings, p, airframe)
    ground_velocity.reset(state)
    heading.take_source(state, heading.NONE)
    for i in range(3):
        state["gyro_sum_rad_s"][i] = 0.0
        state["gyro_square_sum"][i] = 0.0
    state["force_error_sum"] = 0.0
    state["aligned_samples"] = 0
    state["alignment_start_ns"] = state["time_ns"]


@inlined_kernel
def is_sound(state: Record) -> bool:
    """Return whether the state can be gone on with; where not, its wrecks are cleared away.

    Damaged saved bytes can bring a state here that no flight does: not finite, or of no variance.
    """
    q = state["ned_from_body"]
    sound = abs(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1.0) < 1e-6
    states = state["states"]
    sound = sound and states in (GATED, UNAIDED, ERROR_STATES)
    sound = sound and abs(state["velocity_lag_s"]) < math.inf
    for i in range(states if sound else 0):
        sound = sound and 0.0 <= state["covariance"][i, i] < math.inf
    for i in range(3):
        sound = sound and state["covariance"][i, i] > 0.0
        for j in range(3):
            sound = sound and abs(state["gyro_matrix"][i, j]) < 1.0
    for vector in (
        state["gyro_bias_rad_s"],
        state["accel_bias_m_s2"],
        state["velocity_ned_m_s"],
        state["force_ned_m_s2"],
        state["smooth_rate_rad_s"],
    ):
        for i in range(3):
            sound = sound and abs(vector[i]) < math.inf
    if not sound:
        filter_state.clear(state)
    return bool(sound)


@kernel
def first_attitude(
    settings: Record, state: Record, airframe: int, gyro: Floats, accel: Floats
) -> None:
    """Set roll and pitch from one specific force [3] [m/s^2]; the heading is kept, 0 at first.

    A fixed wing in a turn moves along its nose with the usual speed V of its class, and what is
    left of the force is gravity: w x V e_x - f = -(f_x, f_y - V r, f_z + V q). Held in a hand the
    force is gravity as it stands.
    """
    speed = _speed(settings, airframe)
    propagation.first_rate(state, gyro)
    # What rolls in place turns no path.
    if math.hypot(state["rate_rad_s"][1], state["rate_rad_s"][2]) < FLOWN_RATE_RAD_S:
        speed = 0.0
    across = accel[1] - speed * state["rate_rad_s"][2]
    down = accel[2] + speed * state["rate_rad_s"][1]
    still = math.sqrt(accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2])
    flown = math.sqrt(accel[0] * accel[0] + across * across + down * down)
    # What turns by hand feels gravity as it is.
    nearer = abs(flown - STANDARD_GRAVITY_M_S2) - abs(still - STANDARD_GRAVITY_M_S2)
    if nearer > HELD_M_S2:
        speed, across, down = 0.0, accel[1], accel[2]
    before = np.empty(3)
    to_euler(state["ned_from_body"], before)
    roll = math.atan2(-across, -down)
    pitch = math.atan2(accel[0], math.sqrt(across * across + down * down))
    from_euler(roll, pitch, before[2], state["ned_from_body"])
    matrix(state["ned_from_body"], state["dcm"])
    propagation.first_force(state, accel)
    zero_velocity.start(state, accel)
    state["aligned_samples"] = 1
    if speed > 0.0:
        _begin_in_flight(settings, state, airframe, speed)


@kernel
def _speed(settings: Record, airframe: int) -> float:
    """Return the speed [m/s] along x that the filter takes a vehicle of the class to fly with."""
    return float(settings["forward_speed_m_s"][airframe]) if settings["use_velocity"] != 0 else 0.0


@kernel
def _begin_in_flight(settings: Record, state: Record, airframe: int, speed: float) -> None:
    """Set velocity and its covariance to those of the class; doubt the accelerometer's scale.

    v = C v_body, so its error is that of v_body, rotated, and psi x v. It may as well be held in a
    hand, so the speed is known to itself only. No rest has shown the scale, and a flight seldom
    will: most of the force is along z, so a bias there stands for it.
    """
    p, v, dcm = state["covariance"], state["velocity_ned_m_s"], state["dcm"]
    sigma = settings["velocity_sigma_m_s"][airframe]
    along = max(sigma[0], speed)
    scaled = STANDARD_GRAVITY_M_S2 * force_scale.sigma_of(settings, airframe)
    p[ACCEL_BIAS + 2, ACCEL_BIAS + 2] += scaled * scaled
    for i in range(3):
        v[i] = speed * dcm[i, 0]
    for i in range(3):
        for j in range(3):
            p[VELOCITY + i, VELOCITY + j] = 0.0
            for k in range(3):
                one = along if k == 0 else sigma[k]
                p[VELOCITY + i, VELOCITY + j] += dcm[i, k] * dcm[j, k] * one * one
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        # psi about k turns v from i to j.
        for m, turned in ((i, -v[j]), (j, v[i])):
            p[VELOCITY + m, k] = p[k, VELOCITY + m] = turned * p[k, k]
        p[VELOCITY + i, VELOCITY + i] += v[j] * v[j] * p[k, k]
        p[VELOCITY + j, VELOCITY + j] += v[i] * v[i] * p[k, k]
        p[VELOCITY + i, VELOCITY + j] -= v[i] * v[j] * p[k, k]
        p[VELOCITY + j, VELOCITY + i] -= v[i] * v[j] * p[k, k]


@kernel
def gather(settings: Record, state: Record, airframe: int, gyro: Floats, accel: Floats) -> bool:
    """Add a sample to the alignment; return whether it is complete.

    If the vehicle stood still all the time, the mean rate is the gyro's bias.
    """
    norm = math.sqrt(accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2])
    state["force_error_sum"] += abs(norm - STANDARD_GRAVITY_M_S2)
    for i in range(3):
        state["gyro_sum_rad_s"][i] += gyro[i]
        state["gyro_square_sum"][i] += gyro[i] * gyro[i]
    state["aligned_samples"] += 1
    elapsed_s = (state["time_ns"] - state["alignment_start_ns"]) * 1e-9
    if state["aligned_samples"] <= MIN_SAMPLES or elapsed_s < settings["alignment_s"]:
        return False
    _take_rest_bias(settings, state, airframe)
    return True


@kernel
def _take_rest_bias(settings: Record, state: Record, airframe: int) -> None:
    """Take the mean rate for the bias if rate and force were those of a vehicle at rest."""
    count = state["aligned_samples"] - 1
    largest = REST_RATE_RAD_S
    if _speed(settings, airframe) > 0.0:
        largest = REST_BIAS_SIGMAS * settings["gyro_bias_sigma_rad_s"]
    rest = state["force_error_sum"] / count < REST_FORCE_ERROR_M_S2
    for i in range(3):
        mean = state["gyro_sum_rad_s"][i] / count
        spread2 = state["gyro_square_sum"][i] / count - mean * mean
        rest = rest and abs(mean) < largest and spread2 < REST_RATE_SPREAD_RAD_S**2
    if not rest:
        return
    for i in range(3):
        bias = state["gyro_sum_rad_s"][i] / count
        filter_state.set_gyro_bias(state, i, bias, REST_BIAS_SIGMA_RAD_S)
