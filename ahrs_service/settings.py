"""Settings of every part: frozen, with defaults, validated where they enter (app.config_file).

Each part takes only its own class. Nothing here reads a file. The text below a field is its meaning
in `ahrs-service settings`, the unit in brackets at its end.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le

from ahrs_service.errors import InvalidValueError

_STRICT = {"extra": "forbid", "allow_inf_nan": False}
_Positive = Annotated[float, Gt(0.0)]
_NotNegative = Annotated[float, Ge(0.0)]
_Identity = Annotated[int, Ge(0), Le(255)]


@dataclass(frozen=True, slots=True)
class IntakeSettings:
    """Which vehicle and which IMU message the samples come from."""

    __pydantic_config__: ClassVar = _STRICT
    system: _Identity = 0
    """MAVLink system of the vehicle; 0 adopts the first autopilot heard."""
    component: _Identity = 0
    """MAVLink component of the autopilot; 0 adopts the first one heard."""
    imu_source: str = "auto"
    """IMU message, by its name in records.ImuSource; "auto" takes the best there is."""
    temperature_source: Literal["imu", "highres_imu"] = "imu"
    """Which temperature is the IMU's own: "imu" that of SCALED_IMU* and RAW_IMU only, "highres_imu"
    also that of HIGHRES_IMU, for recordings whose writer put it there."""


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """Which calibration of the sensor is used."""

    __pydantic_config__: ClassVar = _STRICT
    calibration: str = ""
    """A file, or a folder from which the file of this unit is taken, or "none"; empty takes the one
    a recording carries, if any."""
    unit: str = ""
    """Serial number of the unit, or the number of the autopilot's board in hex digits, where the
    autopilot does not report it."""
    force_calibration: bool = False
    """Use a calibration although its verdict says not to."""


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Limits of the three motion gates (Liu et al., sec. 4) and of the checks around them."""

    __pydantic_config__: ClassVar = _STRICT
    norm_m_s2: _Positive = 0.3
    """Limit of abs(norm(f) - g) [m/s^2]."""
    rate_rad_s: _Positive = 0.2
    """Limit of norm(w) [rad/s]."""
    angular_acceleration_rad_s2: _Positive = 2.0
    """Limit of norm(dw/dt) [rad/s^2]."""
    innovation_sigma: _Positive = 4.0
    """Limit of the tilt innovation, in its own standard deviations [1]."""
    accel_range_m_s2: _Positive = 156.0
    """Where an axis of the accelerometer clips [m/s^2]."""
    gyro_range_rad_s: _Positive = 34.9
    """Where an axis of the gyro clips [rad/s]."""
    smoothing_s: _NotNegative = 0.2
    """How long force and rate are averaged before they are compared [s]."""


@dataclass(frozen=True, slots=True)
class GateBudget:
    """Largest errors admitted to the correction of the gated mode: gate limits follow from them.

    Liu et al., sec. 4. They hold in the gated mode, and there before an AHRS_GATE_* parameter of
    the ground. What is None leaves that limit as GateSettings has it; `fusion.gating.limits`
    resolves. The sigmas are S(), the standard deviations in steady flight, so that noise and
    vibration do not lock the gate shut.
    """

    __pydantic_config__: ClassVar = _STRICT
    acceleration_m_s2: _Positive | None = None
    """Linear acceleration a_a admitted; replaces gate.norm_m_s2 [m/s^2]."""
    tilt_deg: Annotated[float, Gt(0.0), Le(60.0)] | None = None
    """In place of acceleration_m_s2: the tilt that a horizontal acceleration may fake [deg]."""
    centripetal_m_s2: _Positive | None = None
    """Centripetal acceleration a_w admitted; replaces gate.rate_rad_s [m/s^2]."""
    tangential_m_s2: _Positive | None = None
    """Tangential acceleration a_alpha admitted; replaces gate.angular_acceleration_rad_s2 [m/s^2].
"""
    turn_radius_m: _NotNegative = 0.0
    """Radius R of the turn of the centripetal budget [m]."""
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Arm L of the sensor from the centre of mass along body x, y, z [m]."""
    norm_sigma_m_s2: _NotNegative = 0.0
    """S() of abs(norm(f) - g) in steady flight [m/s^2]."""
    rate_sigma_rad_s: _NotNegative = 0.0
    """S() of norm(w) in steady flight [rad/s]."""
    angular_acceleration_sigma_rad_s2: _NotNegative = 0.0
    """S() of norm(dw/dt) in steady flight [rad/s^2]."""

    def __post_init__(self) -> None:
        """Raise ValueError for a budget from which no limit follows."""
        if self.acceleration_m_s2 is not None and self.tilt_deg is not None:
            raise InvalidValueError(
                f"acceleration_m_s2 = {self.acceleration_m_s2} and tilt_deg = {self.tilt_deg} are "
                "two budgets of one limit: give one of them"
            )
        if self.centripetal_m_s2 is not None and not (self.turn_radius_m or any(self.arm_m)):
            raise InvalidValueError(
                f"centripetal_m_s2 = {self.centripetal_m_s2} needs turn_radius_m or arm_m [m]"
            )
        if self.tangential_m_s2 is not None and not (self.arm_m[0] or self.arm_m[2]):
            raise InvalidValueError(
                f"tangential_m_s2 = {self.tangential_m_s2} needs arm_m [m] along x or z, "
                f"not {self.arm_m}"
            )


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """Which filter, and the noise of the sensors that it assumes."""

    __pydantic_config__: ClassVar = _STRICT
    mode: Literal["velocity", "gated"] = "velocity"
    """The filter: "velocity" also estimates the velocity, which the class of airframe bounds, so
    that accelerations average out; "gated" believes the accelerometer only in open gates."""
    airframe: Literal["auto", "fixed_wing", "multirotor", "hand_held", "other"] = "auto"
    """Class of vehicle; "auto" goes by HEARTBEAT.type."""
    gyro_sample: Literal["mean", "instant"] = "instant"
    """Whether a sample is the rate of one instant or the mean since the sample before."""
    gyro_noise_rad_s_rthz: _Positive = 0.001
    """Noise and vibration of the gyro [rad/s/sqrt(Hz)]."""
    gyro_bias_walk_rad_s2_rthz: _Positive = 1.5e-4
    """Random walk of the gyro bias [rad/s^2/sqrt(Hz)]."""
    gyro_bias_per_rtdegc_rad_s: _NotNegative = 3e-4
    """What a change of temperature adds to that walk [rad/s/sqrt(degC)]."""
    gyro_bias_sigma_rad_s: _Positive = 0.02
    """Gyro bias at power-on, 1-sigma [rad/s]."""
    gyro_scale_error_rts: _NotNegative = 0.002
    """Error of the angle that no gyro matrix explains, per rad/s of rate [sqrt(s)]."""
    gyro_rest_sigma_rad_s: _Positive = 0.02
    """Largest scatter of the gyro at rest, and 1-sigma of one reading there [rad/s]."""
    use_airspeed: bool = True
    """Use the airspeed of a fixed wing."""
    use_ground_velocity: bool = True
    """Use the velocity over ground of a GPS or of the autopilot."""
    velocity_lag_s: _NotNegative = 0.2
    """How late that velocity comes, before the filter has learnt it [s]."""
    alignment_s: _Positive = 1.0
    """Shortest first alignment [s]."""
    gap_s: _Positive = 0.5
    """A longer step between samples is a gap [s]."""
    magnetometer: bool = True
    """Use the magnetometer for the heading."""
    declination_deg: Annotated[float, Ge(-180.0), Le(180.0)] = 0.0
    """True north from magnetic north, east positive [deg]."""


@dataclass(frozen=True, slots=True)
class AirframeSettings:
    """How a class of vehicle moves through the air, along body x, y, z, and shakes its sensors."""

    __pydantic_config__: ClassVar = _STRICT
    forward_speed_m_s: _NotNegative
    """Usual speed along x [m/s]."""
    velocity_sigma_m_s: tuple[_Positive, _Positive, _Positive]
    """1-sigma of the velocity about that (about 0 for y and z) [m/s]."""
    velocity_correlation_s: tuple[_Positive, _Positive, _Positive]
    """How long a deviation from it lasts [s]."""
    drag_s: tuple[_NotNegative, _NotNegative, _NotNegative]
    """T of v = -T (f - f0) where air resistance shows in the force, else 0 [s]."""
    climb_sigma_m_s: _Positive
    """1-sigma of the speed up or down [m/s]."""
    climb_correlation_s: _Positive
    """How long a climb or descent lasts [s]."""
    accel_noise_m_s2: _Positive
    """What accelerates the vehicle while the gates are open, 1-sigma [m/s^2]."""
    velocity_noise_m_s_rts: _Positive
    """What noise and vibration of the accelerometer add to the velocity [m/s/sqrt(s)]."""
    accel_scale_error: _NotNegative
    """Scale error of the accelerometer, as a share of the force beyond 1 g [1]."""
    accel_bias_sigma_m_s2: _NotNegative
    """Accelerometer bias left by calibration, 1-sigma [m/s^2]."""
    gyro_matrix_sigma: _NotNegative
    """Scale and cross-axis error of the gyro left by calibration, 1-sigma [1]."""
    shaken_bias_walk_s_m_rts: _NotNegative = 0.0
    """What shaking of the accelerometer adds to the gyro bias walk, per m/s^2 of it
    [rad/s/sqrt(s)/(m/s^2)]."""


FIXED_WING = AirframeSettings(
    forward_speed_m_s=15.0,
    velocity_sigma_m_s=(6.0, 1.5, 0.75),
    velocity_correlation_s=(60.0, 2.0, 2.0),
    drag_s=(0.0, 1.5, 0.2),
    climb_sigma_m_s=3.0,
    climb_correlation_s=5.0,
    accel_noise_m_s2=1.5,
    velocity_noise_m_s_rts=0.2,
    accel_scale_error=0.1,
    accel_bias_sigma_m_s2=0.04,
    gyro_matrix_sigma=0.005,
)
"""Small fixed wings; configs/airframes/ says for each class where its numbers come from."""
MULTIROTOR = AirframeSettings(
    forward_speed_m_s=0.0,
    velocity_sigma_m_s=(2.0, 2.0, 3.0),
    velocity_correlation_s=(1.0, 1.0, 1.0),
    drag_s=(4.0, 4.0, 0.0),
    climb_sigma_m_s=3.0,
    climb_correlation_s=5.0,
    accel_noise_m_s2=0.7,
    velocity_noise_m_s_rts=0.35,
    accel_scale_error=0.1,
    accel_bias_sigma_m_s2=0.1,
    gyro_matrix_sigma=0.005,
    shaken_bias_walk_s_m_rts=4e-4,
)
"""Rotors without wings."""
HAND_HELD = AirframeSettings(
    forward_speed_m_s=0.0,
    velocity_sigma_m_s=(1.0, 1.0, 1.0),
    velocity_correlation_s=(0.5, 0.5, 0.5),
    drag_s=(0.0, 0.0, 0.0),
    climb_sigma_m_s=1.0,
    climb_correlation_s=1.0,
    accel_noise_m_s2=0.5,
    velocity_noise_m_s_rts=0.02,
    accel_scale_error=0.005,
    accel_bias_sigma_m_s2=0.0,
    gyro_matrix_sigma=0.004,
)
"""Turned and moved about by hand."""
OTHER = AirframeSettings(
    forward_speed_m_s=0.0,
    velocity_sigma_m_s=(8.0, 8.0, 3.0),
    velocity_correlation_s=(10.0, 10.0, 10.0),
    drag_s=(0.0, 0.0, 0.0),
    climb_sigma_m_s=3.0,
    climb_correlation_s=5.0,
    accel_noise_m_s2=0.7,
    velocity_noise_m_s_rts=0.5,
    accel_scale_error=0.1,
    accel_bias_sigma_m_s2=0.05,
    gyro_matrix_sigma=0.005,
)
"""Anything small that nothing is known of: rovers, boats."""


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """The link, our identity on it, the rates asked for, and the signing key."""

    __pydantic_config__: ClassVar = _STRICT
    uri: str = "udpin:127.0.0.1:14550"
    """udpin:, udpout:, tcp:, tcpin: HOST:PORT, or serial:DEVICE:BAUD."""
    system: _Identity = 0
    """Our MAVLink system; 0 takes that of the autopilot."""
    component: _Identity = 191
    """Our MAVLink component."""
    imu_rate_hz: _Positive = 200.0
    """Rate asked of the IMU message in use [Hz]."""
    temperature_rate_hz: _NotNegative = 5.0
    """Rate asked of SCALED_IMU for its temperature; 0 does not ask [Hz]."""
    aiding_rate_hz: _NotNegative = 10.0
    """Rate asked of ATTITUDE, VFR_HUD, LOCAL_POSITION_NED, GPS_RAW_INT; 0 does not ask [Hz]."""
    signing_key: str = ""
    """Passphrase or 64 hex digits; empty: neither signs nor checks."""
    signing_link: _Identity = 1
    """Link id of our signatures."""


@dataclass(frozen=True, slots=True)
class PublishSettings:
    """What is sent back to the autopilot and how often; 0 switches a message off."""

    __pydantic_config__: ClassVar = _STRICT
    attitude_rate_hz: _NotNegative = 50.0
    """Rate of ATTITUDE [Hz]."""
    attitude_quaternion_rate_hz: _NotNegative = 0.0
    """Rate of ATTITUDE_QUATERNION [Hz]."""
    named_value_rate_hz: _NotNegative = 0.0
    """Rate of NAMED_VALUE_FLOAT [Hz]."""


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """Where the .tlog goes, when a new one begins, and how much disk all may take."""

    __pydantic_config__: ClassVar = _STRICT
    directory: str = ""
    """Folder or .tlog file; empty does not record."""
    rotate_mb: _NotNegative = 100.0
    """Size at which a new file begins, at most half of limit_mb; 0 never [MB]."""
    limit_mb: _NotNegative = 1000.0
    """Size of all recordings in the folder beyond which the oldest is deleted; 0 never [MB]."""


@dataclass(frozen=True, slots=True)
class ViewerSettings:
    """The Rerun stream, on loopback, and as a file."""

    __pydantic_config__: ClassVar = _STRICT
    port: Annotated[int, Ge(0), Le(65535)] = 0
    """Loopback port of the stream; 0 is off."""
    rrd: str = ""
    """File the stream is also written to; empty for none."""
    memory_mb: _Positive = 200.0
    """History kept for a viewer that connects late [MB]."""
    period_s: _Positive = 0.1
    """How often new data is sent to the viewer [s]."""


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of the service, each part with its defaults.

    >>> from ahrs_service import Estimator, Settings, load_settings
    >>> from ahrs_service.settings import FusionSettings
    >>> estimator = Estimator(Settings(fusion=FusionSettings(airframe="multirotor")))
    >>> settings = load_settings(profile="fixed_wing", overrides=["gate.norm_m_s2=0.4"])
    >>> settings.fusion.airframe, settings.gate.norm_m_s2
    ('fixed_wing', 0.4)
    """

    __pydantic_config__: ClassVar = _STRICT
    intake: IntakeSettings = field(default_factory=IntakeSettings)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    gate: GateSettings = field(default_factory=GateSettings)
    gate_budget: GateBudget = field(default_factory=GateBudget)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    fixed_wing: AirframeSettings = FIXED_WING
    multirotor: AirframeSettings = MULTIROTOR
    hand_held: AirframeSettings = HAND_HELD
    other: AirframeSettings = OTHER
    link: LinkSettings = field(default_factory=LinkSettings)
    publish: PublishSettings = field(default_factory=PublishSettings)
    recorder: RecorderSettings = field(default_factory=RecorderSettings)
    viewer: ViewerSettings = field(default_factory=ViewerSettings)
