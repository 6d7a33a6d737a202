"""The estimator: one step from a sample to an estimate, and the batch that loops it.

compensation > strapdown > gate > correction. No clock, no input or output: the live service calls
`step` per sample, a replay calls `batch`, and both run the same compiled code, so that the same
samples give the same bytes. Three structs: parameters (from settings), coefficients (from the
calibration) and state, which can be saved and restored by its bytes at any sample.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import alignment, gating, heading, mekf, strapdown, timebase
from ahrs_service.kernel import kernel
from ahrs_service.records import Flag, Floats, Gate, Phase, Record, Rows
from ahrs_service.rotation import down_in_body, matrix
from ahrs_service.sensor.compensation import compensate
from ahrs_service.settings import Settings

_ALIGNING = int(Phase.ALIGNING)
_RUNNING = int(Phase.RUNNING)
_STALE = int(Gate.STALE)
_SATURATION = int(Gate.SATURATION)
_GAP = int(Flag.GAP)
_CLOCK_JUMP = int(Flag.CLOCK_JUMP)
_NOT_FINITE = int(Flag.NOT_FINITE)
_ACCEL_MISSING = int(Flag.ACCEL_MISSING)
_SPIKE = int(Flag.SPIKE)
_SATURATED = int(Flag.SATURATED)
_IMU_CHANGED = int(Flag.IMU_CHANGED)
_REALIGNED = int(Flag.REALIGNED)

REALIGN_GAP_S: Final = 5.0
"""After a gap longer than this the attitude before it says little: align anew [s]."""
GAP_RATE_SIGMA_RAD_S: Final = 0.5
"""What a small UAV may have turned, per second that no sample came [rad/s]."""
ACCEL_CORRELATION_S: Final = 1.0
"""Manoeuvre accelerations last about this long: closer samples are not independent [s]."""
DOUBT_RAD_RTS: Final = 0.05
"""How fast the tilt variance grows while only the innovation speaks against it [rad/sqrt(s)]."""
SPIKE_RATE_RAD_S: Final = 10.0
"""No airframe changes its rate by this much between two samples [rad/s]."""

PARAMETERS_DTYPE: Final = np.dtype(
    [
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
        ("accel_noise_m_s2", "f8"),
        ("alignment_s", "f8"),
        ("gap_s", "f8"),
        ("declination_rad", "f8"),
        ("use_magnetometer", "i8"),
    ]
)

STATE_DTYPE: Final = np.dtype(
    [
        *timebase.TIME_FIELDS,
        *alignment.ALIGNMENT_FIELDS,
        *heading.HEADING_FIELDS,
        ("ned_from_body", "f8", 4),
        ("gyro_bias_rad_s", "f8", 3),
        ("covariance", "f8", (strapdown.ERROR_STATES, strapdown.ERROR_STATES)),
        ("rate_rad_s", "f8", 3),
        ("smooth_rate_rad_s", "f8", 3),
        ("angular_acceleration_rad_s2", "f8", 3),
        ("force_ned_m_s2", "f8", 3),
        ("spikes", "i8"),
        ("spike_time_ns", "i8"),
        ("phase", "i8"),
        ("gate", "i8"),
    ]
)


def new_state() -> Rows:
    """Return the state [1] before the first sample."""
    state = np.zeros(1, STATE_DTYPE)
    state["ned_from_body"][0, 0] = 1.0
    return state


def parameters(settings: Settings) -> Rows:
    """Return the kernel's parameters [1]."""
    row = np.zeros(1, PARAMETERS_DTYPE)
    gate, fusion = settings.gate, settings.fusion
    row["gate_norm_m_s2"] = gate.norm_m_s2
    row["gate_rate_rad_s"] = gate.rate_rad_s
    row["gate_angular_acceleration_rad_s2"] = gate.angular_acceleration_rad_s2
    row["gate_innovation_sigma"] = gate.innovation_sigma
    row["accel_range_m_s2"] = gate.accel_range_m_s2
    row["gyro_range_rad_s"] = gate.gyro_range_rad_s
    row["smoothing_s"] = gate.smoothing_s
    row["gyro_noise_rad_s_rthz"] = fusion.gyro_noise_rad_s_rthz
    row["gyro_bias_walk_rad_s2_rthz"] = fusion.gyro_bias_walk_rad_s2_rthz
    row["gyro_bias_sigma_rad_s"] = fusion.gyro_bias_sigma_rad_s
    row["accel_noise_m_s2"] = fusion.accel_noise_m_s2
    row["alignment_s"] = fusion.alignment_s
    row["gap_s"] = fusion.gap_s
    row["declination_rad"] = math.radians(fusion.declination_deg)
    row["use_magnetometer"] = fusion.magnetometer
    return row


@kernel
def _check_sensors(
    settings: Record, state: Record, sample: Record, gyro: Floats, accel: Floats
) -> int:
    """Find clipped, missing and impossible values; a single impossible rate is held back."""
    flags = 0
    gyro_finite = accel_finite = True
    clipped = False
    jump2 = 0.0
    for i in range(3):
        gyro_finite = gyro_finite and math.isfinite(gyro[i])
        accel_finite = accel_finite and math.isfinite(accel[i])
        clipped = clipped or abs(sample["gyro_rad_s"][i]) >= settings["gyro_range_rad_s"]
        clipped = clipped or abs(sample["accel_m_s2"][i]) >= settings["accel_range_m_s2"]
        jump2 += (gyro[i] - state["rate_rad_s"][i] - state["gyro_bias_rad_s"][i]) ** 2
    if not gyro_finite:
        return _NOT_FINITE
    if clipped:
        flags |= _SATURATED
    if not accel_finite:
        flags |= _ACCEL_MISSING
    known = state["samples"] > 1 and state["interval_s"] < timebase.LOW_RATE_INTERVAL_S
    # The same sample again confirms nothing.
    confirmed = state["spikes"] != 0 and sample["time_ns"] != state["spike_time_ns"]
    if known and jump2 > SPIKE_RATE_RAD_S**2 and not confirmed:
        state["spikes"] = 1
        state["spike_time_ns"] = sample["time_ns"]
        return flags | _SPIKE
    state["spikes"] = 0
    return flags


@kernel
def _propagate(settings: Record, state: Record, gyro: Floats, dt_s: float, flags: int) -> None:
    """Integrate the attitude over the step and let the covariance grow.

    The rate between two samples is known to half of what it changed, so a slow or irregular
    stream widens the covariance by itself.
    """
    rate = np.empty(3)
    change2 = 0.0
    for i in range(3):
        rate[i] = gyro[i] - state["gyro_bias_rad_s"][i]
        change2 += (rate[i] - state["rate_rad_s"][i]) ** 2
    variance = settings["gyro_noise_rad_s_rthz"] ** 2 * dt_s
    if flags & _GAP:
        variance += (GAP_RATE_SIGMA_RAD_S * dt_s) ** 2
    else:
        variance += change2 * dt_s * dt_s / 48.0
        strapdown.rotate(state["ned_from_body"], state["rate_rad_s"], rate, dt_s)
    ned_from_body = np.empty((3, 3))
    matrix(state["ned_from_body"], ned_from_body)
    walk = settings["gyro_bias_walk_rad_s2_rthz"] ** 2 * dt_s
    strapdown.grow_covariance(state["covariance"], ned_from_body, dt_s, variance, walk)
    alignment.bound_tilt(state["covariance"])
    weight = dt_s / (settings["smoothing_s"] + dt_s)
    for i in range(3):
        step = weight * (rate[i] - state["smooth_rate_rad_s"][i])
        state["smooth_rate_rad_s"][i] += step
        state["angular_acceleration_rad_s2"][i] = step / dt_s
        state["rate_rad_s"][i] = rate[i]


@kernel
def _average_force(settings: Record, state: Record, accel: Floats, dt_s: float) -> None:
    """Average the specific force in earth axes, where gravity stands still while the body turns."""
    ned_from_body = np.empty((3, 3))
    matrix(state["ned_from_body"], ned_from_body)
    weight = dt_s / (settings["smoothing_s"] + dt_s)
    for i in range(3):
        force = 0.0
        for j in range(3):
            force += ned_from_body[i, j] * accel[j]
        state["force_ned_m_s2"][i] += weight * (force - state["force_ned_m_s2"][i])


@kernel
def _norm(v: Floats) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@kernel
def _correct_tilt(settings: Record, state: Record, dt_s: float, flags: int, out: Record) -> None:
    """Judge the averaged force by the gates and correct the tilt where they are open."""
    metrics = np.empty(3)
    tilt = np.empty(2)
    correction = np.zeros(6)
    p = state["covariance"]
    metrics[0] = abs(_norm(state["force_ned_m_s2"]) - STANDARD_GRAVITY_M_S2)
    metrics[1] = _norm(state["smooth_rate_rad_s"])
    metrics[2] = _norm(state["angular_acceleration_rad_s2"])
    mekf.tilt_from_force(state["force_ned_m_s2"], tilt)
    sigma2 = (settings["accel_noise_m_s2"] / STANDARD_GRAVITY_M_S2) ** 2
    spread2 = max(p[0, 0], p[1, 1]) + sigma2
    sigmas = math.sqrt((tilt[0] * tilt[0] + tilt[1] * tilt[1]) / spread2)
    reasons = gating.motion_reasons(
        metrics,
        settings["gate_norm_m_s2"],
        settings["gate_rate_rad_s"],
        settings["gate_angular_acceleration_rad_s2"],
    )
    if flags & _SATURATED:
        reasons |= _SATURATION
    if flags & _ACCEL_MISSING:
        reasons |= _STALE
    if reasons == 0:
        reasons = gating.innovation_reason(sigmas, settings["gate_innovation_sigma"])
        if reasons != 0 and state["phase"] == _RUNNING:
            # Steady motion that contradicts the attitude: sooner or later the attitude is wrong.
            p[0, 0] += DOUBT_RAD_RTS**2 * dt_s
            p[1, 1] += DOUBT_RAD_RTS**2 * dt_s
    usable = flags & (_SATURATED | _ACCEL_MISSING) == 0
    if reasons == 0 or (state["phase"] == _ALIGNING and usable):
        if state["phase"] == _ALIGNING:
            sigma2 += (metrics[0] / STANDARD_GRAVITY_M_S2) ** 2
        variance = sigma2 * max(1.0, ACCEL_CORRELATION_S / dt_s)
        mekf.correct_axis(p, correction, 0, tilt[0], variance)
        mekf.correct_axis(p, correction, 1, tilt[1], variance)
        mekf.apply_correction(
            state["ned_from_body"], state["gyro_bias_rad_s"], state["force_ned_m_s2"], correction
        )
    state["gate"] = reasons
    _write_gate(metrics, tilt, sigmas, state["ned_from_body"], out)


@kernel
def _write_gate(metrics: Floats, tilt: Floats, sigmas: float, q: Floats, out: Record) -> None:
    """Note what the gate saw; the innovation is turned into body axes."""
    body = np.empty((3, 3))
    matrix(q, body)
    out["gate_norm_m_s2"] = metrics[0]
    out["gate_rate_rad_s"] = metrics[1]
    out["gate_angular_acceleration_rad_s2"] = metrics[2]
    out["gate_innovation"] = sigmas
    for i in range(3):
        out["innovation_rad"][i] = body[0, i] * tilt[0] + body[1, i] * tilt[1]


@kernel
def _write_estimate(state: Record, sample: Record, accel: Floats, flags: int, out: Record) -> None:
    down = np.empty(3)
    down_in_body(state["ned_from_body"], down)
    out["time_ns"] = sample["time_ns"]
    out["received_ns"] = sample["received_ns"]
    for i in range(4):
        out["ned_from_body"][i] = state["ned_from_body"][i]
    for i in range(3):
        out["rate_rad_s"][i] = state["rate_rad_s"][i]
        out["accel_m_s2"][i] = accel[i]
        out["gyro_bias_rad_s"][i] = state["gyro_bias_rad_s"][i]
        out["attitude_sigma_rad"][i] = math.sqrt(state["covariance"][i, i])
        out["gyro_bias_sigma_rad_s"][i] = math.sqrt(state["covariance"][3 + i, 3 + i])
        out["residual_m_s2"][i] = accel[i] + STANDARD_GRAVITY_M_S2 * down[i]
    out["temperature_degc"] = sample["temperature_degc"]
    out["gate"] = state["gate"]
    out["flags"] = flags
    out["phase"] = state["phase"]
    out["source"] = sample["source"]


@kernel
def _clear_gate(out: Record) -> None:
    out["gate_norm_m_s2"] = np.nan
    out["gate_rate_rad_s"] = np.nan
    out["gate_angular_acceleration_rad_s2"] = np.nan
    out["gate_innovation"] = np.nan
    for i in range(3):
        out["innovation_rad"][i] = np.nan


@kernel
def _realign_if_lost(settings: Record, state: Record, dt_s: float, flags: int) -> int:
    """Start to align at the first sample, and anew when the attitude was lost."""
    long_gap = flags & _GAP != 0 and dt_s > REALIGN_GAP_S
    lost = long_gap or flags & (_CLOCK_JUMP | _IMU_CHANGED) != 0
    if state["phase"] == 0:
        alignment.start(state, settings["gyro_bias_sigma_rad_s"])
        state["phase"] = _ALIGNING
    elif lost:
        alignment.start(state, settings["gyro_bias_sigma_rad_s"])
        state["phase"] = _ALIGNING
        flags |= _REALIGNED
    return flags


@kernel
def _step(settings: Record, coefficients: Rows, state: Record, sample: Record, out: Record) -> None:
    gyro, accel = np.empty(3), np.empty(3)
    flags = sample["flags"] | compensate(
        coefficients,
        sample["gyro_rad_s"],
        sample["accel_m_s2"],
        sample["temperature_degc"],
        gyro,
        accel,
    )
    _clear_gate(out)
    found = _check_sensors(settings, state, sample, gyro, accel)
    flags |= found
    if not found & (_NOT_FINITE | _SPIKE):
        dt_s, timing = timebase.advance(state, sample["time_ns"], settings["gap_s"])
        flags |= timing
        if not timing & timebase.NOT_INTEGRATED:
            flags = _realign_if_lost(settings, state, dt_s, flags)
            _move(settings, state, sample, gyro, accel, dt_s, flags, out)
    _write_estimate(state, sample, accel, flags, out)


@kernel
def _move(
    settings: Record,
    state: Record,
    sample: Record,
    gyro: Floats,
    accel: Floats,
    dt_s: float,
    flags: int,
    out: Record,
) -> None:
    """Take one good sample: integrate, align or correct."""
    if state["aligned_samples"] == 0:
        if flags & _ACCEL_MISSING:
            return
        alignment.first_attitude(state, gyro, accel)
        heading.first_heading(settings, state, sample["mag_ut"])
        return
    if dt_s <= 0.0:
        return
    _propagate(settings, state, gyro, dt_s, flags)
    if not flags & _ACCEL_MISSING:
        _average_force(settings, state, accel, dt_s)
    _correct_tilt(settings, state, dt_s, flags, out)
    heading.correct(settings, state, sample["mag_ut"], dt_s)
    if state["phase"] == _ALIGNING and alignment.gather(
        state, gyro, accel, settings["alignment_s"]
    ):
        state["phase"] = _RUNNING


@kernel
def step(parameters: Rows, coefficients: Rows, state: Rows, sample: Rows, estimate: Rows) -> None:
    """Take one sample [1], move `state` [1] on and write the estimate [1]."""
    _step(parameters[0], coefficients, state[0], sample[0], estimate[0])


@kernel
def batch(
    parameters: Rows, coefficients: Rows, state: Rows, samples: Rows, estimates: Rows
) -> None:
    """Take `samples` [N] one after the other and write `estimates` [N]: the same as N steps."""
    for n in range(samples.shape[0]):
        _step(parameters[0], coefficients, state[0], samples[n], estimates[n])
