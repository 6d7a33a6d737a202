"""The gain of a report's model on new data, relative to the oracle's."""

from typing import Any

import numpy as np

from ahrs_service.blind.making.case import Case
from ahrs_service.blind.making.oracle import share_of_gain
from ahrs_service.blind.making.physics import Signals
from ahrs_service.blind.making.surroundings import POWER_ON_S
from ahrs_service.effects.base import Columns, Effect, Values, apply
from ahrs_service.effects.catalogue import EFFECTS


def gain_share(case: Case, report: dict[str, Any]) -> float:
    """Return the gain of the report's effects on new data of the same kind.

    As a share of the oracle's: 1 for the truth, 0 for no effect, negative where it does harm.
    """
    return share_of_gain(modelled(case, report), case.hidden, case.law, case.scene.rate_hz)


def modelled(case: Case, report: dict[str, Any]) -> Signals:
    """Return what the report's effects add to gyro and accelerometer [N, 3] in the true scene."""
    columns = _columns(case)
    effects: list[tuple[Effect, Values]] = []
    for finding in report["effects"]:
        effect = EFFECTS.get(finding["effect"])
        if effect is not None and finding["parameters"]:
            values = {name: p["value"] for name, p in finding["parameters"].items()}
            effects.append((effect, effect.checked(values)))
    gyro, accel = apply(columns, effects)
    return gyro - columns.rate_rad_s, accel - columns.force_m_s2


def _columns(case: Case) -> Columns:
    scene, around = case.scene, case.scene.around
    return Columns(
        time_s=scene.time_s,
        since_power_on_s=scene.time_s + POWER_ON_S,
        rate_rad_s=scene.motion.rate_rad_s,
        force_m_s2=scene.motion.force_m_s2,
        angular_acceleration_rad_s2=np.gradient(scene.motion.rate_rad_s, scene.time_s, axis=0),
        temperature_degc=around.imu_degc,
        temperature_slope_degc_s=around.imu_degc_s,
        vibration_m_s2=around.vibration_m_s2,
        current_a=around.current_a,
        throttle=around.throttle,
        airspeed_m_s=around.airspeed_m_s,
        ned_from_body=scene.motion.ned_from_body,
    )
