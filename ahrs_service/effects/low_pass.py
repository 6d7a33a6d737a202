"""A sensor filter slower than believed."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.signal import bilinear_zpk, buttap, lp2lp_zpk, sosfilt, sosfilt_zi, zpk2sos

from ahrs_service.effects.base import Addition, Columns, Effect, Parameter, Values
from ahrs_service.records import Floats

_OVERSAMPLING = 8


def low_passed(time_s: Floats, signal: Floats, cutoff_hz: float, order: int) -> Floats:
    """Return `signal` [N, 3] behind a Butterworth filter, in equilibrium at the beginning.

    The filter runs on the signal drawn linearly between instants, eight times as often as they
    come, so that a cutoff near half their rate still turns the phase as the analog one does.
    """
    fine_s = np.linspace(time_s[0], time_s[-1], (len(time_s) - 1) * _OVERSAMPLING + 1)
    rate_hz = (len(fine_s) - 1) / (fine_s[-1] - fine_s[0])
    poles = lp2lp_zpk(*buttap(order), wo=2.0 * np.pi * cutoff_hz)
    sections = zpk2sos(*bilinear_zpk(*poles, fs=rate_hz))
    start = sosfilt_zi(sections)
    out = np.empty(signal.shape)
    for axis in range(signal.shape[1]):
        fine = np.interp(fine_s, time_s, signal[:, axis])
        fine, _ = sosfilt(sections, fine, zi=start * fine[0])
        out[:, axis] = np.interp(time_s, fine_s, fine)
    return out


@dataclass(frozen=True)
class LowPass(Effect):
    """The reading behind one more filter."""

    name: ClassVar[str] = "low_pass"
    title: ClassVar[str] = "sensor filter slower than believed"
    equation: ClassVar[str] = "H(s) u - u, H Butterworth of cutoff and order"
    excited_by: ClassVar[str] = "hard, short manoeuvres"
    taken_for: ClassVar[tuple[str, ...]] = ("imu_time_offset", "scale_factor")
    separated_by: ClassVar[str] = "shake the vehicle by hand at 1 to 5 Hz about each axis"
    has_inverse: ClassVar[bool] = False

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
