"""The samples of one vehicle and one IMU message, as the intake chooses them from a recording.

The estimator may change from one message to another while it runs; who looks at a recording as a
whole (diagnosis, calibration, simulation along a recording) wants one sensor throughout: the one
that the intake used most.
"""

from dataclasses import dataclass, replace

import numpy as np

from ahrs_service import intake
from ahrs_service.adoption import Vehicle
from ahrs_service.records import SAMPLE_DTYPE, ImuSource, Integers, Kind, Rows, empty
from ahrs_service.settings import IntakeSettings


@dataclass(frozen=True, slots=True)
class ChosenImu:
    """What the intake chose of a recording.

    `samples` [N] SAMPLE_DTYPE, in the board's axes; `positions` [N] the reading behind each;
    `vehicle` the one adopted, (0, 0) if none was heard; `source` NONE where there is no sample.
    """

    samples: Rows
    positions: Integers
    vehicle: Vehicle
    source: ImuSource


def choose_imu(readings: Rows, settings: IntakeSettings) -> ChosenImu:
    """Choose vehicle and IMU message of readings [N] READING_DTYPE as the estimator does."""
    chosen = _select(readings, settings)
    sources, counts = np.unique(chosen.samples["source"], return_counts=True)
    if len(sources) < 2:
        return chosen
    system, component = chosen.vehicle
    name = ImuSource(int(sources[np.argmax(counts)])).name
    return _select(readings, replace(settings, system=system, component=component, imu_source=name))


def _select(readings: Rows, settings: IntakeSettings) -> ChosenImu:
    count = int(np.count_nonzero(readings["kind"] == Kind.IMU))
    samples, positions = empty(SAMPLE_DTYPE, count), np.zeros(count, np.int64)
    state = intake.new_state()
    written = intake.select(intake.parameters(settings), state, readings, samples, positions)
    samples, positions = samples[:written], positions[:written]
    vehicle = int(state["system"][0]), int(state["component"][0])
    source = ImuSource(int(samples["source"][0])) if written else ImuSource.NONE
    return ChosenImu(samples, positions, vehicle, source)
