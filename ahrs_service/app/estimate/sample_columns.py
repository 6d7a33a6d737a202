"""Samples as plain arrays: the fields of an .npz, checked, as the estimator takes them.

Every common marker of "no value" is read as such: NaN anywhere, a speed of
exactly 0, a vertical speed that is 0 throughout, an airspeed that stays constant. Data that looks
like another unit or other axes is reported, not corrected.
"""

import math
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.errors import InvalidValueError, RecordingError
from ahrs_service.records import SAMPLE_DTYPE, Floats, ImuSource, Integers, Rows, empty

_FASTEST_HZ: Final = 1e6
_LONGEST_S: Final = 1e9
_SLOWEST_STEP_S: Final = 1.0
_BEGIN_NS: Final = 1_000_000_000_000
"""Time of the first sample: in the estimator's state 0 means "never received"."""
_STANDS_STILL_S: Final = 3.0
"""A pitot tube is noisy: a value that stays the same for longer is held, not measured."""
_ACCEL_MEDIAN_M_S2: Final = 4.0, 25.0
_FIELD_MEDIAN_UT: Final = 15.0, 100.0
"""Usual norms of force and field over most of a recording, in flight or by hand."""
_GYRO_FAST_RAD_S: Final = 20.0
"""1100 deg/s: a faster rate for more than a moment must be in deg/s."""
_UNITS: Final = {
    "imu_gyr": "rad/s",
    "imu_acc": "m/s^2",
    "imu_mag": "uT",
    "airspeed": "m/s",
    "vel_ned": "m/s",
    "imu_degc": "degC",
    "t": "s",
    "sampling_rate": "Hz",
}
_OWN_NAMES: Final = {name: name for name in _UNITS}
_NOT_AN_NPZ: Final = (
    ValueError,
    EOFError,
    KeyError,
    RuntimeError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
)
_SCALARS: Final = ("airspeed", "imu_degc", "t")
_FLIPPED: Final = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True)
class Columns:
    """Samples [N] as IN has them: its own sensor axes, its own types; None where not given."""

    time_ns: Integers
    gyro_rad_s: Any
    accel_m_s2: Any
    mag_ut: Any = None
    airspeed_m_s: Any = None
    velocity_ned_m_s: Any = None
    temperature_degc: Any = None

    def samples(self, start: int, stop: int, frame: str, magnetometer: bool) -> Rows:
        """Rows [stop - start] SAMPLE_DTYPE in forward-right-down axes."""
        rows = empty(SAMPLE_DTYPE, stop - start)
        part = slice(start, stop)
        turn = _FLIPPED if frame == "flu" else 1.0
        rows["time_ns"] = rows["received_ns"] = self.time_ns[part]
        rows["gyro_rad_s"] = self.gyro_rad_s[part] * turn
        rows["accel_m_s2"] = self.accel_m_s2[part] * turn
        rows["source"] = ImuSource.HIGHRES_IMU
        if magnetometer:
            rows["mag_ut"] = self.mag_ut[part] * turn
        if self.airspeed_m_s is not None:
            rows["airspeed_m_s"] = self.airspeed_m_s[part]
        if self.velocity_ned_m_s is not None:
            rows["velocity_ned_m_s"] = self.velocity_ned_m_s[part]
        if self.temperature_degc is not None:
            rows["temperature_degc"] = self.temperature_degc[part]
        return rows


def read_columns(path: Path) -> Columns:
    """Read IN; RecordingError names the file, the field, what is wrong and what to give."""
    try:
        return columns_of(_read_fields(path))
    except InvalidValueError as error:
        raise RecordingError(f"{path}: {error}") from None


def columns_of(fields: dict[str, Any], names: Mapping[str, str] = _OWN_NAMES) -> Columns:
    """Check the fields of IN by name; InvalidValueError says what is wrong and what to give.

    `names` are what the fields are called where they come from.
    """
    for field in ("imu_gyr", "imu_acc"):
        if field not in fields:
            there = ", ".join(names[field] for field in fields) or "none"
            raise InvalidValueError(
                f"field {names[field]} is missing (there are: {there}); "
                f"give {names[field]} [N, 3] in {_UNITS[field]}"
            )
    count = len(fields["imu_gyr"]) if fields["imu_gyr"].ndim else 0
    vectors = {}
    for field, array in fields.items():
        if field != "sampling_rate":
            vectors[field] = _checked(names, field, array, count)
    if not count:
        raise InvalidValueError(f"{names['imu_gyr']} holds no sample; give at least one row")
    time_ns = _time_ns(names, vectors.get("t"), fields.get("sampling_rate"), count)
    airspeed, velocity = vectors.get("airspeed"), vectors.get("vel_ned")
    return Columns(
        time_ns,
        vectors["imu_gyr"],
        vectors["imu_acc"],
        vectors.get("imu_mag"),
        None if airspeed is None else _measured_airspeed(airspeed, time_ns),
        None if velocity is None else _measured_velocity(velocity),
        vectors.get("imu_degc"),
    )


def doubts(columns: Columns, frame: str) -> list[str]:
    """Return what in `columns` looks like other units or other axes than were asked for."""
    found = []
    for name, values, (least, most) in (
        ("imu_acc", columns.accel_m_s2, _ACCEL_MEDIAN_M_S2),
        ("imu_mag", columns.mag_ut, _FIELD_MEDIAN_UT),
    ):
        if values is None or not (known := np.isfinite(values).all(axis=1)).any():
            continue
        length = float(np.median(np.linalg.norm(values[known].astype(np.float64), axis=1)))
        if not least <= length <= most:
            found.append(
                f"{name} has a median length of {length:.3g}, which in {_UNITS[name]} lies between "
                f"{least:g} and {most:g}; give it in {_UNITS[name]}"
            )
    rates = np.abs(columns.gyro_rad_s).max(axis=1)
    rates = rates[np.isfinite(rates)]
    if len(rates) and (fast := float(np.quantile(rates, 0.99))) > _GYRO_FAST_RAD_S:
        found.append(
            f"imu_gyr reaches {fast:.3g} in one sample of a hundred, faster than any vehicle in "
            "rad/s; give rad/s, not deg/s"
        )
    down = np.asarray(columns.accel_m_s2[:, 2], np.float64) * (-1.0 if frame == "flu" else 1.0)
    down = down[np.isfinite(down)]
    if len(down) and np.median(down) > 0.5 * STANDARD_GRAVITY_M_S2:
        other = "frd" if frame == "flu" else "flu"
        found.append(
            f"imu_acc's z means upside down for most of the time with --frame {frame}; "
            f"if it was not, give --frame {other}"
        )
    return found


def _measured_airspeed(airspeed: Any, time_ns: Integers) -> Floats:
    """Airspeeds [N], NaN where there is none: at 0, and when the value stays constant too long."""
    values = np.where(airspeed == 0.0, np.nan, airspeed.astype(np.float64))
    (places,) = np.nonzero(np.isfinite(values))
    if len(places):
        heard, times = values[places], time_ns[places]
        is_new = np.concatenate([[True], heard[1:] != heard[:-1]])
        since = times[np.maximum.accumulate(np.where(is_new, np.arange(len(places)), 0))]
        values[places[(times - since) * 1e-9 > _STANDS_STILL_S]] = np.nan
    return values


def _measured_velocity(velocity: Any) -> Floats:
    """Velocities [N, 3], NaN for those of exactly 0 and for a z that is 0 throughout or missing."""
    values = np.full((len(velocity), 3), np.nan)
    values[:, : velocity.shape[1]] = velocity
    values[(values[:, 0] == 0.0) & (values[:, 1] == 0.0)] = np.nan
    if not np.any(np.nan_to_num(values[:, 2])):
        values[:, 2] = np.nan
    return values


def _read_fields(path: Path) -> dict[str, Any]:
    """Read the fields that are known."""
    try:
        file = np.load(path, allow_pickle=False)
        if not isinstance(file, np.lib.npyio.NpzFile):
            raise RecordingError(f"{path}: holds one array without a name; give an .npz")
        with file:
            return {name: np.asarray(file[name]) for name in file.files if name in _UNITS}
    except OSError as error:
        reason = error.strerror or error
        raise RecordingError(f"{path}: cannot be read: {reason}; give an .npz file") from None
    except _NOT_AN_NPZ as error:
        raise RecordingError(
            f"{path}: is not a complete .npz of plain numbers ({error}); write it with numpy.savez"
        ) from None


def _checked(names: Mapping[str, str], field: str, array: Any, count: int) -> Any:
    """Return `array` if its type and shape are those of the field."""
    name, unit = names[field], _UNITS[field]
    wanted = (count,) if field in _SCALARS else (count, 3)
    text = "[N]" if field in _SCALARS else "[N, 3]"
    if array.dtype.kind not in "fiu":
        raise InvalidValueError(
            f"{name} is of type {array.dtype}; give real numbers {text} in {unit}"
        )
    if array.shape != wanted and not (field == "vel_ned" and array.shape == (count, 2)):
        rows = "" if field == "imu_gyr" else f" with N = {count}, as {names['imu_gyr']} has"
        raise InvalidValueError(f"{name} has shape {array.shape}; give {text} in {unit}{rows}")
    return array


def _time_ns(names: Mapping[str, str], t: Any, rate: Any, count: int) -> Integers:
    """Times [N] [ns] after a constant; a missing stamp is interpolated."""
    if t is None:
        step_ns = 1e9 / _rate_hz(names["sampling_rate"], rate)
        return _BEGIN_NS + np.rint(np.arange(count) * step_ns).astype(np.int64)
    seconds = t.astype(np.float64)
    known = np.isfinite(seconds)
    if not known.any():
        raise InvalidValueError(
            f"t holds no finite time; give seconds, or {names['sampling_rate']}"
        )
    places = np.arange(count)
    seconds = np.interp(places, places[known], seconds[known]) - seconds[known][0]
    far = np.abs(seconds).max()
    if far > _LONGEST_S:
        raise InvalidValueError(f"t spans {far:g} s; give the time of each sample in seconds")
    steps = np.diff(seconds)
    if count > 1 and not (steps > 0.0).any():
        raise InvalidValueError(f"t never rises; give seconds, or {names['sampling_rate']} in Hz")
    usual = float(np.median(steps[steps > 0.0])) if count > 1 else 0.0
    if usual > _SLOWEST_STEP_S:
        raise InvalidValueError(f"t rises by {usual:g} a sample; give it in seconds")
    return _BEGIN_NS + np.rint(seconds * 1e9).astype(np.int64)


def _rate_hz(name: str, rate: Any) -> float:
    if rate is None:
        raise InvalidValueError(
            f"neither {name} nor t is given; give {name} in Hz, or t [N] in seconds"
        )
    value = float(rate.item()) if rate.size == 1 and rate.dtype.kind in "fiu" else math.nan
    if not 0.0 < value <= _FASTEST_HZ:
        raise InvalidValueError(
            f"{name} = {rate}; give one number above 0 and up to {_FASTEST_HZ:g} Hz"
        )
    return value
