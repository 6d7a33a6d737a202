"""The estimator: one step from a sample to an estimate, and the batch that loops it.

Each sample: compensation > vehicle's axes > strapdown. Each update (fusion.propagation): covariance
> gate > corrections by gravity, by rest or what bounds the velocity, by the magnetic field, by a
measured velocity. No clock, no input or output: live service and replay call `batch`, for one
sample or many, so that the same samples give the same bytes. Three structs: parameters (from
settings), coefficients (from the calibration) and state, which can be saved and restored by its
bytes at any sample.
"""

import dataclasses
import math
from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import (
    alignment,
    filter_state,
    force_scale,
    gating,
    gravity,
    ground_velocity,
    heading,
    mekf,
    plausibility,
    propagation,
    smoother_history,
    timebase,
    velocity_constraints,
    zero_velocity,
)
from ahrs_service.fusion.states import GYRO_BIAS
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Airframe, Flag, Floats, Phase, Record, Rows
from ahrs_service.sensor.compensation import compensate_sample
from ahrs_service.sensor.thermometer import THERMOMETER_FIELDS, forget_temperature
from ahrs_service.settings import Settings
from ahrs_service.vehicle_axes import rotate_to_vehicle

_ALIGNING = int(Phase.ALIGNING)
_RUNNING = int(Phase.RUNNING)
_GAP = int(Flag.GAP)
_NOT_FINITE = int(Flag.NOT_FINITE)
_ACCEL_MISSING = int(Flag.ACCEL_MISSING)
_SPIKE = int(Flag.SPIKE)
_SATURATED = int(Flag.SATURATED)
_UNCOMPENSATED = int(Flag.UNCOMPENSATED | Flag.TEMPERATURE_OUT_OF_RANGE)
_IMU_CHANGED = int(Flag.IMU_CHANGED)
_REALIGNED = int(Flag.REALIGNED)
_JUDGED_AT_ONCE = _SATURATED | _ACCEL_MISSING | _GAP

REALIGN_GAP_S: Final = 5.0
"""After a gap longer than this the attitude before it says little: align anew [s]."""

PARAMETERS_DTYPE: Final = np.dtype(
    [
        ("forward_speed_m_s", "f8", len(Airframe)),
        ("velocity_sigma_m_s", "f8", (len(Airframe), 3)),
        ("velocity_correlation_s", "f8", (len(Airframe), 3)),
        ("accel_noise_m_s2", "f8", len(Airframe)),
        ("velocity_noise_m_s_rts", "f8", len(Airframe)),
        ("accel_scale_error", "f8", len(Airframe)),
        ("accel_bias_sigma_m_s2", "f8", len(Airframe)),
        ("gyro_matrix_sigma", "f8", len(Airframe)),
        ("shaken_bias_walk_s_m_rts", "f8", len(Airframe)),
        ("drag_s", "f8", (len(Airframe), 3)),
        ("climb_sigma_m_s", "f8", len(Airframe)),
        ("climb_correlation_s", "f8", len(Airframe)),
        ("gate_norm_m_s2", "f8"),
        ("gate_rate_rad_s", "f8"),
        ("gate_angular_acceleration_rad_s2", "f8"),
        ("gate_innovation_sigma", "f8"),
        ("accel_range_m_s2", "f8"),
        ("gyro_range_rad_s", "f8"),
        ("smoothing_s", "f8"),
        ("gyro_noise_rad_s_rthz", "f8"),
        ("gyro_bias_walk_rad_s2_rthz", "f8"),
        ("gyro_bias_sigma_rad_s", "f8"),
        ("gyro_rest_sigma_rad_s", "f8"),
        ("gyro_bias_per_rtdegc_rad_s", "f8"),
        ("compensated_bias_per_rtdegc_rad_s", "f8"),
        ("gyro_scale_error_rts", "f8"),
        ("alignment_s", "f8"),
        ("gap_s", "f8"),
        ("declination_rad", "f8"),
        ("samples_are_means", "i8"),
        ("use_magnetometer", "i8"),
        ("use_airspeed", "i8"),
        ("use_velocity", "i8"),
        ("use_ground_velocity", "i8"),
        ("velocity_lag_s", "f8"),
        ("airframe", "i8"),
    ]
)

STATE_DTYPE: Final = np.dtype(
    [
        *timebase.TIME_FIELDS,
        *THERMOMETER_FIELDS,
        *filter_state.FILTER_FIELDS,
        *mekf.MEKF_FIELDS,
        *alignment.ALIGNMENT_FIELDS,
        *gravity.GRAVITY_FIELDS,
        *heading.HEADING_FIELDS,
        *propagation.PROPAGATION_FIELDS,
        *zero_velocity.REST_FIELDS,
        *force_scale.SCALE_FIELDS,
        *velocity_constraints.MOTION_FIELDS,
        *ground_velocity.AIDING_FIELDS,
        *plausibility.PLAUSIBILITY_FIELDS,
        ("gyro_rad_s", "f8", 3),
        ("accel_m_s2", "f8", 3),
        ("attitude_sigma_rad", "f8", 3),
        ("gyro_bias_sigma_rad_s", "f8", 3),
        ("phase", "i8"),
    ]
)
"""What the estimator remembers, the compensated sample and its matrix `dcm` included.

Saved and restored by its bytes.
"""


def new_state() -> Rows:
    """Return the state [1] before the first sample."""
    state = np.zeros(1, STATE_DTYPE)
    state["ned_from_body"][0, 0] = 1.0
    state["dcm"][0] = np.eye(3)
    forget_temperature(state[0])
    return state


def parameters(settings: Settings) -> Rows:
    """Return the kernel's parameters [1]."""
    row = np.zeros(1, PARAMETERS_DTYPE)
    gate, fusion = gating.in_force(settings), settings.fusion
    for name in PARAMETERS_DTYPE.names or ():
        if hasattr(fusion, name):
            if not isinstance(getattr(fusion, name), str):
                row[name] = getattr(fusion, name)
        elif hasattr(gate, name.removeprefix("gate_")):
            row[name] = getattr(gate, name.removeprefix("gate_"))
    for number in Airframe:
        airframe = getattr(settings, number.name.lower())
        for field in dataclasses.fields(airframe):
            row[field.name][0, number] = getattr(airframe, field.name)
    row["compensated_bias_per_rtdegc_rad_s"] = fusion.gyro_bias_per_rtdegc_rad_s
    row["declination_rad"] = math.radians(fusion.declination_deg)
    row["samples_are_means"] = fusion.gyro_sample == "mean"
    row["use_magnetometer"] = fusion.magnetometer
    row["use_velocity"] = fusion.mode == "velocity"
    row["airframe"] = -1 if fusion.airframe == "auto" else Airframe[fusion.airframe.upper()]
    return row


@inlined_kernel
def _update(
    settings: Record, state: Record, sample: Record, airframe: int, flags: int, nodes: Rows | None
) -> None:
    """Propagate the covariance, then correct by all that is known of the vehicle's motion."""
    if nodes is not None:
        smoother_history.leave(state, nodes[0])
    is_compensated = flags & _UNCOMPENSATED == 0
    propagation.grow(settings, state, sample["temperature_degc"], is_compensated)
    dt_s = state["update_s"]
    gravity.judge(settings, state, airframe, dt_s, flags)
    uses_velocity = settings["use_velocity"] != 0
    at_rest = uses_velocity and zero_velocity.come_to_rest(state)
    if uses_velocity:
        force_scale.learn(settings, state, airframe, dt_s)
    if at_rest:
        zero_velocity.doubt_bias(state, dt_s)
    if nodes is not None:
        smoother_history.arrive(state, nodes[1])
    if at_rest:
        zero_velocity.hold(state, dt_s, settings["gyro_rest_sigma_rad_s"])
    else:
        gravity.correct(settings, state, airframe, flags)
        if uses_velocity:
            velocity_constraints.bound_velocity(settings, state, airframe, dt_s)
    heading.correct(settings, state)
    if uses_velocity and settings["use_ground_velocity"] != 0:
        ground_velocity.remember(state)
        ground_velocity.correct_velocity(settings, state, airframe)
        ground_velocity.shift_history(state)
    propagation.begin_update(state)
    mekf.settle(state)
    mekf.apply_correction(state)
    _summarise(state)


@kernel
def _summarise(state: Record) -> None:
    """Keep the sigmas of attitude and bias, which move only when an update ends.

    What the magnetic field corrects after that shows with the next update: late, never too small.
    """
    p = state["covariance"]
    for i in range(3):
        state["attitude_sigma_rad"][i] = math.sqrt(p[i, i])
        state["gyro_bias_sigma_rad_s"][i] = math.sqrt(p[GYRO_BIAS + i, GYRO_BIAS + i])
    state["attitude_sigma_rad"][2] = heading.sigma(state)


@kernel
def _write_gate(state: Record, out: Record) -> None:
    """Write what the gate saw at the last update; the innovation is rotated into body axes."""
    dcm, metrics, tilt = state["dcm"], state["gate_metrics"], state["tilt_innovation_rad"]
    out["gate_norm_m_s2"] = metrics[0]
    out["gate_rate_rad_s"] = metrics[1]
    out["gate_angular_acceleration_rad_s2"] = metrics[2]
    out["gate_innovation"] = metrics[3]
    for i in range(3):
        out["innovation_rad"][i] = dcm[0, i] * tilt[0] + dcm[1, i] * tilt[1]


@kernel
def _write_estimate(state: Record, sample: Record, accel: Floats, flags: int, out: Record) -> None:
    out["time_ns"] = sample["time_ns"]
    out["received_ns"] = sample["received_ns"]
    for i in range(4):
        out["ned_from_body"][i] = state["ned_from_body"][i]
    for i in range(3):
        out["rate_rad_s"][i] = state["rate_rad_s"][i]
        out["accel_m_s2"][i] = accel[i]
        out["gyro_bias_rad_s"][i] = state["gyro_bias_rad_s"][i]
        out["attitude_sigma_rad"][i] = state["attitude_sigma_rad"][i]
        out["gyro_bias_sigma_rad_s"][i] = state["gyro_bias_sigma_rad_s"][i]
        out["residual_m_s2"][i] = accel[i] + STANDARD_GRAVITY_M_S2 * state["dcm"][2, i]
    out["temperature_degc"] = sample["temperature_degc"]
    out["gate"] = state["gate"]
    out["flags"] = flags
    out["phase"] = state["phase"]
    out["source"] = sample["source"]


@kernel
def _realign_if_lost(
    settings: Record, state: Record, sample: Record, dt_s: float, flags: int
) -> int:
    """Start to align at the first sample, and anew when the attitude was lost."""
    long_gap = flags & _GAP != 0 and dt_s > REALIGN_GAP_S
    lost = long_gap or flags & _IMU_CHANGED != 0
    if state["phase"] != 0 and not lost:
        return flags
    if lost:
        flags |= _REALIGNED
    _begin(settings, state, _airframe(settings, sample))
    return flags


@kernel
def _begin(settings: Record, state: Record, airframe: int) -> None:
    """Begin to align."""
    alignment.start(settings, state, airframe)
    propagation.begin_update(state)
    _summarise(state)
    state["phase"] = _ALIGNING


@kernel
def _airframe(settings: Record, sample: Record) -> int:
    """Return the class of airframe in force: as set, else as heard."""
    return int(sample["airframe"]) if settings["airframe"] < 0 else int(settings["airframe"])


@inlined_kernel
def take(
    settings: Record,
    coefficients: Record,
    state: Record,
    sample: Record,
    out: Record,
    nodes: Rows | None,
) -> None:
    """Take one sample; where there are `nodes` [2], the last and the next, note updates there."""
    gyro, accel = state["gyro_rad_s"], state["accel_m_s2"]
    flags = compensate_sample(coefficients, state, sample)
    rotate_to_vehicle(sample["vehicle_from_board"], gyro)
    rotate_to_vehicle(sample["vehicle_from_board"], accel)
    found = plausibility.check(settings, state, sample, gyro, accel)
    flags |= found
    if not found & (_NOT_FINITE | _SPIKE):
        dt_s, timing = timebase.advance(
            state, sample["time_ns"], sample["received_ns"], settings["gap_s"]
        )
        flags |= timing
        if not timing & timebase.NOT_INTEGRATED:
            flags = _realign_if_lost(settings, state, sample, dt_s, flags)
            _move(settings, state, sample, gyro, accel, dt_s, flags, nodes)
    _write_estimate(state, sample, accel, flags, out)
    if found & _NOT_FINITE:
        _doubt(settings, state, sample, out)
    _write_gate(state, out)


@kernel
def _doubt(settings: Record, state: Record, sample: Record, out: Record) -> None:
    """Widen the sigma of an attitude that stands still for want of a rate."""
    since_s = (sample["time_ns"] - state["time_ns"]) * 1e-9
    if since_s > settings["gap_s"]:
        rotated = propagation.GAP_RATE_SIGMA_RAD_S * since_s
        for i in range(3):
            sigma = math.hypot(out["attitude_sigma_rad"][i], rotated)
            out["attitude_sigma_rad"][i] = min(sigma, math.pi)


@inlined_kernel
def _move(
    settings: Record,
    state: Record,
    sample: Record,
    gyro: Floats,
    accel: Floats,
    dt_s: float,
    flags: int,
    nodes: Rows | None,
) -> None:
    """Take one good sample: integrate, and at the end of an update correct."""
    airframe = _airframe(settings, sample)
    velocity_constraints.hear_airspeed(state, sample)
    if settings["use_ground_velocity"] != 0:
        ground_velocity.hear_velocity(state, sample)
    if state["aligned_samples"] == 0:
        if flags & _ACCEL_MISSING == 0:
            alignment.first_attitude(settings, state, airframe, gyro, accel)
            heading.first_heading(settings, state, sample["mag_ut"])
            _summarise(state)
        return
    if dt_s <= 0.0:
        return
    for i in range(3):
        accel[i] = accel[i] * state["force_scale"] - state["accel_bias_m_s2"][i]
    propagation.move(settings, state, airframe, gyro, accel, dt_s, flags)
    if flags & _GAP != 0:
        zero_velocity.break_off(state)
        ground_velocity.break_off(state)
    elif flags & _ACCEL_MISSING == 0 and settings["use_velocity"] != 0:
        zero_velocity.follow(state, gyro, accel, dt_s, settings["gyro_rest_sigma_rad_s"])
    if settings["use_magnetometer"] != 0:
        heading.gather(state, sample["mag_ut"], dt_s)
    if state["update_s"] + 0.5 * dt_s >= propagation.UPDATE_S or flags & _JUDGED_AT_ONCE != 0:
        _update(settings, state, sample, airframe, flags, nodes)
        if not alignment.is_sound(state):
            _begin(settings, state, airframe)
            return
        heading.seek(settings, state, ground_velocity.is_fresh(state))
    if state["phase"] == _ALIGNING and alignment.gather(settings, state, airframe, gyro, accel):
        state["phase"] = _RUNNING
        _summarise(state)


@kernel
def step(parameters: Rows, coefficients: Rows, state: Rows, sample: Rows, estimate: Rows) -> None:
    """Take one sample [1], move `state` [1] on and write the estimate [1]."""
    take(parameters[0], coefficients[0], state[0], sample[0], estimate[0], None)


@kernel
def batch(
    parameters: Rows, coefficients: Rows, state: Rows, samples: Rows, estimates: Rows
) -> None:
    """Take `samples` [N] one after the other and write `estimates` [N]: the same as N steps."""
    for n in range(samples.shape[0]):
        take(parameters[0], coefficients[0], state[0], samples[n], estimates[n], None)
