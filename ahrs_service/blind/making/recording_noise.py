"""The noise of sensor and reference: its spectra, known to the oracle, and random draws.

Power spectral densities are one-sided [unit^2/Hz]. A wander (first-order Gauss-Markov process)
of standard deviation s and correlation time T has 4 s^2 T / (1 + (2 pi f T)^2).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.signal import butter, lfilter, sosfilt, sosfreqz

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Floats

SHAKE_AXES: Final = np.array([0.8, 0.8, 1.4])
"""Vibration of the accelerometer's axes for an amplitude of 1 m/s^2 [m/s^2]."""
GYRO_SHAKE_RAD_S: Final = 0.0145
"""Vibration of the gyro's axes for an amplitude of 1 m/s^2 [rad/s]."""

_SHAKE_BAND_HZ: Final = (50.0, 90.0)  # A choice: once per revolution at 3000 to 5400 rpm [Hz]
_REFERENCE_HZ: Final = 50.0
"""As messages._REFERENCE_HZ [Hz]: white noise of a report is spread over half of it."""


@dataclass(frozen=True, slots=True)
class Wander:
    """A first-order Gauss-Markov process: standard deviation and correlation time [s]."""

    sigma: float
    time_s: float

    def draw(self, rng: np.random.Generator, count: int, step_s: float) -> Floats:
        """Draw [count, 3] at steps of `step_s` [s]."""
        decay = np.exp(-step_s / self.time_s)
        start = rng.normal(0.0, self.sigma, (1, 3))
        drive = rng.normal(0.0, self.sigma * np.sqrt(1.0 - decay**2), (count, 3))
        drive[0] = start
        return np.asarray(lfilter([1.0], [1.0, -decay], drive, axis=0), np.float64)

    def psd(self, frequency_hz: Floats) -> Floats:
        """One-sided density at the frequencies [unit^2/Hz]."""
        ratio = 2.0 * np.pi * frequency_hz * self.time_s
        return 4.0 * self.sigma**2 * self.time_s / (1.0 + ratio**2)


@dataclass(frozen=True, slots=True)
class ReferenceError:
    """Error of attitude [rad] and velocity [m/s]: a wander, and white noise per message."""

    attitude: Wander
    attitude_white_rad: float
    velocity: Wander
    velocity_white_m_s: float


ENCODER: Final = ReferenceError(Wander(0.0, 1.0), 3.5e-5, Wander(0.0, 1.0), 0.0)
"""Two-axis table: encoder of 0.002 deg, and a fixed position."""

INS: Final = ReferenceError(
    Wander(np.radians(0.04), 8.0), np.radians(0.005), Wander(0.03, 3.0), 0.005
)
"""Inertial navigation system on the vehicle: 0.04 deg over 8 s, 0.03 m/s over 3 s."""


@dataclass(frozen=True, slots=True)
class NoiseLaw:
    """White noise densities [unit/sqrt(Hz), one-sided], wander, bias, reference, vibration."""

    gyro_density: float
    accel_density: float
    gyro_wander: Wander
    accel_wander: Wander
    gyro_bias: Floats
    accel_bias: Floats
    reference: ReferenceError
    shake_m_s2: float
    """Root mean square of the vibration's amplitude over the recording."""

    def gyro_psd(self, frequency_hz: Floats) -> Floats:
        """Density [K, 3] of the gyro reading minus the reference's rate."""
        omega2 = (2.0 * np.pi * frequency_hz) ** 2
        psd = self.gyro_density**2 + self.gyro_wander.psd(frequency_hz)
        if self.reference is INS:
            psd = psd + omega2 * self._attitude_psd(frequency_hz)
        shake = (GYRO_SHAKE_RAD_S * self.shake_m_s2) ** 2 * _shake_psd(frequency_hz)
        return np.repeat((psd + shake)[:, None], 3, axis=1)

    def accel_psd(self, frequency_hz: Floats) -> Floats:
        """Density [K, 3] of the accelerometer reading minus the reference's specific force.

        A tilt of the reference projects gravity onto x and y.
        """
        omega2 = (2.0 * np.pi * frequency_hz) ** 2
        psd = self.accel_density**2 + self.accel_wander.psd(frequency_hz)
        white = 2.0 * self.reference.velocity_white_m_s**2 / _REFERENCE_HZ
        psd = psd + omega2 * (white + self.reference.velocity.psd(frequency_hz))
        tilt = STANDARD_GRAVITY_M_S2**2 * self._attitude_psd(frequency_hz)
        shake = (SHAKE_AXES * self.shake_m_s2) ** 2 * _shake_psd(frequency_hz)[:, None]
        return np.asarray(psd[:, None] + tilt[:, None] * np.array([1.0, 1.0, 0.05]) + shake)

    def _attitude_psd(self, frequency_hz: Floats) -> Floats:
        white = 2.0 * self.reference.attitude_white_rad**2 / _REFERENCE_HZ
        return white + self.reference.attitude.psd(frequency_hz)


def draw_law(rng: np.random.Generator, is_bench: bool, shake_m_s2: float) -> NoiseLaw:
    """Draw a unit: an MPU-class sensor with a turn-on bias and a wander of random size."""
    grade = rng.uniform(0.8, 1.25, 2)
    return NoiseLaw(
        1.05e-4 * grade[0],
        1.27e-3 * grade[1],
        Wander(_log_uniform(rng, 2e-5, 2e-4), _log_uniform(rng, 20.0, 200.0)),
        Wander(_log_uniform(rng, 3e-4, 3e-3), _log_uniform(rng, 20.0, 200.0)),
        rng.normal(0.0, 0.006, 3),
        rng.normal(0.0, 0.18, 3),
        ENCODER if is_bench else INS,
        shake_m_s2,
    )


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _shake_filter() -> Floats:
    """Band of the airframe's vibration at 200 Hz sampling, as second-order sections."""
    return np.asarray(butter(2, _SHAKE_BAND_HZ, "bandpass", fs=200.0, output="sos"), np.float64)


def _shake_psd(frequency_hz: Floats) -> Floats:
    """One-sided density of vibration with unit variance [1/Hz]."""
    grid = np.linspace(0.0, 100.0, 2048)
    gain = np.abs(sosfreqz(_shake_filter(), grid, fs=200.0)[1]) ** 2
    return np.asarray(np.interp(frequency_hz, grid, gain / np.trapezoid(gain, grid)), np.float64)


def draw_shake(rng: np.random.Generator, amplitude_m_s2: Floats) -> tuple[Floats, Floats]:
    """Draw vibration of gyro and accelerometer [N, 3] each, at 200 Hz."""
    raw = sosfilt(_shake_filter(), rng.standard_normal((len(amplitude_m_s2) + 200, 6)), axis=0)
    raw = raw[200:] / raw[200:].std(axis=0) * amplitude_m_s2[:, None]
    return GYRO_SHAKE_RAD_S * raw[:, :3], SHAKE_AXES * raw[:, 3:]


def following(
    rng: np.random.Generator, wander: Wander, shape: Floats, step_s: float, tries: int = 30
) -> Floats:
    """Draw wander [N, 3] and keep, per axis, the draw that correlates most with `shape` [N]."""
    draws = np.stack([wander.draw(rng, len(shape), step_s) for _ in range(tries)])
    centred = draws - draws.mean(axis=1, keepdims=True)
    likeness = np.abs(np.einsum("dna,n->da", centred, shape - shape.mean()))
    likeness /= np.linalg.norm(centred, axis=1)
    best = likeness.argmax(axis=0)
    return np.stack([draws[best[axis], :, axis] for axis in range(3)], axis=1)
