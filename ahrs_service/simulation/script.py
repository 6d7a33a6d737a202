"""A flight of the user's own: its phases, one after another, and the weather.

As TOML, for app.simulate (all but `phases` may be left out):

    wind_m_s = 4.0
    turbulence = 1.0                # 1 is a breezy day

    [warmth]                        # of the sensor's box
    ambient_degc = 5.0
    heating_k = 25.0
    time_constant_s = 120.0

    [[phases]]
    name = "warm-up"
    seconds = 60.0
    speed_m_s = 0.0
    throttle = 0.15
    is_airborne = false

    [[phases]]
    name = "steep turn"
    seconds = 20.0
    roll_deg = 50.0
    speed_m_s = 18.0
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Ge, Le, MinLen

from ahrs_service.simulation.environment import Warmth
from ahrs_service.simulation.imu import Imu
from ahrs_service.simulation.phases import Phase, scripted_phases
from ahrs_service.simulation.scenario import Scenario


@dataclass(frozen=True, slots=True)
class Script:
    """A flight as its user wrote it.

    `phases` hold as long as they say; wind [m/s] aloft, turbulence [1], `warmth` of the box.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}
    phases: Annotated[tuple[Phase, ...], MinLen(1)]
    wind_m_s: Annotated[float, Ge(0.0), Le(50.0)] = 4.0
    turbulence: Annotated[float, Ge(0.0), Le(10.0)] = 1.0
    warmth: Warmth | None = None

    @property
    def seconds(self) -> float:
        """Length of the flight [s]."""
        return sum(phase.seconds for phase in self.phases)

    def scenario(self, imu: Imu) -> Scenario:
        """Return the flight with `imu` aboard."""
        plan = scripted_phases(self.phases)
        return Scenario(
            "by a script", lambda _: plan, imu, self.turbulence, self.wind_m_s, warmth=self.warmth
        )
