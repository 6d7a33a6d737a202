"""Heading from the magnetic field: level the field by the tilt, take its azimuth.

The field is averaged in earth axes over an update. It is trusted the less, the more it differs from
the reference, which is the field's part along the meridian (horizontal and down, so norm and dip in
one), slowly followed while undisturbed. A disturbance from any direction that shows d [uT] in
those two hides d / sqrt(2) across them, which turns a horizontal field H by d / (sqrt(2) H):

    variance = sigma^2 + d^2 / (2 H^2) (1 + d^2 / limit^2) + (down / H)^2 tilt variance

A reading belongs to the attitude of when it was taken (`field_lag`); the uncertainty of its lag
adds to that. There is no sharp limit, so a heading that has become doubtful itself comes back to
any field in the end. Without a magnetometer the heading starts at 0 and runs free, with a sigma
that grows.
"""

import math
from typing import Final

from ahrs_service.fusion import field_lag, hard_iron
from ahrs_service.fusion.mekf import correct_state, forget, rotate_about_down, variance_of
from ahrs_service.fusion.states import ANGLE
from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Floats, Record

HEADING_FIELDS: Final = [
    ("heading_source", "i8"),
    ("mag_count", "i8"),
    ("mag_s", "f8"),
    ("mag_field_ut", "f8", 3),
    ("mag_turning_ut_s", "f8", 3),
    ("mag_dcm", "f8", (3, 3)),
    ("reference_ut", "f8", 2),
    ("reference_s", "f8"),
    ("other_ut", "f8", 2),
    ("other_s", "f8"),
    *hard_iron.IRON_FIELDS,
    *field_lag.LAG_FIELDS,
]
"""Fields of the pipeline's state: where the heading comes from; count, time [s] and sums of
field, of what it turns by (earth axes) and of the matrix since the last correction; the field
assumed undisturbed (horizontal, down) with the time it was averaged, and the candidate to
replace it."""

NONE: Final = 0
"""Codes of `heading_source`, as below."""
FIELD: Final = 1
"""See VELOCITY."""
VELOCITY: Final = 2
"""Where the heading comes from: nowhere, the magnetic field, a measured velocity."""
FIELD_MIN_UT: Final = 20.0
"""A choice, as the next: 2 uT (hard_iron.IRON_SIGMA_UT) below the least of the Earth's field."""
FIELD_MAX_UT: Final = 70.0
"""The Earth's field at the surface lies between 22 and 67 uT (IGRF-14)."""
HORIZONTAL_MIN_UT: Final = 1e-3
"""A field that points straight down gives no heading, but has to leave numbers [uT]."""
SENSOR_MAX_UT: Final = 1e4
"""No magnetometer of a vehicle measures more; NaN is not below it either."""
AZIMUTH_SIGMA_RAD: Final = 0.06
"""Of an undisturbed azimuth: 1 uT of hard iron or of a building against 16 uT [rad]."""
CORRELATION_S: Final = 10.0
"""What disturbs a field stays about this long: closer azimuths are not independent [s]."""
FIRST_SIGMA_RAD: Final = 0.2
"""Of the azimuth of one reading with a first tilt [rad]."""
SAME_FIELD: Final = 0.1
"""Share of the norm within which a field counts as undisturbed and moves the reference."""
SETTLE_S: Final = 1.0
"""A choice: a reference averaged for less is replaced by any reading [s]."""
SETTLED_TILT_RAD: Final = 0.1
"""Before the tilt is known to this, the field's dip is not known either [rad]."""
FOLLOW_S: Final = 30.0
"""The reference is an average over this time [s]. Another field that stays the same becomes the
reference once it held for as long, or for as long as a younger reference did."""
ACCEPT_RATE_RAD_S: Final = 0.35
"""Only the time of turning at this rate counts for that: a magnet near a vehicle at rest gives
a constant field as well, but no longer when the vehicle turns."""
OUTLIER_SIGMA: Final = 3.0
"""Noise exceeds it in 0.27 % of readings; beyond, the weight falls by the square."""


@kernel
def take_source(state: Record, source: int) -> None:
    """Say where the heading comes from: NONE where it is lost, VELOCITY where that showed it."""
    state["heading_source"] = source


@kernel
def first_heading(settings: Record, state: Record, mag: Floats) -> None:
    """Turn the aligned attitude to the azimuth of one reading [3] [uT], if it is plausible."""
    state["heading_source"] = NONE
    begin_average(state)
    if settings["use_magnetometer"] != 0:
        gather(state, mag, 0.0)
        find(settings, state)


@kernel
def seek(settings: Record, state: Record, velocity_is_fresh: bool) -> None:
    """After an update, take the heading from the field where nothing or only a velocity gave it."""
    if state["heading_source"] == VELOCITY and velocity_is_fresh:
        begin_average(state)
    elif state["heading_source"] != FIELD:
        find(settings, state)


@kernel
def find(settings: Record, state: Record) -> None:
    """Rotate the attitude to the azimuth of the field of an update, if it is plausible.

    A heading that a velocity gave stays where it is, and the field corrects it from now on.
    """
    count, field = state["mag_count"], state["mag_field_ut"]
    if count == 0:
        return
    north, east, down = field[0] / count, field[1] / count, field[2] / count
    begin_average(state)
    horizontal2 = north * north + east * east
    if not FIELD_MIN_UT**2 < horizontal2 + down * down < FIELD_MAX_UT**2:
        return
    state["reference_ut"][0], state["reference_ut"][1] = math.sqrt(horizontal2), down
    state["reference_s"] = state["other_s"] = 0.0
    hard_iron.start(state)
    field_lag.start(state)
    if state["heading_source"] == NONE:
        rotate_about_down(state, settings["declination_rad"] - math.atan2(east, north))
        variance = min(FIRST_SIGMA_RAD**2 + _by_tilt(state), math.pi**2)
        forget(state["covariance"], ANGLE + 2, variance)
    state["heading_source"] = FIELD


@kernel
def begin_average(state: Record) -> None:
    """Discard the accumulated field."""
    state["mag_s"] = 0.0
    state["mag_count"] = 0
    for i in range(3):
        state["mag_field_ut"][i] = state["mag_turning_ut_s"][i] = 0.0
        for j in range(3):
            state["mag_dcm"][i, j] = 0.0


@kernel
def sigma(state: Record) -> float:
    """Return the heading's 1-sigma [rad]: no average takes out where the field itself points."""
    variance = state["covariance"][2, 2]
    if state["heading_source"] == FIELD:
        variance = min(variance + AZIMUTH_SIGMA_RAD**2, math.pi**2)
    return math.sqrt(variance)


@inlined_kernel
def gather(state: Record, mag: Floats, dt_s: float) -> None:
    """Gather one field reading [3] [uT], NaN where there is none."""
    state["mag_s"] += dt_s
    if not abs(mag[0]) + abs(mag[1]) + abs(mag[2]) < SENSOR_MAX_UT:
        return
    dcm, sums, rate, iron = state["dcm"], state["mag_dcm"], state["rate_rad_s"], state["iron_ut"]
    a, b, c = mag[0] - iron[0], mag[1] - iron[1], mag[2] - iron[2]
    x, y, z = rate[1] * c - rate[2] * b, rate[2] * a - rate[0] * c, rate[0] * b - rate[1] * a
    state["mag_count"] += 1
    for i in range(3):
        state["mag_field_ut"][i] += dcm[i, 0] * mag[0] + dcm[i, 1] * mag[1] + dcm[i, 2] * mag[2]
        state["mag_turning_ut_s"][i] += dcm[i, 0] * x + dcm[i, 1] * y + dcm[i, 2] * z
        for j in range(3):
            sums[i, j] += dcm[i, j]


@kernel
def correct(settings: Record, state: Record) -> None:
    """Correct by the field averaged over the update, if there was any."""
    if state["heading_source"] == FIELD and state["mag_count"] > 0:
        _take_average(settings, state)
        begin_average(state)


@inlined_kernel
def _take_average(settings: Record, state: Record) -> None:
    """Judge the field averaged over the update and correct the heading by its azimuth."""
    share, dt_s = 1.0 / state["mag_count"], min(state["mag_s"], CORRELATION_S)
    field, dcm, iron = state["mag_field_ut"], state["mag_dcm"], state["iron_ut"]
    turning, lag_s = state["mag_turning_ut_s"], state["field_lag_s"]
    field_lag.learn(state, field, turning, dcm, share, state["mag_s"])
    for i in range(3):
        field[i] -= lag_s * turning[i]
    hard_iron.gather(state, field, dcm, share, state["mag_s"])
    north, east, down = field[0] * share, field[1] * share, field[2] * share
    misfit2 = _misfit2(state, north, east, down)
    freed_north = north - share * (dcm[0, 0] * iron[0] + dcm[0, 1] * iron[1] + dcm[0, 2] * iron[2])
    freed_east = east - share * (dcm[1, 0] * iron[0] + dcm[1, 1] * iron[1] + dcm[1, 2] * iron[2])
    freed_down = down - share * (dcm[2, 0] * iron[0] + dcm[2, 1] * iron[1] + dcm[2, 2] * iron[2])
    freed2 = _misfit2(state, freed_north, freed_east, freed_down)
    hidden2 = _hidden2(state, misfit2)
    if hard_iron.judge(state, misfit2, freed2, dt_s):
        north, east, down = freed_north, freed_east, freed_down
        misfit2 = freed2
        hidden2 = _hidden2(state, freed2) + _iron_across2(state, north, east, share)
    hidden2 += _lag_across2(state, north, east, share)
    if not misfit2 < math.inf:
        # Damaged saved bytes: begin anew.
        state["heading_source"] = NONE
        return
    variance = AZIMUTH_SIGMA_RAD**2 + hidden2 / _horizontal(state) ** 2 + _by_tilt(state)
    error = settings["declination_rad"] - math.atan2(east, north)
    _correct_heading_only(state, math.atan2(math.sin(error), math.cos(error)), variance, dt_s)
    _follow_field(state, math.sqrt(north * north + east * east), down, misfit2, dt_s)


@kernel
def _by_tilt(state: Record) -> float:
    """Variance of the azimuth [rad^2] that the tilt's brings in: a steep field is tilted across."""
    slope = state["reference_ut"][1] / _horizontal(state)
    return float(slope * slope * _tilt_variance(state))


@kernel
def _horizontal(state: Record) -> float:
    """Horizontal part of the reference [uT], by which to divide."""
    return max(float(state["reference_ut"][0]), HORIZONTAL_MIN_UT)


@kernel
def _tilt_variance(state: Record) -> float:
    return 0.5 * (variance_of(state, ANGLE) + variance_of(state, ANGLE + 1))


@kernel
def _misfit2(state: Record, north: float, east: float, down: float) -> float:
    """Square of what a field misses the reference by, along the meridian and down [uT^2]."""
    horizontal = math.sqrt(north * north + east * east)
    reference = state["reference_ut"]
    return float((horizontal - reference[0]) ** 2 + (down - reference[1]) ** 2)


@kernel
def _limit2(state: Record) -> float:
    """Square of how far an undisturbed field may miss the reference [uT^2]."""
    reference = state["reference_ut"]
    return float(SAME_FIELD**2 * (reference[0] ** 2 + reference[1] ** 2))


@kernel
def _hidden2(state: Record, misfit2: float) -> float:
    """Variance across the meridian by the misfit [uT^2]; it grows faster beyond the limit."""
    return 0.5 * misfit2 * (1.0 + misfit2 / _limit2(state))


@kernel
def _iron_across2(state: Record, north: float, east: float, share: float) -> float:
    """Variance of the hard iron across the field's meridian [uT^2]."""
    dcm, horizontal = state["mag_dcm"], math.sqrt(north * north + east * east)
    if horizontal == 0.0:
        return 0.0
    c, s = share * north / horizontal, share * east / horizontal
    return hard_iron.variance_along(
        state,
        (
            c * dcm[1, 0] - s * dcm[0, 0],
            c * dcm[1, 1] - s * dcm[0, 1],
            c * dcm[1, 2] - s * dcm[0, 2],
        ),
    )


@kernel
def _lag_across2(state: Record, north: float, east: float, share: float) -> float:
    """Variance of what the lag adds across the field's meridian [uT^2]."""
    turning, horizontal2 = state["mag_turning_ut_s"], north * north + east * east
    if horizontal2 == 0.0:
        return 0.0
    across = share * (north * turning[1] - east * turning[0])
    return float(state["field_lag_variance_s2"] * across * across / horizontal2)


@kernel
def _correct_heading_only(state: Record, error: float, variance: float, dt_s: float) -> None:
    """Correct by an azimuth error of this variance; an outlier counts less, by its square.

    A magnetic error must not tilt the horizon, so the tilt is considered (Schmidt 1966): neither
    it nor its covariance is changed.
    """
    p, gain, correction = state["covariance"], state["gain"], state["correction"]
    outlier = error * error / (OUTLIER_SIGMA**2 * (variance_of(state, ANGLE + 2) + variance))
    variance *= max(1.0, CORRELATION_S / dt_s) * max(1.0, outlier)
    north, east = correction[0], correction[1]
    correct_state(state, ANGLE + 2, error, variance)
    correction[0], correction[1] = north, east
    # What the gain takes from the tilt's covariance it gets back.
    for i in range(2):
        for j in range(2):
            p[i, j] += gain[i] * gain[j]


@kernel
def _follow_field(
    state: Record, horizontal: float, down: float, misfit2: float, dt_s: float
) -> None:
    """Let the reference follow a field like itself, or one that stays the same in turns."""
    reference, other = state["reference_ut"], state["other_ut"]
    limit2 = _limit2(state)
    if _tilt_variance(state) > SETTLED_TILT_RAD**2:
        state["reference_s"] = 0.0
    if misfit2 < limit2 or state["reference_s"] < SETTLE_S:
        state["reference_s"] = min(state["reference_s"] + dt_s, FOLLOW_S)
        weight = dt_s / state["reference_s"]
        reference[0] += weight * (horizontal - reference[0])
        reference[1] += weight * (down - reference[1])
        state["other_s"] = 0.0
        return
    if not (horizontal - other[0]) ** 2 + (down - other[1]) ** 2 < limit2:
        state["other_s"] = 0.0
    if state["other_s"] == 0.0:
        other[0], other[1] = horizontal, down
    weight = dt_s / (FOLLOW_S + dt_s)
    other[0] += weight * (horizontal - other[0])
    other[1] += weight * (down - other[1])
    rate = state["smooth_rate_rad_s"]
    rate2 = rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2]
    if rate2 > ACCEPT_RATE_RAD_S**2:
        state["other_s"] += dt_s
    plausible = FIELD_MIN_UT**2 < other[0] * other[0] + other[1] * other[1] < FIELD_MAX_UT**2
    if state["other_s"] > max(state["reference_s"], SETTLE_S) and plausible:
        reference[0], reference[1] = other[0], other[1]
        state["other_s"] = 0.0
