"""What one sensor's calibration says: matrix, bias and thermal drift of both triads.

The model is eq. (2) and (3) of Liu et al. for each triad:

    N - E_T = K A + B        E_T = a_T N^2 + b_T N + c_T  per axis

N is the sensor's output, A the input along the body axes (both [rad/s] or both [m/s^2]); K holds
scale factors on its diagonal and cross-axis terms off it, B is the bias, both at room
temperature. E_T is all that temperature changes, zero at room temperature. Its coefficients are
given at nodes of temperature and are linear between them, so that the drift is continuous.

As TOML, for app.config_file (the thermal lists may be left out):

    serial = "A0042"
    source = "six positions and chamber run, 2024-05-01"

    [gyro]
    matrix = [[1.002, 0.0, 0.001], [0.0, 0.998, 0.0], [0.0, 0.0, 1.001]]
    bias = [0.003, -0.001, 0.002]                  # rad/s
    temperature_degc = [-40.0, 25.0, 70.0]
    a = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    b = [[0.002, 0.001, 0.002], [0.0, 0.0, 0.0], [-0.002, -0.001, -0.002]]
    c = [[0.010, -0.004, 0.002], [0.0, 0.0, 0.0], [-0.007, 0.003, -0.001]]

    [accel]
    bias = [0.05, -0.02, 0.10]                     # m/s^2
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

import numpy as np

from ahrs_service.records import Rows

Vector = tuple[float, float, float]

NODES: Final = 32
"""Largest number of temperature nodes of a triad: 5 degC steps over -40..70 degC are 23."""

_LARGEST_CONDITION: Final = 1e4
_STRICT = {"extra": "forbid"}

_TRIAD: Final = [
    ("matrix", "f8", (3, 3)),
    ("inverse", "f8", (3, 3)),
    ("bias", "f8", 3),
    ("temperature_degc", "f8", NODES),
    ("drift", "f8", (3, NODES, 3)),
    ("nodes", "i8"),
]
COEFFICIENTS_DTYPE: Final[np.dtype[Any]] = np.dtype([("gyro", _TRIAD), ("accel", _TRIAD)])
"""What the kernels of compensation and forward read: per triad K, K^-1, B, the nodes
and `drift` [power of N, node, axis]."""


@dataclass(frozen=True, slots=True)
class TriadCalibration:
    """Calibration of three gyros or three accelerometers (Liu et al., eq. (2) and (3)).

    `matrix` [3, 3] K [1], `bias` [3] B [rad/s or m/s^2]; `temperature_degc` [n] nodes [degC],
    rising, none or 2..32; `a` [n, 3] [1/unit], `b` [n, 3] [1], `c` [n, 3] [unit] of the drift.
    """

    __pydantic_config__: ClassVar = _STRICT
    matrix: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    bias: Vector = (0.0, 0.0, 0.0)
    temperature_degc: tuple[float, ...] = ()
    a: tuple[Vector, ...] = ()
    b: tuple[Vector, ...] = ()
    c: tuple[Vector, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError that names the field, its value and what to do."""
        _array("matrix", self.matrix, (3, 3))
        _array("bias", self.bias, (3,))
        condition = float(np.linalg.cond(np.array(self.matrix)))
        if not condition < _LARGEST_CONDITION:
            raise ValueError(
                f"matrix = {self.matrix} cannot be inverted (condition {condition:.3g}): "
                "put the scale factors, near 1, on its diagonal"
            )
        self._check_nodes()

    def _check_nodes(self) -> None:
        count = len(self.temperature_degc)
        nodes = _array("temperature_degc", self.temperature_degc, (count,))
        if count == 1 or count > NODES:
            raise ValueError(
                f"temperature_degc has {count} nodes: give none or 2 to {NODES}, "
                "the drift is linear between them"
            )
        if (np.diff(nodes) <= 0.0).any():
            raise ValueError(
                f"temperature_degc = {self.temperature_degc} does not rise: "
                "sort the nodes, and a, b, c with them, and give each temperature once"
            )
        for name in ("a", "b", "c"):
            _array(name, getattr(self, name), (count, 3) if count else (0,))
        if count and max(max(row) for row in self.b) >= 1.0:
            raise ValueError(
                f"b = {self.b} has a value of 1 or more, so the output would not follow the "
                "input: b is a small relative drift of scale, 0.01 for 1 %"
            )


@dataclass(frozen=True, slots=True)
class Calibration:
    """Calibration of one sensor: its `serial` number and the `source` of the figures."""

    __pydantic_config__: ClassVar = _STRICT
    gyro: TriadCalibration = field(default_factory=TriadCalibration)
    accel: TriadCalibration = field(default_factory=TriadCalibration)
    serial: str = ""
    source: str = ""

    @classmethod
    def ideal(cls) -> "Calibration":
        """Return the calibration of a sensor whose output is its input."""
        return cls()


def coefficients(calibration: Calibration) -> Rows:
    """Return the kernels' coefficients [1] COEFFICIENTS_DTYPE of `calibration`."""
    rows = np.zeros(1, COEFFICIENTS_DTYPE)
    for name in ("gyro", "accel"):
        triad, row = getattr(calibration, name), rows[name]
        count = len(triad.temperature_degc)
        row["matrix"] = triad.matrix
        row["inverse"] = np.linalg.inv(np.array(triad.matrix))
        row["bias"] = triad.bias
        row["nodes"] = count
        row["temperature_degc"][0, :count] = triad.temperature_degc
        for power, part in enumerate((triad.c, triad.b, triad.a) if count else ()):
            row["drift"][0, power, :count] = part
    return rows


def _array(name: str, value: object, shape: tuple[int, ...]) -> Rows:
    """Return `value` as finite floats of `shape`, or raise ValueError naming it."""
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        array = np.full(1, np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        size = " x ".join(str(extent) for extent in shape)
        raise ValueError(f"{name} = {value}: give {size} finite numbers")
    return array
