"""Live attitude and heading reference service for small UAVs.

    arrays in, attitude out     estimate(gyr, acc, rate_hz=100.0, mag=mag)
    a live loop                 Estimator().update(t, gyr, acc) for each sample as it comes
    a log                       read_recording("flight.tlog"), then Estimator().take(its readings)
    what an IMU does wrong      diagnose("flight.tlog")

Names load when they are first used: to import the package takes a few milliseconds and loads
neither the compiler nor the viewer.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ahrs_service.app.diagnose.recording_diagnosis import diagnose as diagnose
    from ahrs_service.app.estimate.arrays import Attitude as Attitude
    from ahrs_service.app.estimate.arrays import estimate as estimate
    from ahrs_service.app.files.calibration_file import load as load_calibration
    from ahrs_service.app.files.config_file import load as load_settings
    from ahrs_service.errors import AhrsError as AhrsError
    from ahrs_service.estimator import Estimator as Estimator
    from ahrs_service.flat_columns import as_columns as as_columns
    from ahrs_service.links.logs.recording import Recording as Recording
    from ahrs_service.links.logs.recording_formats import read_recording as read_recording
    from ahrs_service.sensor.parameters import Calibration as Calibration
    from ahrs_service.settings import Settings as Settings

__version__: str

_PLACES: Final = {
    "AhrsError": "ahrs_service.errors:AhrsError",
    "Attitude": "ahrs_service.app.estimate.arrays:Attitude",
    "Calibration": "ahrs_service.sensor.parameters:Calibration",
    "Estimator": "ahrs_service.estimator:Estimator",
    "Recording": "ahrs_service.links.logs.recording:Recording",
    "Settings": "ahrs_service.settings:Settings",
    "as_columns": "ahrs_service.flat_columns:as_columns",
    "diagnose": "ahrs_service.app.diagnose.recording_diagnosis:diagnose",
    "estimate": "ahrs_service.app.estimate.arrays:estimate",
    "load_calibration": "ahrs_service.app.files.calibration_file:load",
    "load_settings": "ahrs_service.app.files.config_file:load",
    "read_recording": "ahrs_service.links.logs.recording_formats:read_recording",
}
"""Where each name of the front door is defined."""

__all__ = [
    "AhrsError",
    "Attitude",
    "Calibration",
    "Estimator",
    "Recording",
    "Settings",
    "__version__",
    "as_columns",
    "diagnose",
    "estimate",
    "load_calibration",
    "load_settings",
    "read_recording",
]


def __getattr__(name: str) -> Any:
    """Load a name of the front door at its first use."""
    if name == "__version__":
        value: Any = importlib.import_module("importlib.metadata").version("ahrs-service")
    elif name in _PLACES:
        module, _, own = _PLACES[name].partition(":")
        value = getattr(importlib.import_module(module), own)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
