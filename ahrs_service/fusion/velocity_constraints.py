"""What is known of the vehicle's velocity through the air: its class, drag, airspeed, the wind.

The filter integrates the specific force to a velocity. A wrong tilt makes it run away by g psi t,
which a bound on the velocity reveals; the acceleration of a turn does not, since it comes with the
velocity that turns. A fixed wing moves along its nose, so its velocity along y and z is about 0
and the centripetal force in a turn is explained without any speed sensor. Where the air resists a
motion along an axis, the accelerometer measures it (Leishman et al. 2014 for rotors; a fixed wing's
side force and lift likewise):

    f = f0 - v / T,    v = -T (f - f0)

T [s] by class and axis, f0 = -g along z in level flight, else 0.
"""

import math
from typing import Final

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.fusion import ground_velocity
from ahrs_service.fusion.mekf import correct, correct_state
from ahrs_service.fusion.states import ACCEL_BIAS, AIDED, VELOCITY, WIND
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Airframe, Record

MOTION_FIELDS: Final = [
    ("airspeed_m_s", "f8"),
    ("airspeed_time_ns", "i8"),
]
"""Fields of the pipeline's state that this module keeps."""

DRAG_SHARE: Final = 0.3
"""By how much T may be wrong: size and loading differ within a class."""
DRAG_LARGE: Final = 4.0
"""So many sigmas of the class are doubted where the velocity integrated is as far from them: a
vehicle that is tilted by hand measures gravity along its axes, as drag would at some 20 m/s, but
does not move; one that flies fast does."""
TRIM_CORRELATION_S: Final = 60.0
"""The bounds' errors, trim and mounting, are constant; a measured velocity reveals them."""
AIRSPEED_SIGMA_M_S: Final = 2.0
"""A choice, with the next [m/s], [s]:"""
AIRSPEED_CORRELATION_S: Final = 20.0
"""Position and scale error of a pitot tube on a small UAV, which stay over a manoeuvre."""
AIRSPEED_VALID_NS: Final = 1_000_000_000
"""A choice: an older airspeed is not used [ns]."""
AIRSPEED_MIN_M_S: Final = 3.0
"""A pitot tube reads nothing below this [m/s]."""

_FIXED_WING = int(Airframe.FIXED_WING)


@kernel
def hear_airspeed(state: Record, sample: Record) -> None:
    """Keep the newest airspeed [m/s] and its time."""
    if abs(sample["airspeed_m_s"]) < ground_velocity.FASTEST_M_S:
        state["airspeed_m_s"] = sample["airspeed_m_s"]
        state["airspeed_time_ns"] = sample["time_ns"]


@kernel
def airspeed_is_fresh(state: Record) -> bool:
    """Return whether the airspeed is of the last second."""
    # After a clock that was set back the last one lies ahead.
    return bool(0 <= state["time_ns"] - state["airspeed_time_ns"] < AIRSPEED_VALID_NS)


@kernel
def _airspeed_is_usable(settings: Record, state: Record, airframe: int) -> bool:
    flown = settings["use_airspeed"] != 0 and airframe == _FIXED_WING
    return flown and airspeed_is_fresh(state) and state["airspeed_m_s"] > AIRSPEED_MIN_M_S


@inlined_kernel
def bound_velocity(settings: Record, state: Record, airframe: int, dt_s: float) -> None:
    """Measure the velocity through the air by what the airframe can do, or by airspeed.

    With axis a of the body in earth axes, v_body = a . (v - wind), so h = (a x (v - wind), a, -a)
    for the errors of angle, velocity and wind.
    """
    h = state["measured"]
    measured = state["states"] == AIDED and ground_velocity.is_fresh(state)
    for i in range(3):
        expected = settings["forward_speed_m_s"][airframe] if i == 0 else 0.0
        sigma = settings["velocity_sigma_m_s"][airframe, i]
        correlation_s = settings["velocity_correlation_s"][airframe, i]
        drag_s = settings["drag_s"][airframe, i]
        if i == 0 and _airspeed_is_usable(settings, state, airframe):
            expected = state["airspeed_m_s"]
            sigma, correlation_s, drag_s = AIRSPEED_SIGMA_M_S, AIRSPEED_CORRELATION_S, 0.0
        if state["update_force_s"] > 0.0 and drag_s > 0.0:
            level = -STANDARD_GRAVITY_M_S2 if i == 2 else 0.0
            by_drag = -drag_s * (state["update_force_m_s"][i] / state["update_force_s"] - level)
            expected += by_drag
            # A wing's slip is small against its speed: there the size alone is doubted.
            unlike = by_drag if airframe == _FIXED_WING else expected - _speed_along(state, i)
            large = min(by_drag * by_drag, unlike * unlike) / (DRAG_LARGE * sigma)
            sigma = math.sqrt(sigma * sigma + (DRAG_SHARE * by_drag) ** 2 + large * large)
            h[ACCEL_BIAS + i] = -drag_s
        if measured:
            correlation_s = max(correlation_s, TRIM_CORRELATION_S)
        variance = sigma * sigma * max(1.0, correlation_s / dt_s)
        _correct_along(state, i, expected, variance)
        h[ACCEL_BIAS + i] = 0.0
    if measured:
        return
    sigma = settings["climb_sigma_m_s"][airframe]
    variance = sigma * sigma * max(1.0, settings["climb_correlation_s"][airframe] / dt_s)
    correct_state(state, VELOCITY + 2, -state["velocity_ned_m_s"][2], variance)


@inlined_kernel
def _speed_along(state: Record, i: int) -> float:
    """Return the velocity through the air along body axis `i` [m/s], as it was integrated."""
    velocity, wind, dcm = state["velocity_ned_m_s"], state["wind_ned_m_s"], state["dcm"]
    north, east = velocity[0] - wind[0], velocity[1] - wind[1]
    return float(dcm[0, i] * north + dcm[1, i] * east + dcm[2, i] * velocity[2])


@inlined_kernel
def _correct_along(state: Record, i: int, expected: float, variance: float) -> None:
    """Measure the velocity through the air along body axis `i`."""
    velocity, wind, dcm = state["velocity_ned_m_s"], state["wind_ned_m_s"], state["dcm"]
    h = state["measured"]
    x, y, z = dcm[0, i], dcm[1, i], dcm[2, i]
    u, v, w = velocity[0] - wind[0], velocity[1] - wind[1], velocity[2]
    h[0], h[1], h[2] = y * w - z * v, z * u - x * w, x * v - y * u
    h[VELOCITY], h[VELOCITY + 1], h[VELOCITY + 2] = x, y, z
    if state["states"] == AIDED:
        h[WIND], h[WIND + 1] = -x, -y
    innovation = expected - (x * u + y * v + z * w)
    correct(state, innovation, variance)
    for j in range(3):
        h[j] = h[VELOCITY + j] = h[WIND + j] = 0.0
