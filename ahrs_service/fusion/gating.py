"""When the accelerometer may be used as the vertical (Liu et al., sec. 4).

A correction is let in only if all hold: abs(norm(f) - g0) < eps_a, norm(w) < eps_w,
norm(dw/dt) < eps_alpha, the innovation is within its expected size and no axis clips. A rejection
is a value: the bits of records.Gate name every limit that was exceeded.

A horizontal acceleration a_h moves norm(f) by about a_h^2 / (2 g) only: a norm gate of width eps
admits a_h up to sqrt(2 g eps), which is a tilt error of about sqrt(2 eps / g) rad. The paper's
width for a_a = 0.17 m/s^2 (1 deg of tilt) is 1.5 m/s^2 and so lets 5.6 m/s^2 (30 deg) pass; what
holds such turns off is the limit of norm(w). A budget stated as a tilt has no such gap, but needs
S() to stay open at all: 1 deg is a width of 1.5 mm/s^2. `limits` resolves either.
"""

import math
from dataclasses import replace

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Gate
from ahrs_service.settings import GateSettings, Settings

_NORM = int(Gate.NORM)
_RATE = int(Gate.RATE)
_ANGULAR_ACCELERATION = int(Gate.ANGULAR_ACCELERATION)
_INNOVATION = int(Gate.INNOVATION)


@kernel
def motion_reasons(metrics: Floats, norm: float, rate: float, angular_acceleration: float) -> int:
    """Compare `metrics` [3] (force norm error, rate, angular acceleration) with their limits."""
    reasons = 0
    if not metrics[0] < norm:
        reasons |= _NORM
    if not metrics[1] < rate:
        reasons |= _RATE
    if not metrics[2] < angular_acceleration:
        reasons |= _ANGULAR_ACCELERATION
    return reasons


@kernel
def innovation_reason(tilt_sigmas: float, limit: float) -> int:
    """Compare the tilt innovation, in its own sigmas, with `limit`."""
    return 0 if tilt_sigmas < limit else _INNOVATION


def norm_limit_from_acceleration(acceleration_m_s2: float, steady_sigma_m_s2: float = 0.0) -> float:
    """Gate width eps_a [m/s^2] that admits a linear acceleration a_a (Liu et al., sec. 4).

    W_fx = W_fy = sqrt(((a_a + g)^2 - g^2) / 3), W_fz = a_a / sqrt(3), eps_a = norm(W) + S, S the
    standard deviation of abs(norm(f) - g0) in steady flight.
    """
    g = STANDARD_GRAVITY_M_S2
    across2 = ((acceleration_m_s2 + g) ** 2 - g**2) / 3.0
    return math.sqrt(2.0 * across2 + acceleration_m_s2**2 / 3.0) + steady_sigma_m_s2


def norm_limit_from_tilt(tilt_rad: float, steady_sigma_m_s2: float = 0.0) -> float:
    """Gate width [m/s^2] beyond which a horizontal acceleration tilts by more than `tilt_rad`.

    eps = g (1 / cos(tilt) - 1) + S.
    """
    return STANDARD_GRAVITY_M_S2 * (1.0 / math.cos(tilt_rad) - 1.0) + steady_sigma_m_s2


def rate_limit(
    acceleration_m_s2: float, radius_m: float, arm_m: float, steady_sigma_rad_s: float = 0.0
) -> float:
    """Gate width eps_w [rad/s] for a centripetal acceleration a_w (Liu et al., sec. 4).

    eps_w = sqrt(a_w / R) + S with the turn radius R, or the sensor's arm where that is longer.
    """
    return math.sqrt(acceleration_m_s2 / max(radius_m, arm_m)) + steady_sigma_rad_s


def angular_acceleration_limit(
    acceleration_m_s2: float, arm_m: tuple[float, float, float], steady_sigma_rad_s2: float = 0.0
) -> float:
    """Gate width eps_alpha [rad/s^2] for a tangential acceleration a_alpha (Liu et al., sec. 4).

    W_ay = a_alpha / sqrt(3 (Lx^2 + Lz^2)), eps_alpha = sqrt(3) W_ay + S: the strict case of a
    sensor far ahead of or behind the centre of mass.
    """
    arm = math.hypot(arm_m[0], arm_m[2])
    return acceleration_m_s2 / arm + steady_sigma_rad_s2


def in_force(settings: Settings) -> GateSettings:
    """Return the limits that the filter compares with: a budget's in the gated mode alone.

    There the gates decide alone what corrects; the velocity mode only takes a little more from an
    open gate, and was better on every class of airframe with the limits as set explicitly.
    """
    return limits(settings) if settings.fusion.mode == "gated" else settings.gate


def limits(settings: Settings) -> GateSettings:
    """Return the gate's limits: from `gate_budget` where that states one, else as set explicitly.

    Applying it to settings that have its result for their `gate` gives the same again.
    """
    budget, gate = settings.gate_budget, settings.gate
    if budget.acceleration_m_s2 is not None:
        norm = norm_limit_from_acceleration(budget.acceleration_m_s2, budget.norm_sigma_m_s2)
        gate = replace(gate, norm_m_s2=norm)
    elif budget.tilt_deg is not None:
        norm = norm_limit_from_tilt(math.radians(budget.tilt_deg), budget.norm_sigma_m_s2)
        gate = replace(gate, norm_m_s2=norm)
    if budget.centripetal_m_s2 is not None:
        arm_m = math.hypot(*budget.arm_m)
        rate = rate_limit(
            budget.centripetal_m_s2, budget.turn_radius_m, arm_m, budget.rate_sigma_rad_s
        )
        gate = replace(gate, rate_rad_s=rate)
    if budget.tangential_m_s2 is not None:
        angular = angular_acceleration_limit(
            budget.tangential_m_s2, budget.arm_m, budget.angular_acceleration_sigma_rad_s2
        )
        gate = replace(gate, angular_acceleration_rad_s2=angular)
    return gate
