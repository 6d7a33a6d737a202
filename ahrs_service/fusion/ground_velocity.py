"""The velocity over ground as it is measured: by satellites, late, or by the autopilot's filter.

As long as nothing measures it, the filter's velocity is that through the air. With the first
measurement the wind becomes a state, so that what the airframe can do still bounds the velocity
through the air, and the filter falls back on that where the measurements vanish. How late they
come is a state as well: v_measured(t) = v(t - lag), compared with the velocity as remembered.
"""

import math
from typing import Final

from ahrs_service.fusion import filter_state, heading, mekf
from ahrs_service.fusion.states import AIDED, ANGLE, LAG, VELOCITY, WIND
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Airframe, Record

Velocity = tuple[float, float, float]
"""North, east, down [m/s]."""

HISTORY: Final = 32
"""Turns that are remembered: 3.8 s."""
AIDING_FIELDS: Final = [
    ("measured_velocity_m_s", "f8", 3),
    ("measured_time_ns", "i8"),
    ("measured_new", "i8"),
    ("history_time_ns", "i8", HISTORY),
    ("history_m_s", "f8", (3, HISTORY)),
    ("history_next", "i8"),
    ("matched_time_ns", "i8"),
    ("matched_m_s", "f8", (2, 2)),
    ("match", "f8", 5),
    ("velocity_nis", "f8"),
    ("course_doubted", "i8"),
]
"""Fields of the pipeline's state that this module keeps."""

FASTEST_M_S: Final = 60.0
"""No small UAV is faster over ground: more is a filter that diverged or a receiver that lost
its satellites [m/s]."""
SPACING_NS: Final = 150_000_000
"""Receivers give 5 velocities a second, and filters smooth for longer: what comes sooner after
the last shares its error."""
VALID_NS: Final = 2_000_000_000
"""A choice: one missed at 1 Hz; with LAG_MAX_S it stays within the 3.8 s of HISTORY [ns]."""
WIND_SIGMA_M_S: Final = 5.0
"""Along north and along east [m/s]."""
SIGMA_M_S: Final = 0.5
"""Of a velocity by satellites in flight, along each axis [m/s]."""
LAG_SIGMA_S: Final = 0.15
"""A choice: of the lag about `velocity_lag_s` [s]."""
LAG_MAX_S: Final = 1.0
"""A choice: what is learnt is cut here; with VALID_NS it stays within the 3.8 s of HISTORY [s]."""
SLOPE_NS: Final = 50_000_000
"""A choice: the slope of the velocity is taken over this; below half an update of 0.12 s [ns]."""
OUTLIER_SIGMA: Final = 4.0
"""Noise of 3 axes, 5 times a second, exceeds it once in 18 min; beyond, the weight falls."""
TILT_SIGMA_RAD: Final = 0.15
"""With a tilt less known than that the filter is not linear enough for a velocity [rad]."""
COURSE_SPEED_M_S: Final = 8.0
"""A fixed wing faster than this flies about where it points [m/s];"""
COURSE_SIGMA_RAD: Final = 0.35
"""about: a wind of 5 m/s across 14 m/s [rad]."""
MATCH_SPAN_S: Final = 3.0
"""A choice: over a longer gap between two velocities no change is compared [s]."""
MATCH_APART_S: Final = 0.8
"""Changes are those over about a second, whatever the receiver's rate: an acceleration of 1 m/s^2
is lost in its noise from one of five fixes a second to the next."""
MATCH_FORGET_S: Final = 60.0
"""A choice: over this the changes compared fade [s]."""
MATCH_ENOUGH_M2_S2: Final = 60.0
"""Sum of the squared changes of velocity from which a heading is found [m^2/s^2],"""
MATCH_KNOWN_RAD: Final = 0.1
"""if what the changes do not share leaves it a 1-sigma of this [rad];"""
MATCH_SIGMA_RAD: Final = 0.3
"""assumed three times that: a delay rotates all changes of a manoeuvre alike [rad]."""
MATCH_COUNT: Final = 4.0
"""A choice, with the next; MATCH_APART_S makes it 3.2 s at least."""
MATCH_LEFT_M_S: Final = 2.0
"""A velocity whose changes are not ours to this is not used, after so many of them [m/s]."""
COMPASS_RAD: Final = 0.5
"""Where the velocity gives another heading than the compass, it is not used either [rad]."""
PULLED_RAD: Final = 0.3
"""A choice: 17 deg are added to the tilt of a filter that lost its heading [rad]."""
SURPRISE_LIMIT: Final = 8.0
"""Mean square of the innovation in its variances beyond which the heading must be wrong: within
bounds it is 1, and a single outlier cannot bring it here."""
SURPRISE_WEIGHT: Final = 0.05
"""A choice: a mean over 20 velocities, 4 s at 5 Hz;"""
SURPRISE_MAX: Final = 50.0
"""a choice: from 1, four of these in a row pass SURPRISE_LIMIT (3.5, 5.8, 7.99, 10.1)."""

_FIXED_WING = int(Airframe.FIXED_WING)


@kernel
def hear_velocity(state: Record, sample: Record) -> None:
    """Keep a new velocity [3] [m/s]; the same numbers again, or impossible ones, are none."""
    v, known = sample["velocity_ned_m_s"], state["measured_velocity_m_s"]
    down = 0.0 if math.isnan(v[2]) else v[2]
    # False for what is not finite, too.
    possible = v[0] * v[0] + v[1] * v[1] + down * down <= FASTEST_M_S**2
    if not possible or (v[0] == known[0] and v[1] == known[1]):
        return
    if 0 <= sample["time_ns"] - state["measured_time_ns"] < SPACING_NS:
        return
    for i in range(3):
        known[i] = v[i]
    state["measured_time_ns"] = sample["time_ns"]
    state["measured_new"] = 1


@kernel
def is_fresh(state: Record) -> bool:
    """Return whether a velocity was measured in the last two seconds."""
    return bool(0 <= state["time_ns"] - state["measured_time_ns"] < VALID_NS)


@kernel
def remember(state: Record) -> None:
    """Remember the velocity at the end of an update."""
    n = state["history_next"]
    state["history_time_ns"][n] = state["time_ns"]
    for i in range(3):
        state["history_m_s"][i, n] = state["velocity_ned_m_s"][i]
    state["history_next"] = (n + 1) % HISTORY


@kernel
def _forget_history(state: Record) -> None:
    state["measured_new"] = 0
    for n in range(HISTORY):
        state["history_time_ns"][n] = 0


@kernel
def _forget_match(state: Record) -> None:
    for i in range(len(state["match"])):
        state["match"][i] = 0.0


@kernel
def reset(state: Record) -> None:
    """Forget what was remembered and compared: it was in axes that are now given up."""
    _forget_history(state)
    _forget_match(state)
    state["course_doubted"] = 0


@kernel
def break_off(state: Record) -> None:
    """Forget what was remembered: over a gap nothing lies between, and the tilt must be found."""
    _forget_history(state)
    if state["states"] == AIDED:
        _let_go(state)


@kernel
def _let_go(state: Record) -> None:
    """Go on with the velocity through the air: that over ground without the wind."""
    mekf.settle(state)
    for i in range(2):
        for n in range(HISTORY):
            state["history_m_s"][i, n] -= state["wind_ned_m_s"][i]
    filter_state.let_wind_go(state)
    _forget_match(state)
    state["velocity_nis"] = 0.0


@kernel
def _velocity_at(state: Record, time_ns: int) -> tuple[bool, Velocity]:
    """Whether a past time lies between two updates that are remembered, and the velocity then."""
    times, v = state["history_time_ns"], state["history_m_s"]
    after = (state["history_next"] - 1) % HISTORY
    for _ in range(HISTORY - 1):
        before = (after - 1) % HISTORY
        if times[before] == 0 or times[after] <= times[before]:
            break
        if times[before] <= time_ns <= times[after]:
            share = (time_ns - times[before]) / (times[after] - times[before])
            return True, (
                v[0, before] + share * (v[0, after] - v[0, before]),
                v[1, before] + share * (v[1, after] - v[1, before]),
                v[2, before] + share * (v[2, after] - v[2, before]),
            )
        after = before
    return False, (0.0, 0.0, 0.0)


@inlined_kernel
def correct_velocity(settings: Record, state: Record, airframe: int) -> None:
    """Correct by a new measurement of the velocity over ground.

    Until the velocity is believed, the measurement goes to find out whether it agrees with ours.
    """
    if state["measured_new"] == 0:
        return
    if state["states"] != AIDED and state["velocity_lag_s"] == 0.0:
        state["velocity_lag_s"] = settings["velocity_lag_s"]
    lag_ns = int(min(max(state["velocity_lag_s"], 0.0), LAG_MAX_S) * 1e9)
    taken_ns = state["measured_time_ns"] - lag_ns
    is_known, then = _velocity_at(state, taken_ns)
    if not is_known:
        if state["time_ns"] - taken_ns > VALID_NS:
            state["measured_new"] = 0
        return
    later_ns = min(taken_ns + SLOPE_NS, state["time_ns"])
    has_slope, later = _velocity_at(state, later_ns)
    state["measured_new"] = 0
    if state["states"] == AIDED:
        has_slope = has_slope and later_ns > taken_ns
        slope_per_s = 1e9 / (later_ns - taken_ns) if has_slope else 0.0
        _take(state, then, later, slope_per_s)
    elif mekf.tilt_variance(state["covariance"]) < TILT_SIGMA_RAD**2:
        _match(state, then)
        _begin_if_it_agrees(state, airframe)


@kernel
def _take(state: Record, then: Velocity, later: Velocity, slope_per_s: float) -> None:
    """Correct by each component there is; an outlier counts less, by its square."""
    h, correction = state["measured"], state["correction"]
    measured, surprise = state["measured_velocity_m_s"], 0.0
    for i in range(3):
        if not math.isfinite(measured[i]):
            continue
        innovation = measured[i] - then[i]
        n = VELOCITY + i
        h[n], h[LAG] = 1.0, -(later[i] - then[i]) * slope_per_s
        by_lag2 = h[LAG] * h[LAG] * mekf.variance_of(state, LAG)
        expected2 = mekf.variance_of(state, n) + by_lag2 + SIGMA_M_S**2
        square = innovation * innovation / expected2
        variance = SIGMA_M_S**2 * max(1.0, square / OUTLIER_SIGMA**2)
        mekf.correct(state, innovation, variance)
        surprise = max(surprise, min(square, SURPRISE_MAX))
        h[n] = h[LAG] = 0.0
    state["velocity_nis"] += SURPRISE_WEIGHT * (surprise - state["velocity_nis"])
    if state["velocity_nis"] > SURPRISE_LIMIT:
        _lose_heading(state)
        for i in range(2):
            correction[VELOCITY + i] -= correction[WIND + i]
            correction[WIND + i] = 0.0
        correction[LAG] = 0.0


@kernel
def _begin(state: Record, heading_sigma_rad: float) -> None:
    """Bring the wind in: velocity over ground = velocity through the air + wind."""
    mekf.settle(state)
    if heading_sigma_rad > 0.0:
        mekf.forget(state["covariance"], ANGLE + 2, heading_sigma_rad**2)
        heading.take_source(state, heading.VELOCITY)
    filter_state.bring_wind_in(state, WIND_SIGMA_M_S, LAG_SIGMA_S, state["at_rest"] != 0)
    state["velocity_nis"] = 0.0


@kernel
def _lose_heading(state: Record) -> None:
    """Go on without the measured velocity until it gives a heading that agrees with it."""
    _let_go(state)
    heading.take_source(state, heading.NONE)
    state["course_doubted"] = 1
    mekf.forget(state["covariance"], ANGLE + 2, math.pi**2)
    for i in range(2):
        # An attitude that was pulled by what cannot be right is not as good as it thinks.
        filter_state.widen(state, i, PULLED_RAD**2)


@kernel
def _match(state: Record, then: Velocity) -> None:
    """Compare how the measured velocity and the filter's changed since the measurement before."""
    v, match, matched = state["measured_velocity_m_s"], state["match"], state["matched_m_s"]
    span_s = (state["measured_time_ns"] - state["matched_time_ns"]) * 1e-9
    if 0.0 < span_s < MATCH_APART_S:
        return
    if 0.0 < span_s < MATCH_SPAN_S:
        a, b = v[0] - matched[0, 0], v[1] - matched[0, 1]
        c, d = then[0] - matched[1, 0], then[1] - matched[1, 1]
        kept = math.exp(-span_s / MATCH_FORGET_S)
        match[0] = kept * (match[0] + a * c + b * d)
        match[1] = kept * (match[1] + b * c - a * d)
        match[2] = kept * (match[2] + a * a + b * b)
        match[3] = kept * (match[3] + c * c + d * d)
        match[4] = kept * (match[4] + 1.0)
    for i in range(2):
        matched[0, i], matched[1, i] = v[i], then[i]
    state["matched_time_ns"] = state["measured_time_ns"]


@kernel
def _begin_if_it_agrees(state: Record, airframe: int) -> None:
    """Begin to use the velocity where its changes are ours, rotated by the heading or as known."""
    v, match = state["measured_velocity_m_s"], state["match"]
    strength, angle = math.hypot(match[0], match[1]), math.atan2(match[1], match[0])
    # What is left of the changes when ours are rotated as fits best.
    left = match[2] + match[3] - 2.0 * strength
    if match[4] < MATCH_COUNT or left > MATCH_LEFT_M_S**2 * match[4]:
        return
    # The angle of a complex correlation r over n pairs has the variance (1 - r^2) / (2 n r^2).
    common2, all2 = strength * strength, match[2] * match[3]
    known = all2 - common2 < 2.0 * match[4] * MATCH_KNOWN_RAD**2 * common2
    matches = known and strength > MATCH_ENOUGH_M2_S2
    is_fast = v[0] * v[0] + v[1] * v[1] > COURSE_SPEED_M_S**2
    if matches and state["heading_source"] != heading.NONE and abs(angle) < COMPASS_RAD:
        _begin(state, 0.0)
    elif state["heading_source"] == heading.FIELD:
        return
    elif matches:
        _rotate_heading(state, angle, MATCH_SIGMA_RAD)
    elif airframe == _FIXED_WING and is_fast and state["course_doubted"] == 0:
        nose = math.atan2(state["dcm"][1, 0], state["dcm"][0, 0])
        _rotate_heading(state, math.atan2(v[1], v[0]) - nose, COURSE_SIGMA_RAD)


@kernel
def _rotate_heading(state: Record, angle_rad: float, sigma_rad: float) -> None:
    """Rotate to a heading that was found; pending corrections rotate along."""
    mekf.settle(state)
    mekf.rotate_about_down(state, angle_rad)
    correction, c, s = state["correction"], math.cos(angle_rad), math.sin(angle_rad)
    for k in (ANGLE, VELOCITY):
        x, y = correction[k], correction[k + 1]
        correction[k], correction[k + 1] = c * x - s * y, s * x + c * y
    correction[ANGLE + 2] = 0.0
    _begin(state, sigma_rad)


@inlined_kernel
def shift_history(state: Record) -> None:
    """Correct the remembered velocities as the present one."""
    for i in range(3):
        added = state["correction"][VELOCITY + i]
        for n in range(HISTORY):
            state["history_m_s"][i, n] += added
