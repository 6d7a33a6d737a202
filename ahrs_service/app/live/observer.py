"""What the daemon shows in the viewer: estimates, their attitude, temperatures, figures."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from ahrs_service.errors import ConfigError, ViewerError
from ahrs_service.fusion.gating import in_force
from ahrs_service.records import Rows
from ahrs_service.rotation import from_euler
from ahrs_service.settings import Settings
from ahrs_service.viz.live import LiveViewer

_IMU_TEMPERATURE: Final = {
    "SCALED_IMU": "IMU 1",
    "RAW_IMU": "IMU 1",
    "SCALED_IMU2": "IMU 2",
    "SCALED_IMU3": "IMU 3",
}
_BAROMETER: Final = {"SCALED_PRESSURE": "barometer", "SCALED_PRESSURE2": "barometer 2"}
_LEVELS: Final = {"info": "INFO", "warning": "WARN", "error": "ERROR"}


class Observer:
    """Feeds the viewer; every call is cheap and none can block or raise.

    The constructor raises ConfigError where the port is in use or the file cannot be written.
    """

    def __init__(self, settings: Settings) -> None:
        viewer = settings.viewer
        self._viewer = LiveViewer(
            viewer.port,
            viewer.rrd,
            viewer.memory_mb,
            viewer.period_s,
            in_force(settings),
            shows_sensor=bool(settings.sensor.calibration),
        )
        try:
            self._viewer.start()
        except ViewerError as error:
            raise ConfigError(str(error)) from None
        self._sources = {"ATTITUDE": self._attitude, "ATTITUDE_QUATERNION": self._quaternion}
        self._euler_only = True

    @property
    def where(self) -> str:
        """Where to look: the address to connect to, and the file."""
        parts = []
        if self._viewer.uri:
            parts.append(f"rerun --connect {self._viewer.uri}")
        if self._viewer.rrd:
            parts.append(f"file {self._viewer.rrd}")
        return ", ".join(parts)

    @property
    def dropped(self) -> int:
        """Rows that the viewer was too slow for."""
        return self._viewer.dropped

    def estimate(self, estimates: Rows, readings: Rows | None = None) -> None:
        """Show our estimate [1] together with the reading [1] that it was made from."""
        self._viewer.estimate(estimates, readings)

    def message(self, message: Any) -> None:
        """Show what a message of the vehicle reports besides the IMU samples."""
        name = message.get_type()
        if name in self._sources:
            self._sources[name](message)
        elif name in _IMU_TEMPERATURE and message.temperature:
            time_ns = _time_ns(message)
            self._viewer.temperature(_IMU_TEMPERATURE[name], time_ns, message.temperature / 100.0)
        elif name in _BAROMETER:
            time_ns = message.time_boot_ms * 1_000_000
            self._viewer.temperature(_BAROMETER[name], time_ns, message.temperature / 100.0)

    def _attitude(self, message: Any) -> None:
        if self._euler_only and message.get_srcComponent() == 1:
            q = np.empty(4)
            from_euler(message.roll, message.pitch, message.yaw, q)
            self._viewer.reference(message.time_boot_ms * 1_000_000, q)

    def _quaternion(self, message: Any) -> None:
        self._euler_only = False
        q = (message.q1, message.q2, message.q3, message.q4)
        self._viewer.reference(message.time_boot_ms * 1_000_000, q)

    def configure(self, settings: Settings) -> None:
        """Show the limits of the gate as they are from now on."""
        self._viewer.gate = in_force(settings)

    def figures(self, rates_hz: Mapping[str, float], drops: Mapping[str, int]) -> None:
        """Show the current rates and losses."""
        self._viewer.rates(rates_hz)
        self._viewer.drops(drops)

    def log(self, level: str, text: str) -> None:
        """Show a line of the log."""
        self._viewer.log(_LEVELS[level], text)

    def close(self) -> None:
        """Send what is pending and leave the file complete."""
        self._viewer.close()


def _time_ns(message: Any) -> int:
    """Return a message's time since boot [ns], whichever field holds it."""
    if hasattr(message, "time_boot_ms"):
        return int(message.time_boot_ms) * 1_000_000
    return int(message.time_usec) * 1000
