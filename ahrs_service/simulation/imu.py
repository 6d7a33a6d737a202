"""The simulated IMU: true motion, the effects of a twin and vibration through the forward model.

    reading = forward(u + what the effects add to u + vibration) + noise

u is the ideal reading at the reference point.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ahrs_service.effects.base import Effect, Values, apply
from ahrs_service.records import Floats, Rows
from ahrs_service.sensor.curve import Curve
from ahrs_service.sensor.forward import forward_columns
from ahrs_service.sensor.noise import TriadNoise, sensor_noise
from ahrs_service.sensor.parameters import Calibration, TriadCalibration, Vector, coefficients
from ahrs_service.simulation.effect_inputs import columns_of, needed
from ahrs_service.simulation.environment import Propeller


@dataclass(frozen=True, slots=True)
class Imu:
    """A sensor and its effects: the twin of a real one.

    Its calibration, its noise, the propeller's vibration (None for none), and physical effects
    with their parameters.
    """

    calibration: Calibration = field(default_factory=Calibration.ideal)
    gyro_noise: TriadNoise = field(default_factory=TriadNoise)
    accel_noise: TriadNoise = field(default_factory=TriadNoise)
    propeller: Propeller | None = None
    effects: tuple[tuple[Effect, Values], ...] = ()

    def measure(
        self,
        truth: Rows,
        temperature_degc: Floats,
        rate_hz: float,
        rng: np.random.Generator,
        current_a: Floats | None = None,
        vibration_m_s2: Floats | None = None,
    ) -> tuple[Floats, Floats]:
        """Return what the sensor gives: rate [N, 3] [rad/s] and specific force [N, 3] [m/s^2].

        `truth` [N] TRUTH_DTYPE at `rate_hz`, `temperature_degc` [N] of the sensor, `current_a` [N]
        of the battery; `vibration_m_s2` [N] 1-sigma, where it is known better than by the
        propeller. ValueError names an effect and what it needs that is not known.
        """
        rate, force = truth["rate_rad_s"], truth["force_m_s2"]
        if self.effects:
            if vibration_m_s2 is None:
                quiet = np.zeros(len(truth))
                level = self.propeller.level_m_s2(truth["throttle"]) if self.propeller else quiet
                vibration_m_s2 = level
            columns = columns_of(truth, temperature_degc, rate_hz, current_a, vibration_m_s2)
            rate, force = apply(columns, needed(self.effects, columns))
        if self.propeller is not None:
            rate_shake, force_shake = self.propeller.shake(truth["throttle"], rate_hz, rng)
            rate, force = rate + rate_shake, force + force_shake
        known, time_s = coefficients(self.calibration), truth["time_s"]
        gyro, accel = forward_columns(known, rate, force, temperature_degc, time_s)
        gyro += sensor_noise(rng, len(truth), rate_hz, self.gyro_noise)
        accel += sensor_noise(rng, len(truth), rate_hz, self.accel_noise)
        return gyro, accel

    def sibling(self, rng: np.random.Generator) -> "Imu":
        """Return another sensor of this kind, drawn at random.

        Every error of the calibration is multiplied by its own standard normal draw, the
        drift with temperature by one for each axis: the given errors are its 1-sigma.
        """
        calibration = replace(
            self.calibration,
            gyro=_sibling_triad(self.calibration.gyro, rng),
            accel=_sibling_triad(self.calibration.accel, rng),
        )
        return replace(self, calibration=calibration)


def _sibling_triad(triad: TriadCalibration, rng: np.random.Generator) -> TriadCalibration:
    first, second, third = _rows(np.eye(3) + (triad.matrix - np.eye(3)) * rng.normal(size=(3, 3)))
    (bias,) = _rows(np.array([triad.bias]) * rng.normal(size=3))
    drift = rng.normal(size=3)
    a, b, c = (curve.times(drift) for curve in (triad.a, triad.b, triad.c))
    return replace(triad, matrix=(first, second, third), bias=bias, a=a, b=b, c=c)


def _rows(values: Floats) -> tuple[Vector, ...]:
    return tuple((x, y, z) for x, y, z in values.tolist())


def consumer_grade() -> Imu:
    """Return a MEMS IMU as small autopilots carry, with what their own calibration leaves.

    Biases of some 0.2 deg/s and 4 mg, scale and cross-axis errors of some 0.3 %, and a thermal
    drift of up to 0.4 deg/s and 15 mg over 20 K.
    """
    nodes = (-10.0, 10.0, 25.0, 40.0, 70.0)
    gyro_c = (0.006, 0.002, 0.0, -0.004, -0.012), (-0.004, -0.002, 0.0, 0.003, 0.008)
    accel_c = (-0.20, -0.08, 0.0, 0.09, 0.30), (0.15, 0.06, 0.0, -0.05, -0.18)
    slopes = tuple((s, -s, 0.5 * s) for s in (-0.004, -0.002, 0.0, 0.002, 0.006))
    gyro = TriadCalibration(
        matrix=((1.003, 0.002, 0.0), (-0.001, 0.998, 0.001), (0.0, -0.002, 1.002)),
        bias=(0.003, -0.004, 0.002),
        b=Curve.linear(nodes, slopes),
        c=Curve.linear(nodes, [(x, y, 0.5 * x) for x, y in zip(*gyro_c, strict=True)]),
    )
    accel = TriadCalibration(
        matrix=((1.002, 0.001, 0.0), (0.001, 0.997, -0.001), (0.0, 0.001, 1.001)),
        bias=(0.04, -0.03, 0.05),
        b=Curve.linear(nodes, slopes),
        c=Curve.linear(nodes, [(x, y, -x) for x, y in zip(*accel_c, strict=True)]),
    )
    return Imu(
        calibration=Calibration(gyro=gyro, accel=accel, serial="SIM-1", source="simulation"),
        gyro_noise=TriadNoise(density=1e-4, walk=2e-6, wander=2e-4, wander_s=100.0),
        accel_noise=TriadNoise(density=2e-3, walk=2e-5, wander=5e-3, wander_s=100.0),
        propeller=Propeller(),
    )


def seed_grade() -> Imu:
    """Return the sensors of Liu et al. behind their compensation.

    The accelerometers err by at most 5 mg on any axis, as the paper says: a bias of 2 mg, 0.1 % of
    scale and axes, and a drift with temperature. Of its gyros it gives no figures, so these are of
    the class that it used (single-axis MEMS of about 2010): 0.05 deg/s per sqrt(Hz), 0.05 deg/s of
    turn-on bias, a wander of 0.015 deg/s, 0.1 % of scale and axes, 0.05 deg/s of drift over 15 K.
    """
    nodes = (-40.0, 18.0, 33.0, 70.0)
    degree = math.radians(1.0)
    rise = (-0.1 * degree, 0.0, 0.05 * degree, 0.1 * degree)
    lift = (0.02, 0.0, 0.012, 0.02)
    gyro = TriadCalibration(
        matrix=((1.001, 0.0008, -0.0005), (-0.0005, 0.999, 0.001), (0.001, -0.0008, 1.001)),
        bias=(0.05 * degree, -0.04 * degree, 0.05 * degree),
        c=Curve.linear(nodes, [(x, -x, x) for x in rise]),
    )
    accel = TriadCalibration(
        matrix=((1.001, 0.0005, -0.001), (0.001, 0.9995, 0.0005), (-0.0005, 0.001, 0.999)),
        bias=(0.018, -0.024, 0.018),
        c=Curve.linear(nodes, [(x, -x, -x) for x in lift]),
    )
    return Imu(
        calibration=Calibration(gyro=gyro, accel=accel, serial="SEED", source="Liu et al."),
        gyro_noise=TriadNoise(
            density=0.05 * degree, walk=1e-6, wander=0.015 * degree, wander_s=200.0
        ),
        accel_noise=TriadNoise(density=2e-3, walk=1e-5, wander=5e-3, wander_s=200.0),
        propeller=Propeller(),
    )
