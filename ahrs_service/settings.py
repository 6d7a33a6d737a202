"""Settings of every part: frozen, with defaults, validated where they enter (app.config_file).

Each part takes only its own class. Nothing here reads a file.
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
    """Which vehicle and which IMU message the samples come from.

    `system` 0 adopts the first autopilot heard; `imu_source` "auto" takes the best message there
    is; `temperature_source` "imu" trusts SCALED_IMU* and RAW_IMU only, "highres_imu" also
    HIGHRES_IMU's field (right for recordings whose writer put the IMU's own temperature there).
    """

    __pydantic_config__: ClassVar = _STRICT
    system: _Identity = 0
    component: _Identity = 0
    imu_source: str = "auto"
    temperature_source: Literal["imu", "highres_imu"] = "imu"


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """Which calibration of the sensor is used.

    `calibration` is a file, or a folder of which the one of this unit is taken, or "none"; empty
    takes that of a recording, where it has one. `unit` is the serial number, or the number of the
    autopilot's board in hex digits, where the autopilot does not tell it. `force_calibration` uses
    one whose verdict says not to.
    """

    __pydantic_config__: ClassVar = _STRICT
    calibration: str = ""
    unit: str = ""
    force_calibration: bool = False


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Limits of the three motion gates (Liu et al., sec. 4) and of the checks around them.

    `norm_m_s2` [m/s^2], `rate_rad_s` [rad/s], `angular_acceleration_rad_s2` [rad/s^2],
    `innovation_sigma` [1-sigma], `accel_range_m_s2` and `gyro_range_rad_s` where the sensor clips,
    `smoothing_s` how long force and rate are averaged before they are compared [s].
    """

    __pydantic_config__: ClassVar = _STRICT
    norm_m_s2: _Positive = 0.3
    rate_rad_s: _Positive = 0.2
    angular_acceleration_rad_s2: _Positive = 2.0
    innovation_sigma: _Positive = 4.0
    accel_range_m_s2: _Positive = 156.0
    gyro_range_rad_s: _Positive = 34.9
    smoothing_s: _NotNegative = 0.2


@dataclass(frozen=True, slots=True)
class GateBudget:
    """Largest errors admitted to the correction, from which limits follow (Liu et al., sec. 4).

    They hold in the gated mode, and there before an AHRS_GATE_* parameter of the ground.
    What is None leaves that limit as GateSettings has it; `fusion.gating.limits` resolves.
    `acceleration_m_s2` is the linear acceleration a_a [m/s^2], or in its place `tilt_deg` the tilt
    that a horizontal acceleration may fake [deg]; `centripetal_m_s2` is a_w on a turn of radius
    `turn_radius_m` R, `tangential_m_s2` a_alpha of a sensor `arm_m` L [m] (body x, y, z) off the
    centre of mass. The sigmas are S(), the standard deviations of abs(norm(f) - g0) [m/s^2],
    norm(w) [rad/s] and norm(dw/dt) [rad/s^2] in steady flight, so that noise and vibration do not
    lock the gate shut.
    """

    __pydantic_config__: ClassVar = _STRICT
    acceleration_m_s2: _Positive | None = None
    tilt_deg: Annotated[float, Gt(0.0), Le(60.0)] | None = None
    centripetal_m_s2: _Positive | None = None
    tangential_m_s2: _Positive | None = None
    turn_radius_m: _NotNegative = 0.0
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    norm_sigma_m_s2: _NotNegative = 0.0
    rate_sigma_rad_s: _NotNegative = 0.0
    angular_acceleration_sigma_rad_s2: _NotNegative = 0.0

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
    """Which filter, and the noise of the sensors and of what they are told about the world.

    `mode` "velocity" also estimates the velocity, which the class of airframe bounds, so that
    accelerations average out; "gated" believes the accelerometer only while the gates are open.
    `airframe` "auto" goes by HEARTBEAT.type. `gyro_sample` says whether a sample is the rate of one
    instant or the mean since the sample before. Of the gyro: noise and vibration [rad/s/sqrt(Hz)],
    bias walk [rad/s^2/sqrt(Hz)] and what a change of temperature adds to it [rad/s/sqrt(degC)],
    1-sigma at power-on and of one reading at rest [rad/s], `gyro_scale_error_rts` what no matrix
    explains of the angle, per rad/s of rate [sqrt(s)]. `velocity_lag_s` is how late a measured
    velocity comes, before the filter has learnt it [s]; `alignment_s` how long the first alignment
    takes at least and `gap_s` which step between samples is a gap [s].
    """

    __pydantic_config__: ClassVar = _STRICT
    mode: Literal["velocity", "gated"] = "velocity"
    airframe: Literal["auto", "fixed_wing", "multirotor", "hand_held", "other"] = "auto"
    gyro_sample: Literal["mean", "instant"] = "instant"
    gyro_noise_rad_s_rthz: _Positive = 0.001
    gyro_bias_walk_rad_s2_rthz: _Positive = 1.5e-4
    gyro_bias_per_rtdegc_rad_s: _NotNegative = 3e-4
    gyro_bias_sigma_rad_s: _Positive = 0.02
    gyro_scale_error_rts: _NotNegative = 0.002
    gyro_rest_sigma_rad_s: _Positive = 0.02
    use_airspeed: bool = True
    use_ground_velocity: bool = True
    velocity_lag_s: _NotNegative = 0.2
    alignment_s: _Positive = 1.0
    gap_s: _Positive = 0.5
    magnetometer: bool = True
    declination_deg: Annotated[float, Ge(-180.0), Le(180.0)] = 0.0


@dataclass(frozen=True, slots=True)
class AirframeSettings:
    """How a class of vehicle moves through the air, along body x, y, z, and shakes its sensors.

    `forward_speed_m_s` the usual speed along x [m/s]; per axis the 1-sigma about it (about 0 for y
    and z) [m/s], and how long a deviation lasts [s]; `drag_s` T of v = -T (f - f0) where the air's
    resistance shows in the force, 0 where it does not [s]; the same for the speed up and down.
    `accel_noise_m_s2` is what accelerates the vehicle while the gates are open [m/s^2],
    `velocity_noise_m_s_rts` what noise and vibration of the accelerometer add to the velocity [m/s
    per sqrt(s)], `accel_scale_error` what its scale does, as a share of the force beyond 1 g.
    `accel_bias_sigma_m_s2` [m/s^2] and `gyro_matrix_sigma` [1] are what calibration left,
    `shaken_bias_walk_s_m_rts` what a shake of the accelerometer adds to the gyro's bias walk [rad/s
    per sqrt(s) and m/s^2].
    """

    __pydantic_config__: ClassVar = _STRICT
    forward_speed_m_s: _NotNegative
    velocity_sigma_m_s: tuple[_Positive, _Positive, _Positive]
    velocity_correlation_s: tuple[_Positive, _Positive, _Positive]
    drag_s: tuple[_NotNegative, _NotNegative, _NotNegative]
    climb_sigma_m_s: _Positive
    climb_correlation_s: _Positive
    accel_noise_m_s2: _Positive
    velocity_noise_m_s_rts: _Positive
    accel_scale_error: _NotNegative
    accel_bias_sigma_m_s2: _NotNegative
    gyro_matrix_sigma: _NotNegative
    shaken_bias_walk_s_m_rts: _NotNegative = 0.0


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
    """Identity on the link, rates asked, and the signing key.

    `system` 0 adopts the autopilot's; `signing_key` is a passphrase or 64 hex digits, empty for
    none; rates in Hz.
    """

    __pydantic_config__: ClassVar = _STRICT
    uri: str = "udpin:127.0.0.1:14550"
    system: _Identity = 0
    component: _Identity = 191
    imu_rate_hz: _Positive = 200.0
    temperature_rate_hz: _NotNegative = 5.0
    aiding_rate_hz: _NotNegative = 10.0
    signing_key: str = ""
    signing_link: _Identity = 1


@dataclass(frozen=True, slots=True)
class PublishSettings:
    """What is sent back to the autopilot and how often [Hz]; 0 switches a message off."""

    __pydantic_config__: ClassVar = _STRICT
    attitude_rate_hz: _NotNegative = 50.0
    attitude_quaternion_rate_hz: _NotNegative = 0.0
    named_value_rate_hz: _NotNegative = 0.0


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """Where the .tlog goes: rotation by size, and how much disk it may take in all."""

    __pydantic_config__: ClassVar = _STRICT
    directory: str = ""
    rotate_mb: _NotNegative = 100.0
    limit_mb: _NotNegative = 1000.0


@dataclass(frozen=True, slots=True)
class ViewerSettings:
    """The Rerun stream: loopback port (0 is off), optional .rrd file, bounded history."""

    __pydantic_config__: ClassVar = _STRICT
    port: Annotated[int, Ge(0), Le(65535)] = 0
    rrd: str = ""
    memory_mb: _Positive = 200.0
    period_s: _Positive = 0.1


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
