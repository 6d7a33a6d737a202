"""From calibrations to the parameters of an autopilot, as options and what is known of it say."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from ahrs_service.app.calibrate import parameter_change
from ahrs_service.calibration.autopilots import ardupilot_params, px4_params
from ahrs_service.calibration.autopilots.board_rotation import board_rotation, body_from_sensor
from ahrs_service.calibration.autopilots.double_compensation import forms_in_force
from ahrs_service.calibration.autopilots.export_plan import Export
from ahrs_service.errors import ConfigError, ParamError
from ahrs_service.links.logs.param_files import INT32, REAL32, ParamValue, read_param_file
from ahrs_service.links.logs.parameter_values import PX4
from ahrs_service.links.logs.recording_formats import READERS, read_recorded_parameters
from ahrs_service.records import Floats
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.settings import IntakeSettings

_CALIBRATING: Final = ("INS_ACC", "INS_GYR", "INS_TCAL", "CAL_ACC", "CAL_GYRO", "TC_")


def parameters_of(path: Path, say: Callable[[str], None], system: int = 0) -> dict[str, float]:
    """Return the parameters in a .param file or a recording; `say` receives oddities.

    Of a recording those of the first autopilot heard, or of that of `system`.
    """
    if path.suffix.lower() not in READERS:
        return parameter_change.values_of(read_param_file(path))
    recorded = read_recorded_parameters(path, IntakeSettings(system=system))
    if not recorded.values:
        raise ParamError(f"{path}: carries no parameters; give the autopilot's .param file")
    for note in recorded.notes:
        say(f"{path.name}: {note}")
    if changed := [name for name in recorded.changed if name.startswith(_CALIBRATING)]:
        say(f"{path.name}: {', '.join(changed)} changed in it; the last values are taken")
    return recorded.values


def rotation_of(orientation: int | None, parameters: Mapping[str, float], imu: int) -> Floats:
    """Return body_from_sensor [3, 3] of an IMU by option, else by the autopilot's parameters."""
    try:
        if orientation is not None:
            return body_from_sensor(orientation)
        return board_rotation(parameters, imu)
    except ValueError as error:
        raise ConfigError(f"--orientation: {error}") from None


def exports_of(
    args: argparse.Namespace,
    calibrations: Mapping[int, Calibration],
    autopilot: int,
    current: Mapping[str, float],
    say: Callable[[str], None],
) -> dict[int, Export]:
    """Return the parameters of each IMU; `current` those of the autopilot, as far as known."""
    under = (
        {} if args.compensated_by is None else parameters_of(args.compensated_by, say, args.system)
    )
    known = {**under, **current}
    at = (args.offsets_at, None if args.works_at is None else tuple(args.works_at))
    exports = {}
    for imu, calibration in calibrations.items():
        turn = rotation_of(args.orientation, known, imu)
        try:
            below = forms_in_force(under, imu) if under else None
            if autopilot == PX4:
                ids = px4_params.known_ids(known, imu)
                export = px4_params.to_px4(calibration, imu, turn, below, ids, *at)
                px4_params.check_slots({**current, **export.values}, imu)
            else:
                export = ardupilot_params.to_ardupilot(calibration, imu, turn, below, *at)
        except ValueError as error:
            raise ParamError(f"IMU {imu}: {error}") from None
        exports[imu] = export
    return exports


def typed(value: float | int) -> ParamValue:
    """Return a parameter as a file holds it."""
    return ParamValue(float(value), INT32 if isinstance(value, int) else REAL32)
