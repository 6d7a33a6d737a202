"""A sensor filter slower than believed."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.signal import butter, cont2discrete, lfilter, lfilter_zi

from ahrs_service.effects.base import (
    Addition,
    Columns,
    Effect,
    Parameter,
    Triad,
    Values,
)
from ahrs_service.records import Floats

_EVEN_SHARE = 1e-3
_OVERSAMPLING = 8


def low_passed(time_s: Floats, signal: Floats, cutoff_hz: float, order: int) -> Floats:
    """Return `signal` [N, 3] behind a Butterworth filter, in equilibrium at the beginning.

    The signal is drawn linearly between instants, and the analog filter is exact for that
    (first-order hold: Franklin, Powell, Workman, Digital Control, sec. 6.3.2). Where the instants
    are uneven it runs on a grid eight times as fine.
    """
    steps = np.diff(time_s)
    is_even = np.ptp(steps) < _EVEN_SHARE * steps.mean()
    count = len(time_s) if is_even else (len(time_s) - 1) * _OVERSAMPLING + 1
    even_s, step_s = np.linspace(time_s[0], time_s[-1], count, retstep=True)
    drawn = signal if is_even else _drawn(even_s, time_s, signal)
    analog = butter(order, 2.0 * np.pi * cutoff_hz, analog=True)
    numerator, denominator, _ = cont2discrete(analog, step_s, method="foh")
    numerator = np.ravel(numerator)
    start = lfilter_zi(numerator, denominator)[:, None] * drawn[0]
    filtered, _ = lfilter(numerator, denominator, drawn, axis=0, zi=start)
    return filtered if is_even else _drawn(time_s, even_s, filtered)


def _drawn(at_s: Floats, time_s: Floats, signal: Floats) -> Floats:
    return np.column_stack([np.interp(at_s, time_s, column) for column in signal.T])


@dataclass(frozen=True)
class LowPass(Effect):
    """The reading behind one more filter."""

    triads: ClassVar[tuple[Triad, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "low_pass"
    title: ClassVar[str] = "sensor filter slower than believed"
    equation: ClassVar[str] = "H(s) u - u, H Butterworth of cutoff and order"
    excited_by: ClassVar[str] = "hard, short manoeuvres"
    taken_for: ClassVar[tuple[str, ...]] = ("imu_time_offset", "scale_factor")
    separated_by: ClassVar[str] = "shake the vehicle by hand at 1 to 5 Hz about each axis"
    not_live: ClassVar[str] = (
        "what a filter took away comes back only with amplified noise; open the filter"
    )
    alters_motion: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Cutoffs of 5 to 260 Hz (MPU-6000, DLPF_CFG)."""
        source = "MPU-6000 register map, DLPF_CFG"
        return (
            Parameter(
                "cutoff_hz",
                "Hz",
                (),
                260.0,
                source,
                neutral=np.inf,
                grid=(2.5, 4.0, 6.0, 9.0, 13.0, 20.0, 30.0, 45.0, 70.0),
                bounds=(0.5, 400.0),
            ),
            Parameter("order", "1", (), 4.0, source, neutral=1.0, grid=(1.0, 2.0), is_whole=True),
        )

    def add(self, columns: Columns, values: Values) -> Addition:
        """Return what the filter takes away."""
        cutoff_hz, order = float(values["cutoff_hz"]), int(values["order"])
        u = self.ideal(columns)
        if not np.isfinite(cutoff_hz):
            return self.on_triad(np.zeros(u.shape))
        return self.on_triad(low_passed(columns.time_s, u, cutoff_hz, order) - u)
