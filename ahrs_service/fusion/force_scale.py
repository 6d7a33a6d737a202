"""The accelerometer's scale, by what it measures of gravity while nothing accelerates the vehicle.

An autopilot whose accelerometer nobody calibrated reads up to 1 m/s^2 too high: the gates take
that as an acceleration and stay closed, and the velocity runs away by it. Quiet, which is neither
shake nor turn, norm(f) is g0 for a vehicle at rest and on the mean for one that flies, so that

    scale <- scale (1 + k (g0 / norm(f) - 1)),    k = V / (V + R)

V the variance of the scale, R that of one norm.
"""

import math
from typing import Final

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import zero_velocity
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Record

SCALE_FIELDS: Final = [("force_scale", "f8"), ("force_scale_variance", "f8")]
"""Fields of the pipeline's state that this module keeps."""

SIGMA: Final = 0.04
"""Offset of 30 mg and scale of 3 %, 1-sigma of a sensor as delivered (data sheets: 80 mg, 3 %); a
class whose `accel_scale_error` is smaller, or whose `accel_bias_sigma_m_s2` is 0, has a better."""
LARGEST: Final = 3.0 * SIGMA
"""Three of these are no sensor's error any more."""
WALK_SHARE_RTS: Final = 0.025
"""By which share of its sigma it moves: what is an offset looks like another scale once the vehicle
is tilted [1/sqrt(s)]."""
REST_M_S2: Final = 0.05
"""A choice, with the next:"""
QUIET_M_S2: Final = 0.5
"""What accelerates a vehicle at rest and one that is moved about without shake, [m/s^2],"""
CORRELATION_S: Final = 1.0
"""for so long one way [s]."""
QUIET_SHAKE_M_S2: Final = zero_velocity.FORCE_SIGMA_M_S2
"""The same limit of the same variance as at rest [m/s^2]."""
QUIET_RATE_RAD_S: Final = 0.2
"""A choice: 11 deg/s; a lever arm of 0.5 m then adds 0.02 m/s^2 of centripetal acceleration."""


@kernel
def sigma_of(settings: Record, airframe: int) -> float:
    """1-sigma of the scale before it is learnt."""
    if settings["accel_bias_sigma_m_s2"][airframe] == 0.0:
        return 0.0
    return min(float(settings["accel_scale_error"][airframe]), SIGMA)


@kernel
def start(settings: Record, state: Record, airframe: int) -> None:
    """Doubt the scale; what was found of it is kept."""
    if not abs(state["force_scale"] - 1.0) < 2.0 * LARGEST:
        state["force_scale"] = 1.0
    state["force_scale_variance"] = sigma_of(settings, airframe) ** 2


@inlined_kernel
def learn(settings: Record, state: Record, airframe: int, dt_s: float) -> None:
    """Correct the scale by the mean force of a quiet update."""
    walk_rts = WALK_SHARE_RTS * sigma_of(settings, airframe)
    state["force_scale_variance"] += walk_rts * walk_rts * dt_s
    force, rate = state["mean_force_m_s2"], state["smooth_rate_rad_s"]
    rate2 = rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2]
    if not (state["force_variance"] < QUIET_SHAKE_M_S2**2 and rate2 < QUIET_RATE_RAD_S**2):
        return
    norm = math.sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2])
    if not abs(norm - STANDARD_GRAVITY_M_S2) < LARGEST * STANDARD_GRAVITY_M_S2:
        return
    sigma = (REST_M_S2 if state["at_rest"] != 0 else QUIET_M_S2) / STANDARD_GRAVITY_M_S2
    variance = state["force_scale_variance"]
    k = variance / (variance + sigma * sigma * max(1.0, CORRELATION_S / dt_s))
    change = 1.0 + k * (STANDARD_GRAVITY_M_S2 / norm - 1.0)
    state["force_scale"] *= change
    state["force_scale_variance"] = (1.0 - k) * variance
    zero_velocity.rescale_force(state, change)
