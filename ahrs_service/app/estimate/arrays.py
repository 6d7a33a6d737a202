"""Arrays in, attitude out: `ahrs_service.estimate`, which the command of that name also uses."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Literal, cast

import numpy as np
import numpy.typing as npt

from ahrs_service.app.estimate import recognition
from ahrs_service.app.estimate.sample_columns import Columns, columns_of, doubts
from ahrs_service.app.files import calibration_file, config_file
from ahrs_service.errors import InvalidValueError
from ahrs_service.estimator import Estimator
from ahrs_service.records import ESTIMATE_DTYPE, Floats, Rows, empty
from ahrs_service.rotation import euler_columns, multiply_columns
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.settings import Settings
from ahrs_service.smoothing import Smoother

Frame = Literal["frd", "flu"]

_CHUNK: Final = 1 << 15
_FRD_FROM_FLU: Final = np.array([0.0, 1.0, 0.0, 0.0])
_ENU_FROM_NED: Final = np.array([0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0])
_NAMES: Final = {
    "imu_gyr": "gyr",
    "imu_acc": "acc",
    "imu_mag": "mag",
    "airspeed": "airspeed",
    "vel_ned": "velocity_ned",
    "imu_degc": "temperature_degc",
    "t": "t",
    "sampling_rate": "rate_hz",
}
"""The arguments of `estimate` by the names that the fields have in an .npz."""


@dataclasses.dataclass(frozen=True, slots=True)
class Attitude:
    """The result of `estimate`, one row per sample.

    `t` [N] s since the first sample; `quat` [N, 4] wxyz without the magnetometer, heading 0 at
    the start; `sigma_deg` [N, 3] 1-sigma of its error about the earth's axes [deg]; `gate` [N] why
    the accelerometer was not used as the vertical (records.Gate), 0 if it was; `quat9` [N, 4]
    with the magnetometer, None where there is none; `profile` the vehicle profile used;
    `doubts` warnings about arrays that look like other units or axes.

    >>> import numpy as np
    >>> from ahrs_service import estimate
    >>> attitude = estimate(np.zeros((500, 3)), np.tile([0.0, 0.0, -9.81], (500, 1)), rate_hz=100.0)
    >>> attitude.quat[-1].round(3)
    array([1., 0., 0., 0.])
    >>> list(attitude.columns())[:5]
    ['t', 'quat_w', 'quat_x', 'quat_y', 'quat_z']
    """

    t: Floats
    quat: Floats
    sigma_deg: Floats
    gate: npt.NDArray[np.uint32]
    quat9: Floats | None = None
    profile: str = ""
    doubts: tuple[str, ...] = ()

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return quat, sigma_deg, gate and, where there is one, quat9, by name."""
        out: dict[str, npt.NDArray[Any]] = {
            "quat": self.quat,
            "sigma_deg": self.sigma_deg,
            "gate": self.gate,
        }
        return out if self.quat9 is None else {**out, "quat9": self.quat9}

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return all as columns [N], with roll, pitch and yaw of `quat`, as a DataFrame takes it.

        The angles are those of `quat` itself, so for frame "flu" they refer to axes with z up.
        """
        columns: dict[str, npt.NDArray[Any]] = {"t": self.t}
        axes = {"quat": "wxyz", "quat9": "wxyz", "sigma_deg": "xyz"}
        for name, values in self.arrays().items():
            if name not in axes:
                columns[name] = values
                continue
            for i, axis in enumerate(axes[name]):
                columns[f"{name}_{axis}"] = np.ascontiguousarray(values[:, i])
        for name, angle in zip(["roll", "pitch", "yaw"], euler_columns(self.quat).T, strict=True):
            columns[f"{name}_deg"] = np.degrees(angle)
        return columns


def estimate(
    gyr: npt.ArrayLike,
    acc: npt.ArrayLike,
    *,
    rate_hz: float | None = None,
    t: npt.ArrayLike | None = None,
    mag: npt.ArrayLike | None = None,
    airspeed: npt.ArrayLike | None = None,
    velocity_ned: npt.ArrayLike | None = None,
    temperature_degc: npt.ArrayLike | None = None,
    frame: Frame = "frd",
    profile: str | None = None,
    settings: Settings | str | Path | None = None,
    calibration: Calibration | str | Path | None = None,
    offline: bool = False,
) -> Attitude:
    """Estimate the attitude from arrays of samples.

    `gyr` [N, 3] rad/s, `acc` [N, 3] m/s^2 (specific force), and `rate_hz` or the times `t` [N] s.
    Optional: `mag` [N, 3] uT, `airspeed` [N] m/s, `velocity_ned` [N, 3] m/s, the sensor's
    `temperature_degc` [N]; NaN where there is no value. `frame` "frd": axes forward, right, down
    (level at rest: z = -9.81), `quat` rotates them to north, east, down. "flu": forward, left, up
    (z = +9.81), `quat` to axes with z up, `quat9` to east, north, up.

    `profile` is how the vehicle moves ("fixed_wing", "multirotor", "hand_held", or a .toml file);
    without one it is recognised from the motion. `settings` and `calibration` may be files. With
    `offline` the attitude is smoothed with later samples. InvalidValueError names the array that
    cannot be used, ConfigError the setting.

    >>> import numpy as np
    >>> from ahrs_service import estimate
    >>> gyr = np.zeros((3000, 3))
    >>> acc = np.tile([0.0, -9.80665 * np.sin(0.2), -9.80665 * np.cos(0.2)], (3000, 1))
    >>> attitude = estimate(gyr, acc, rate_hz=100.0, profile="hand_held")
    >>> round(float(attitude.columns()["roll_deg"][-1]), 1)
    11.5
    """
    given = {
        "imu_gyr": gyr,
        "imu_acc": acc,
        "imu_mag": mag,
        "airspeed": airspeed,
        "vel_ned": velocity_ned,
        "imu_degc": temperature_degc,
        "t": t,
        "sampling_rate": rate_hz,
    }
    fields = {name: _array(name, value) for name, value in given.items() if value is not None}
    if frame not in ("frd", "flu"):
        raise InvalidValueError(f'frame = {frame!r}: give "frd" or "flu"')
    known = calibration
    if isinstance(known, str | Path):
        known = calibration_file.load(known)
    columns = columns_of(fields, _NAMES)
    return attitude_of(columns, _layers(settings, profile), profile, frame, offline, known)


def _array(field: str, value: npt.ArrayLike) -> npt.NDArray[Any]:
    try:
        return np.asarray(value)
    except ValueError as error:
        raise InvalidValueError(f"{_NAMES[field]} is no array: {error}") from None


def _layers(
    settings: Settings | str | Path | None, profile: str | None
) -> Callable[[str | None], Settings]:
    """Return the settings with a profile below them, as a function of the profile."""
    if not isinstance(settings, Settings):
        return lambda name: config_file.load(settings, profile=name)
    if profile is not None:
        raise InvalidValueError(
            f"profile = {profile!r} and settings: give settings as a file to apply on top of a "
            "profile, or set settings.fusion.airframe"
        )

    def of_class(name: str | None) -> Settings:
        if name is None:
            return settings
        fusion = dataclasses.replace(settings.fusion, airframe=cast(recognition.Recognised, name))
        return dataclasses.replace(settings, fusion=fusion)

    return of_class


def attitude_of(
    columns: Columns,
    settings_with: Callable[[str | None], Settings],
    profile: str | None,
    frame: Frame,
    offline: bool = False,
    calibration: Calibration | None = None,
) -> Attitude:
    """Estimate the attitude of `columns` [N]; without a profile recognise it from the motion.

    `settings_with` returns the settings with a profile below them.
    """
    settings = settings_with(profile)
    if profile is None and settings.fusion.airframe == "auto":
        profile = recognition.profile_of(recognition.signs_of(columns, frame))
        settings = settings_with(profile)
    out = estimate_columns(columns, settings, frame, offline, calibration)
    t = (columns.time_ns - columns.time_ns[0]) * 1e-9
    # As set by a file, the class of airframe is all that is known of the profile.
    name = profile or settings.fusion.airframe
    return Attitude(t, **out, profile=name, doubts=tuple(doubts(columns, frame)))


def estimate_columns(
    columns: Columns,
    settings: Settings,
    frame: str,
    offline: bool = False,
    calibration: Calibration | None = None,
) -> dict[str, Any]:
    """Run the estimator over `columns` [N], smoothed where `offline`; return Attitude's arrays."""
    run = _run_smoothed if offline else _run
    count = len(columns.time_ns)
    out: dict[str, Any] = {
        "quat": np.empty((count, 4)),
        "sigma_deg": np.empty((count, 3)),
        "gate": np.empty(count, np.uint32),
    }
    for part, rows in run(columns, settings, calibration, frame, magnetometer=False):
        out["quat"][part] = _in_frame(rows["ned_from_body"], frame, earth=_FRD_FROM_FLU)
        out["sigma_deg"][part] = np.degrees(rows["attitude_sigma_rad"])
        out["gate"][part] = rows["gate"]
    if columns.mag_ut is not None and settings.fusion.magnetometer:
        out["quat9"] = np.empty((count, 4))
        for part, rows in run(columns, settings, calibration, frame, magnetometer=True):
            out["quat9"][part] = _in_frame(rows["ned_from_body"], frame, earth=_ENU_FROM_NED)
    return out


def _run(
    columns: Columns,
    settings: Settings,
    calibration: Calibration | None,
    frame: str,
    magnetometer: bool,
    smoother: Smoother | None = None,
) -> Iterator[tuple[slice, Rows]]:
    """Run once over all samples; yield estimates piece by piece."""
    estimator = Estimator(settings, calibration, smoother)
    count = len(columns.time_ns)
    for start in range(0, count, _CHUNK):
        part = slice(start, min(start + _CHUNK, count))
        yield part, estimator.run(columns.samples(part.start, part.stop, frame, magnetometer))


def _run_smoothed(
    columns: Columns,
    settings: Settings,
    calibration: Calibration | None,
    frame: str,
    magnetometer: bool,
) -> Iterator[tuple[slice, Rows]]:
    """Run forward and backward over all samples; yield all estimates in one piece."""
    smoother, estimates = Smoother(), empty(ESTIMATE_DTYPE, len(columns.time_ns))
    for part, rows in _run(columns, settings, calibration, frame, magnetometer, smoother):
        estimates[part] = rows
    smoother.smooth(estimates)
    yield slice(0, len(estimates)), estimates


def _in_frame(ned_from_body: Floats, frame: str, earth: Floats) -> Floats:
    """Attitudes [N, 4] in the requested frame, by the rotation `earth` [4] from north-east-down."""
    if frame == "frd":
        return ned_from_body
    rotated = multiply_columns(multiply_columns(earth, ned_from_body), _FRD_FROM_FLU)
    flipped: Floats = np.where(rotated[:, :1] < 0.0, -rotated, rotated)
    return flipped
