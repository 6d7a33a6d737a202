"""When the accelerometer may be taken for the vertical (Liu et al., sec. 4).

A correction is let in only if all hold: abs(norm(f) - g0) < eps_a, norm(w) < eps_w,
norm(dw/dt) < eps_alpha, the innovation is within its expected size and no axis clips. A rejection
is a value: the bits of records.Gate name every limit that was exceeded.

A horizontal acceleration a_h moves norm(f) by about a_h^2 / (2 g) only: a norm gate of width eps
admits a_h up to sqrt(2 g eps), which is a tilt error of about sqrt(2 eps / g) rad.
"""

import math

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats, Gate

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
