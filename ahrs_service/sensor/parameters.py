"""One sensor's calibration of both triads, and the form in which the kernels read it.

The model of each triad contains eq. (1) of Liu et al. and eq. (2) and (3):

    N - E_T = (K + dK(T)) A + B + G f        E_T = a(T) N^2 + b(T) N + c(T)  per axis

N is the sensor's output, A the input along the body axes (both [rad/s] or both [m/s^2]); K holds
scale factors on its diagonal and cross-axis terms off it, B is the bias, both at room
temperature; f is the specific force [m/s^2], which acts on gyros by G. All that temperature changes
is zero at room temperature and given by curves (sensor.curve). The conventional model has dK and
c, the improved one a, b and c, a smooth one c and dK; to the kernels they are the same.

T is the element temperature: a sensing element warms later than the thermometer reads
(`thermal_lag_s` > 0) or, where the thermometer stands apart, before it (< 0): sensor.thermometer.

As TOML, for app.calibration_file (what is left out is zero):

    serial = "A0042"
    [gyro]
    matrix = [[1.002, 0.0, 0.001], [0.0, 0.998, 0.0], [0.0, 0.0, 1.001]]
    bias = [0.003, -0.001, 0.002]                  # rad/s
    [gyro.c]
    breaks_degc = [-40.0, 25.0, 70.0]
    pieces = [[[0.013, -2e-4], [0.0], [0.0]], [[0.0, -1e-4], [0.0], [0.0]]]
    [accel]
    bias = [0.05, -0.02, 0.10]                     # m/s^2
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

import numpy as np

from ahrs_service.errors import InvalidValueError
from ahrs_service.records import IMU_OF_SOURCE, Floats, ImuSource, Rows
from ahrs_service.sensor.curve import POWERS, Curve
from ahrs_service.sensor.provenance import Provenance, Uncertainty, Verdict

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

SEGMENTS: Final = 64
"""Largest number of temperature segments of a triad: -40..70 degC in 5 degC are 22."""
COLUMNS: Final = {"a": slice(0, 3), "b": slice(3, 6), "c": slice(6, 9), "matrix": slice(9, 18)}
"""Index of each curve in the kernels' table; dK row by row."""

IDENTITY: Final[Matrix] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NIL: Final[Matrix] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

_CURVES: Final = {"a": 3, "b": 3, "c": 3, "matrix_drift": 9}
_LARGEST_CONDITION: Final = 1e4
_LARGEST_LAG_S: Final = 3600.0
_STRICT = {"extra": "forbid"}

_TRIAD: Final = [
    ("matrix", "f8", (3, 3)),
    ("inverse", "f8", (3, 3)),
    ("bias", "f8", 3),
    ("g_sensitivity", "f8", (3, 3)),
    ("breaks_degc", "f8", SEGMENTS + 1),
    ("drift", "f8", (SEGMENTS, 18, POWERS)),
    ("segments", "i8"),
    ("matrix_drifts", "i8"),
    ("feels_force", "i8"),
    ("thermal_lag_s", "f8"),
]
_SOURCES: Final = 16
COEFFICIENTS_DTYPE: Final[np.dtype[Any]] = np.dtype(
    [
        ("gyro", _TRIAD),
        ("accel", _TRIAD),
        ("holds_for_source", "u1", _SOURCES),
        ("is_ideal", "u1"),
    ]
)
"""What the kernels of compensation and forward read: per triad K, K^-1, B, G, the borders of the
segments, `drift` [segment, column, power of T - border], whether dK and G are there at all; and for
which ImuSource it all holds."""


@dataclass(frozen=True, slots=True)
class TriadCalibration:
    """Calibration of three gyros or three accelerometers; the equation stands above.

    `matrix` [3, 3] K [1], `bias` [3] B [unit], the unit rad/s or m/s^2; curves of 3 columns `a`
    [1/unit], `b` [1], `c` [unit], and of 9 `matrix_drift` dK [1], row by row, all of one span;
    `g_sensitivity` [3, 3] G [rad/s per m/s^2], of gyros only; `thermal_lag_s` [s] as above;
    `model` names the thermal model for people: "conventional", "improved", "smooth".
    """

    __pydantic_config__: ClassVar = _STRICT
    matrix: Matrix = IDENTITY
    bias: Vector = (0.0, 0.0, 0.0)
    a: Curve = field(default_factory=Curve)
    b: Curve = field(default_factory=Curve)
    c: Curve = field(default_factory=Curve)
    matrix_drift: Curve = field(default_factory=Curve)
    g_sensitivity: Matrix = NIL
    thermal_lag_s: float = 0.0
    model: str = ""
    uncertainty: Uncertainty = field(default_factory=Uncertainty)

    def __post_init__(self) -> None:
        """Raise ValueError that names the field, its value and what to do."""
        _array("matrix", self.matrix, (3, 3))
        _array("bias", self.bias, (3,))
        _array("g_sensitivity", self.g_sensitivity, (3, 3))
        if not abs(self.thermal_lag_s) <= _LARGEST_LAG_S:
            raise InvalidValueError(
                f"thermal_lag_s = {self.thermal_lag_s}: give seconds between -{_LARGEST_LAG_S:.0f} "
                f"and {_LARGEST_LAG_S:.0f}, negative where the thermometer lags the sensor"
            )
        self._check_curves()
        self._check_invertible()

    def _check_curves(self) -> None:
        for name, columns in _CURVES.items():
            curve = getattr(self, name)
            if curve.columns not in (0, columns):
                raise InvalidValueError(f"{name} has {curve.columns} columns: give it {columns}")
            if curve.pieces and curve.span_degc != self.span_degc:
                raise InvalidValueError(
                    f"{name} spans {curve.span_degc} degC where another curve spans "
                    f"{self.span_degc}: give all curves of a triad the same first and last border"
                )
        segments = len(self.breaks_degc()) - 1
        if segments > SEGMENTS:
            raise InvalidValueError(
                f"the curves have {segments} segments together: "
                f"give at most {SEGMENTS}, by giving them common borders"
            )

    def _check_invertible(self) -> None:
        """Demand that input follows from output at every temperature."""
        grid = _between(self.breaks_degc())
        condition = float(np.linalg.cond(self.matrix_at(grid)).max())
        if not condition < _LARGEST_CONDITION:
            raise InvalidValueError(
                f"matrix = {self.matrix} with its drift cannot be inverted (condition "
                f"{condition:.3g}): put the scale factors, near 1, on its diagonal"
            )
        if self.b.pieces and self.b.at(grid).max() >= 1.0:
            raise InvalidValueError(
                f"b reaches {self.b.at(grid).max():.3g}, so the output would not follow the "
                "input: b is a small relative drift of scale, 0.01 for 1 %"
            )

    @property
    def span_degc(self) -> tuple[float, float] | None:
        """The calibrated temperatures [degC]; None where temperature changes nothing."""
        spans = [curve.span_degc for curve in self._curves() if curve.pieces]
        return spans[0] if spans else None

    def breaks_degc(self) -> Floats:
        """Return the borders of all curves together [n + 1] [degC], none without curves."""
        return np.unique(np.concatenate([curve.breaks_degc for curve in self._curves()]))

    def matrix_at(self, temperature_degc: Floats) -> Floats:
        """Return K + dK [n, 3, 3] at temperatures [n] [degC]."""
        count = len(temperature_degc)
        constant = np.broadcast_to(np.array(self.matrix), (count, 3, 3))
        if not self.matrix_drift.pieces:
            return constant
        return constant + self.matrix_drift.at(temperature_degc).reshape(count, 3, 3)

    def _curves(self) -> tuple[Curve, ...]:
        return (self.a, self.b, self.c, self.matrix_drift)


@dataclass(frozen=True, slots=True)
class Calibration:
    """Calibration of one sensor: what its `serial` number is, and where the figures come from.

    `uid` is how the autopilot that holds it names itself: AUTOPILOT_VERSION.uid2 or uid as
    lower-case hex digits; `imu` which of its IMUs it is, from 0 on, None for whichever is in use.
    `source` is free text. `room_degc` is where all drift is zero [degC].

    >>> from ahrs_service import Calibration, Estimator
    >>> from ahrs_service.sensor.parameters import TriadCalibration
    >>> known = Calibration(gyro=TriadCalibration(bias=(0.01, 0.0, -0.02)))
    >>> estimator = Estimator(calibration=known)
    >>> estimate = estimator.update(0.0, gyr=(0.01, 0.0, 0.08), acc=(0.0, 0.0, -9.81))
    >>> estimate["rate_rad_s"].round(6)
    array([0. , 0. , 0.1])
    """

    __pydantic_config__: ClassVar = _STRICT
    gyro: TriadCalibration = field(default_factory=TriadCalibration)
    accel: TriadCalibration = field(default_factory=TriadCalibration)
    serial: str = ""
    uid: str = ""
    imu: int | None = None
    source: str = ""
    room_degc: float = 25.0
    provenance: Provenance = field(default_factory=Provenance)
    verdict: Verdict = field(default_factory=Verdict)

    def __post_init__(self) -> None:
        """Raise ValueError for a g-sensitivity of the accelerometer, or an IMU that cannot be."""
        if self.accel.g_sensitivity != NIL:
            raise InvalidValueError(
                "accel.g_sensitivity: only gyros have one; the accelerometer's matrix is its own"
            )
        if self.imu not in (None, 0, 1, 2):
            raise InvalidValueError(f"imu = {self.imu}: give 0, 1 or 2, or leave it out for any")

    @classmethod
    def ideal(cls) -> "Calibration":
        """Return the calibration of a sensor whose output is its input."""
        return cls()


def coefficients(calibration: Calibration) -> Rows:
    """Return the kernels' coefficients [1] COEFFICIENTS_DTYPE of `calibration`."""
    rows = np.zeros(1, COEFFICIENTS_DTYPE)
    for name in ("gyro", "accel"):
        triad, row = getattr(calibration, name), rows[name][0]
        row["matrix"] = triad.matrix
        row["inverse"] = np.linalg.inv(np.array(triad.matrix))
        row["bias"] = triad.bias
        row["g_sensitivity"] = triad.g_sensitivity
        row["thermal_lag_s"] = triad.thermal_lag_s
        row["feels_force"] = triad.g_sensitivity != NIL
        row["matrix_drifts"] = bool(triad.matrix_drift.pieces)
        breaks = triad.breaks_degc()
        row["segments"] = max(len(breaks) - 1, 0)
        row["breaks_degc"][: len(breaks)] = breaks
        for curve, place in ((triad.a, "a"), (triad.b, "b"), (triad.c, "c")):
            _lay(row, breaks, curve, place)
        _lay(row, breaks, triad.matrix_drift, "matrix")
    for source in ImuSource:
        is_its_own = calibration.imu in (None, IMU_OF_SOURCE.get(source, 0))
        rows["holds_for_source"][0, source] = is_its_own
    rows["is_ideal"] = calibration.gyro == calibration.accel == TriadCalibration()
    return rows


def _lay(row: Rows, breaks: Floats, curve: Curve, place: str) -> None:
    if curve.pieces:
        row["drift"][: len(breaks) - 1, COLUMNS[place]] = curve.on(breaks).table()


def _between(breaks: Floats) -> Floats:
    """Return four temperatures in each segment and the last border; one where there is none."""
    if not len(breaks):
        return np.zeros(1)
    steps = np.arange(0.0, 1.0, 0.25)
    inside = breaks[:-1, None] + np.diff(breaks)[:, None] * steps
    return np.append(inside.ravel(), breaks[-1])


def _array(name: str, value: object, shape: tuple[int, ...]) -> Floats:
    """Return `value` as finite floats of `shape`, or raise ValueError naming it."""
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        array = np.full(1, np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        size = " x ".join(str(extent) for extent in shape)
        raise InvalidValueError(f"{name} = {value}: give {size} finite numbers")
    return array
