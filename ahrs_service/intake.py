"""From readings to samples: adopts the vehicle, chooses the IMU, attaches temperature and aiding.

Samples carry the board's orientation in the vehicle as soon as its trim is heard. The same kernel
takes one live reading or a whole recording, so both choose alike. It decides by the readings alone,
never by a clock.
"""

import math
from typing import Final

import numpy as np

from ahrs_service.adoption import may_adopt_kernel
from ahrs_service.errors import InvalidValueError
from ahrs_service.kernel import kernel
from ahrs_service.records import (
    IMU_OF_SOURCE,
    Airframe,
    Flag,
    ImuSource,
    Integers,
    Kind,
    Record,
    Rows,
)
from ahrs_service.settings import IntakeSettings
from ahrs_service.vehicle_axes import TRIM_FIELDS, new_trim, take_trim, write_axes

_SOURCES: Final = 16
"""A choice: room for origins of IMU readings, by rank."""
_IMUS: Final = 4
"""A choice: room for IMUs of one autopilot, each with its temperature."""
_VELOCITIES: Final = 3
"""Origins of a velocity over ground, the best first."""

STATE_DTYPE: Final = np.dtype(
    [
        ("last_received_ns", "i8", _SOURCES),
        ("last_time_ns", "i8", _SOURCES),
        ("count", "i8", _SOURCES),
        ("interval_s", "f8", _SOURCES),
        ("temperature_degc", "f8", _IMUS),
        ("temperature_received_ns", "i8", _IMUS),
        ("temperature_first_ns", "i8", _IMUS),
        ("temperature_changed_ns", "i8", _IMUS),
        ("temperature_changes", "i8", _IMUS),
        ("velocity_ned_m_s", "f8", 3),
        ("velocity_received_ns", "i8", _VELOCITIES),
        ("airspeed_m_s", "f8"),
        *TRIM_FIELDS,
        ("foreign", "i8"),
        ("unused", "i8"),
        ("source_changes", "i8"),
        ("system", "i8"),
        ("component", "i8"),
        ("source", "i8"),
        ("vehicle", "i8"),
    ]
)
"""What the intake remembers; saved and restored by its bytes."""

PARAMETERS_DTYPE: Final = np.dtype(
    [
        ("imu_of_source", "i8", _SOURCES),
        ("system", "i8"),
        ("component", "i8"),
        ("source", "i8"),
        ("highres_temperature", "i8"),
        ("airframe_of_type", "i8", 256),
    ]
)

_HEARTBEAT = int(Kind.HEARTBEAT)
_IMU = int(Kind.IMU)
_AIRSPEED = int(Kind.AIRSPEED)
_GPS = int(Kind.GPS)
_VELOCITY = int(Kind.VELOCITY)
_GLOBAL_VELOCITY = int(Kind.GLOBAL_VELOCITY)
_TRIM = int(Kind.TRIM)
_HIGHRES = (
    int(ImuSource.HIGHRES_IMU),
    int(ImuSource.HIGHRES_IMU_1),
    int(ImuSource.HIGHRES_IMU_2),
)
_TYPES_OF_AIRFRAME = {
    Airframe.FIXED_WING: (1, 7, 8, 16, 19, 20, 21, 22, 23, 24, 25, 28, 37),
    Airframe.MULTIROTOR: (2, 3, 4, 13, 14, 15, 29, 35, 43),
}
"""MAV_TYPE by airframe; VTOLs, gliders and flapping wings fly forward like fixed wings."""
_SOURCE_CHANGED = int(Flag.SOURCE_CHANGED)
_IMU_CHANGED = int(Flag.IMU_CHANGED)
_TEMPERATURE_STALE = int(Flag.TEMPERATURE_STALE)

_SETTLED_COUNT = 10
"""A choice: so many readings give a source's interval."""
_SILENCE_S = 0.25
"""A choice: ten intervals of 40 Hz; slower sources have ten of their own [s]."""
_TEMPERATURE_SILENCE_S = 10.0
"""A choice: ten missed at 1 Hz [s]."""
_TEMPERATURE_FROZEN_S = 30.0
"""A choice: least time without a change, however often it changed before [s]."""
_INTERVAL_WEIGHT = 0.05
"""A choice: the usual interval is a mean over 20, as in fusion.timebase."""
_VELOCITY_SILENCE_NS = 3_000_000_000
"""A choice: above ground_velocity.VALID_NS, so the old one is let go before another begins [ns]."""
_NEVER_NS = -(2**62)
"""Before every stamp; half of int64, so that a difference to a stamp does not overflow [ns]."""


def new_state() -> Rows:
    """Return the state [1] before anything was heard."""
    state = np.zeros(1, STATE_DTYPE)
    for name in ("temperature_degc", "velocity_ned_m_s", "airspeed_m_s"):
        state[name] = np.nan
    state["velocity_received_ns"] = _NEVER_NS
    new_trim(state)
    return state


def parameters(settings: IntakeSettings) -> Rows:
    """Return the kernel's parameters [1]; ValueError for an IMU source that does not exist."""
    row = np.zeros(1, PARAMETERS_DTYPE)
    for source, imu in IMU_OF_SOURCE.items():
        row["imu_of_source"][0, source] = imu
    for airframe, types in _TYPES_OF_AIRFRAME.items():
        row["airframe_of_type"][0, list(types)] = airframe
    row["system"] = settings.system
    row["component"] = settings.component
    if settings.imu_source != "auto":
        names = [source.name for source in ImuSource if source]
        if settings.imu_source.upper() not in names:
            raise InvalidValueError(
                f"intake.imu_source = {settings.imu_source!r}: choose auto or one of "
                + ", ".join(names)
            )
        row["source"] = ImuSource[settings.imu_source.upper()]
    row["highres_temperature"] = settings.temperature_source == "highres_imu"
    return row


@kernel
def _adopt(parameters: Record, state: Record, reading: Record) -> bool:
    """Adopt the first autopilot heard; return whether `reading` is of the adopted vehicle."""
    if (
        state["system"] == 0
        and reading["kind"] == _HEARTBEAT
        and may_adopt_kernel(
            reading["system"],
            reading["component"],
            reading["autopilot"],
            parameters["system"],
            parameters["component"],
        )
    ):
        state["system"] = reading["system"]
        state["component"] = reading["component"]
    ours = (
        state["system"] != 0
        and reading["system"] == state["system"]
        and reading["component"] == state["component"]
    )
    if ours and reading["kind"] == _HEARTBEAT:
        state["vehicle"] = reading["vehicle"]
    return ours


@kernel
def _measure_interval(state: Record, reading: Record) -> None:
    """Follow the interval between readings of one source by the sender's clock [s]."""
    source = reading["source"]
    if state["count"][source] > 0:
        dt = (reading["time_ns"] - state["last_time_ns"][source]) * 1e-9
        if state["count"][source] > _SETTLED_COUNT:
            # A pause must not make a fast source look slow.
            dt = min(dt, 3.0 * state["interval_s"][source])
        if 0.0 <= dt < 10.0:
            weight = max(_INTERVAL_WEIGHT, 1.0 / state["count"][source])
            state["interval_s"][source] += weight * (dt - state["interval_s"][source])
    state["count"][source] += 1
    state["last_time_ns"][source] = reading["time_ns"]
    state["last_received_ns"][source] = reading["received_ns"]


@kernel
def _is_better(state: Record, source: int, received_ns: int) -> bool:
    """Whether `source` should replace the one in use.

    It does when the one in use fell silent while `source` went on (else the link did), when
    `source` is at least twice as fast, or when it is of better rank and about as fast.
    """
    used = state["source"]
    silence_s = (received_ns - state["last_received_ns"][used]) * 1e-9
    went_on_s = (state["last_received_ns"][source] - state["last_received_ns"][used]) * 1e-9
    limit_s = max(_SILENCE_S, 10.0 * state["interval_s"][used])
    if silence_s > limit_s and went_on_s > 0.3 * limit_s:
        return True
    if state["count"][source] < _SETTLED_COUNT:
        return False
    interval, used_interval = state["interval_s"][source], state["interval_s"][used]
    return interval < 0.5 * used_interval or (source < used and interval <= 1.5 * used_interval)


@kernel
def _is_whole(reading: Record) -> bool:
    """Whether all rates and forces are numbers."""
    for i in range(3):
        if not (
            math.isfinite(reading["gyro_rad_s"][i]) and math.isfinite(reading["accel_m_s2"][i])
        ):
            return False
    return True


@kernel
def _choose(parameters: Record, state: Record, reading: Record) -> tuple[bool, int]:
    """Decide whether to use this reading; return that and the flags of a change."""
    source = int(reading["source"])
    if parameters["source"] != 0:
        state["source"] = parameters["source"]
        return source == parameters["source"], 0
    if state["source"] == 0:
        state["source"] = source
        return True, 0
    other = source != state["source"]
    if other and _is_whole(reading) and _is_better(state, source, reading["received_ns"]):
        flags = _SOURCE_CHANGED
        imus = parameters["imu_of_source"]
        if imus[source] != imus[state["source"]]:
            flags |= _IMU_CHANGED
        state["source"] = source
        state["source_changes"] += 1
        return True, flags
    return source == state["source"], 0


@kernel
def _take_temperature(parameters: Record, state: Record, reading: Record) -> None:
    """Keep the IMU's own temperature; HIGHRES_IMU's is another sensor's unless set."""
    value = reading["temperature_degc"]
    if np.isnan(value):
        return
    source = reading["source"]
    if source in _HIGHRES and parameters["highres_temperature"] == 0:
        return
    imu = parameters["imu_of_source"][source]
    received_ns = reading["received_ns"]
    if np.isnan(state["temperature_degc"][imu]):
        state["temperature_first_ns"][imu] = received_ns
        state["temperature_changed_ns"][imu] = received_ns
    elif value != state["temperature_degc"][imu]:
        state["temperature_changes"][imu] += 1
        state["temperature_changed_ns"][imu] = received_ns
    state["temperature_degc"][imu] = value
    state["temperature_received_ns"][imu] = received_ns


@kernel
def _temperature_is_stale(state: Record, imu: int, received_ns: int) -> bool:
    """Whether the temperature stopped coming, or stopped moving although it used to.

    Frozen means no change for 30 s and for 20 times the mean time between changes so far.
    """
    if np.isnan(state["temperature_degc"][imu]):
        return False
    if (received_ns - state["temperature_received_ns"][imu]) * 1e-9 > _TEMPERATURE_SILENCE_S:
        return True
    changes = state["temperature_changes"][imu]
    if changes < 5:
        return False
    changed_ns = state["temperature_changed_ns"][imu]
    mean_s = (changed_ns - state["temperature_first_ns"][imu]) * 1e-9 / changes
    return (received_ns - changed_ns) * 1e-9 > max(_TEMPERATURE_FROZEN_S, 20.0 * mean_s)


@kernel
def _take_velocity(state: Record, reading: Record, rank: int) -> None:
    """Keep a velocity over ground unless a better one was heard in the last three seconds.

    The autopilot's filter can diverge without saying so, and both of its messages say the same.
    """
    v, received_ns = reading["velocity_ned_m_s"], reading["received_ns"]
    if not (math.isfinite(v[0]) and math.isfinite(v[1])):
        return
    for better in range(rank):
        if 0 <= received_ns - state["velocity_received_ns"][better] < _VELOCITY_SILENCE_NS:
            return
    state["velocity_received_ns"][rank] = received_ns
    for i in range(3):
        state["velocity_ned_m_s"][i] = v[i]


@kernel
def _write_sample(
    parameters: Record, state: Record, reading: Record, flags: int, sample: Record
) -> None:
    imu = parameters["imu_of_source"][reading["source"]]
    if _temperature_is_stale(state, imu, reading["received_ns"]):
        flags |= _TEMPERATURE_STALE
    sample["time_ns"] = reading["time_ns"]
    sample["received_ns"] = reading["received_ns"]
    sample["temperature_degc"] = state["temperature_degc"][imu]
    sample["airspeed_m_s"] = state["airspeed_m_s"]
    state["airspeed_m_s"] = np.nan
    for i in range(3):
        sample["gyro_rad_s"][i] = reading["gyro_rad_s"][i]
        sample["accel_m_s2"][i] = reading["accel_m_s2"][i]
        sample["mag_ut"][i] = reading["mag_ut"][i]
        sample["velocity_ned_m_s"][i] = state["velocity_ned_m_s"][i]
        state["velocity_ned_m_s"][i] = np.nan
    sample["flags"] = flags
    write_axes(state, sample)
    sample["source"] = reading["source"]
    sample["airframe"] = parameters["airframe_of_type"][state["vehicle"]]


@kernel
def _take_imu(parameters: Record, state: Record, reading: Record, sample: Record) -> int:
    """Take one IMU reading; return 1 if it became a sample."""
    _take_temperature(parameters, state, reading)
    use, change = _choose(parameters, state, reading)
    # A source that sends no numbers counts as silent, so that another can step in.
    if _is_whole(reading):
        _measure_interval(state, reading)
    if not use:
        state["unused"] += 1
        return 0
    _write_sample(parameters, state, reading, change, sample)
    return 1


@kernel
def select(
    parameters: Rows, state: Rows, readings: Rows, samples: Rows, positions: Integers
) -> int:
    """Turn `readings` [N] into samples, written to the front of `samples` [>= N].

    `positions` [>= N] takes for each sample the index of its reading. Returns how many samples
    were written. `parameters` and `state` are rows [1]; `state` moves on.
    """
    settings, memory = parameters[0], state[0]
    written = 0
    for n in range(readings.shape[0]):
        reading = readings[n]
        if not _adopt(settings, memory, reading):
            memory["foreign"] += 1
            if reading["kind"] == _TRIM and memory["system"] == 0:
                take_trim(memory, reading)
            continue
        kind = reading["kind"]
        if kind == _IMU:
            positions[written] = n
            written += _take_imu(settings, memory, reading, samples[written])
        elif kind == _AIRSPEED:
            memory["airspeed_m_s"] = reading["airspeed_m_s"]
        elif kind == _GPS:
            _take_velocity(memory, reading, 0)
        elif kind == _VELOCITY:
            _take_velocity(memory, reading, 1)
        elif kind == _GLOBAL_VELOCITY:
            _take_velocity(memory, reading, 2)
        elif kind == _TRIM:
            take_trim(memory, reading)
    return written
