"""MEMS parts that drift with temperature as parts do: each in its own way, and not as polynomials.

A part's drift is a sum of what is known to cause it: a slope (the modulus of silicon falls by 60
ppm/degC), an exponential (leakage currents double every 10 degC or so), a step spread over some
15 degC (the die attach softens at its glass transition, which lets go of the package's stress), and
a wave (stress of solder and board). None of them is a function that calibration fits.

Sizes are those of data sheets of the paper's years: zero-g drift 1 mg/degC (ADXL335), so 65 mg from
room to -40 degC; sensitivity 0.01 %/degC (ADXL335); gyro null 20 deg/s over -40..85 degC at most,
a quarter of it usual, and sensitivity 2 % (MPU-6000); axes rotate by 0.02 deg, as a layer of glue
under a 4 mm chip that grows by a micrometre makes them.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.parameters import SEGMENTS, Calibration, TriadCalibration

ROOM_DEGC: Final = 25.0
COLDEST_DEGC: Final = -45.0
HOTTEST_DEGC: Final = 75.0

_MILLI_G: Final = 1e-3 * STANDARD_GRAVITY_M_S2
_DEGREE: Final = math.radians(1.0)


@dataclass(frozen=True, slots=True)
class PartSizes:
    """How far the parts of one triad may be off.

    `bias` [unit], `scale` [1] and `axes` [rad] at room temperature, and how far each drifts from
    there over -40..70 degC at most.
    """

    bias: float
    scale: float
    axes: float
    bias_drift: float
    scale_drift: float
    axes_drift: float


ACCELS: Final = PartSizes(
    bias=50 * _MILLI_G,
    scale=0.02,
    axes=_DEGREE,
    bias_drift=65 * _MILLI_G,
    scale_drift=0.0065,
    axes_drift=0.02 * _DEGREE,
)
GYROS: Final = PartSizes(
    bias=3 * _DEGREE,
    scale=0.02,
    axes=_DEGREE,
    bias_drift=5 * _DEGREE,
    scale_drift=0.02,
    axes_drift=0.02 * _DEGREE,
)


def drift_shape(rng: np.random.Generator, temperature_degc: Floats) -> Floats:
    """Return a part's normalised drift [N]: 0 at room temperature, 1 where it is largest."""
    slope, leak, step, wave = rng.uniform(-1.0, 1.0, 4)
    leak_degc, glass_degc = rng.uniform(15.0, 30.0), rng.uniform(-30.0, 60.0)
    width_degc, period_degc = rng.uniform(10.0, 20.0), rng.uniform(50.0, 120.0)
    phase = rng.uniform(0.0, 2.0 * math.pi)

    def drift(t: Floats) -> Floats:
        total: Floats = (
            slope * (t - ROOM_DEGC) / 65.0
            + leak * np.exp((t - HOTTEST_DEGC) / leak_degc)
            + step * np.tanh((t - glass_degc) / width_degc)
            + 0.3 * wave * np.sin(2.0 * math.pi * t / period_degc + phase)
        )
        return total

    zero = drift(np.array([ROOM_DEGC]))
    inside = drift(np.linspace(-40.0, 70.0, 111)) - zero
    shape: Floats = (drift(temperature_degc) - zero) / np.abs(inside).max()
    return shape


def _curve(rng: np.random.Generator, sizes: Floats) -> Curve:
    """Return drifts of the given `sizes` [M], sampled so finely that no fit sees the pieces."""
    nodes = np.linspace(COLDEST_DEGC, HOTTEST_DEGC, SEGMENTS + 1)
    spline = CubicSpline(nodes, np.stack([size * drift_shape(rng, nodes) for size in sizes], 1))
    return Curve.from_ppoly(spline.x, spline.c)


def draw_triad(rng: np.random.Generator, sizes: PartSizes) -> TriadCalibration:
    """Return the truth about three parts, drawn within `sizes`; their drifts at 0.5..1 of them."""
    scale, axes = (rng.uniform(-x, x, (3, 3)) for x in (sizes.scale, sizes.axes))
    matrix = np.eye(3) + np.where(np.eye(3) > 0.0, scale, axes)
    drifts = np.where(np.eye(3) > 0.0, sizes.scale_drift, sizes.axes_drift)
    drifts = drifts * rng.uniform(0.5, 1.0, (3, 3)) * rng.choice([-1.0, 1.0], (3, 3))
    bias_drift = sizes.bias_drift * rng.uniform(0.5, 1.0, 3)
    first, second, third = ((x, y, z) for x, y, z in matrix.tolist())
    x, y, z = rng.uniform(-sizes.bias, sizes.bias, 3).tolist()
    return TriadCalibration(
        matrix=(first, second, third),
        bias=(x, y, z),
        c=_curve(rng, bias_drift),
        matrix_drift=_curve(rng, drifts.ravel()),
    )


def draw_unit(rng: np.random.Generator) -> Calibration:
    """Return the truth about one unit: its gyros and accelerometers."""
    return Calibration(
        gyro=draw_triad(rng, GYROS), accel=draw_triad(rng, ACCELS), serial="BENCH", source="drawn"
    )
