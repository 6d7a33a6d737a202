"""Which vehicle is ours: one rule for live service, intake and every reader of recordings."""

from typing import Final

import numpy as np

from ahrs_service.kernel import kernel
from ahrs_service.records import Kind, Rows
from ahrs_service.settings import IntakeSettings

Vehicle = tuple[int, int]
"""System and component number of an autopilot."""

NO_VEHICLE: Final[Vehicle] = (0, 0)
AUTOPILOT_INVALID: Final = 8
"""MAV_AUTOPILOT_INVALID: what sends this heartbeat is no autopilot (MAVLink common.xml)."""


def may_adopt(
    system: int, component: int, autopilot: int, wanted_system: int, wanted_component: int
) -> bool:
    """Whether a heartbeat comes from a vehicle that may be adopted: the wanted one, an autopilot.

    `autopilot` is HEARTBEAT.autopilot; a wanted number of 0 allows any. System 0 is the address of
    all: what calls itself so can be neither asked nor joined.
    """
    return (
        system != 0
        and autopilot != AUTOPILOT_INVALID
        and (wanted_system == 0 or wanted_system == system)  # noqa: PLR1714 - compiled too
        and (wanted_component == 0 or wanted_component == component)  # noqa: PLR1714
    )


may_adopt_kernel = kernel(may_adopt)
"""`may_adopt` for kernels."""


def first_vehicle(readings: Rows, settings: IntakeSettings) -> Vehicle:
    """Return the vehicle of readings [N] that the intake adopts: the first that may be.

    NO_VEHICLE where none is heard.
    """
    beats = readings[readings["kind"] == Kind.HEARTBEAT]
    columns = np.stack([beats[name] for name in ("system", "component", "autopilot")], axis=1)
    found, first = np.unique(columns, axis=0, return_index=True)
    for system, component, autopilot in found[np.argsort(first)].tolist():
        if may_adopt(system, component, autopilot, settings.system, settings.component):
            return system, component
    return NO_VEHICLE


def of_vehicle(readings: Rows, vehicle: Vehicle) -> Rows:
    """Return those of the readings that a vehicle sent."""
    return readings[(readings["system"] == vehicle[0]) & (readings["component"] == vehicle[1])]
