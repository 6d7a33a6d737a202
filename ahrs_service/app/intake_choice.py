"""Which vehicle and which IMU of a recording to use, for every command that reads one.

The options come first; then, in a recording of this service, the settings of its session; then the
first autopilot heard and its best IMU message.
"""

import argparse
import contextlib
import dataclasses

from ahrs_service import intake
from ahrs_service.adoption import NO_VEHICLE, Vehicle, first_vehicle
from ahrs_service.app import options
from ahrs_service.app.files import config_file
from ahrs_service.chosen_imu import ChosenImu, choose_imu
from ahrs_service.errors import ConfigError, RecordingError, StateError
from ahrs_service.estimator import Estimator
from ahrs_service.links.logs.recording import Recording
from ahrs_service.links.logs.session_marks import MarkKind
from ahrs_service.records import ImuSource
from ahrs_service.settings import IntakeSettings, Settings

_OPTIONS = {
    "system": "system",
    "component": "component",
    "imu": "imu_source",
    "temperature": "temperature_source",
}
"""Each option and its setting of the intake."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose vehicle and IMU."""
    parser.add_argument(
        "--system",
        type=_number,
        metavar="N",
        help="system number of the vehicle (default: that of the first autopilot heard)",
    )
    parser.add_argument(
        "--component", type=_number, metavar="N", help="component number of its autopilot"
    )
    parser.add_argument(
        "--imu",
        metavar="MESSAGE",
        help="the IMU message: auto, or " + ", ".join(s.name for s in ImuSource if s),
    )
    parser.add_argument(
        "--temperature",
        choices=("imu", "highres_imu"),
        help="source of the temperature: the IMU's own, or HIGHRES_IMU's field (some recordings)",
    )


def asked_intake(arguments: argparse.Namespace) -> IntakeSettings | None:
    """Return the intake's settings that the arguments select, None where they select none."""
    given = {
        setting: value
        for option, setting in _OPTIONS.items()
        if (value := getattr(arguments, option, None)) is not None
    }
    has_settings = hasattr(arguments, "overrides") and options.has_settings(arguments)
    if not given and not has_settings:
        return None
    below = options.settings_of(arguments).intake if has_settings else IntakeSettings()
    settings = dataclasses.replace(below, **given)
    try:
        intake.parameters(settings)
    except ValueError as error:
        text = str(error).replace("intake.imu_source =", "--imu")
        raise ConfigError(text) from None
    return settings


def recorded_settings(recording: Recording, advice: str) -> Settings | None:
    """Return the settings that a recording of this service begins with; None for others.

    RecordingError ends with `advice` where they cannot be used.
    """
    for mark in recording.marks:
        if mark.kind == MarkKind.SETTINGS and mark.reading == 0:
            try:
                return config_file.from_json(mark.data, str(recording.path))
            except ConfigError as error:
                raise RecordingError(
                    f"the settings recorded cannot be used here ({error}); {advice}"
                ) from None
    return None


def intake_of(
    recording: Recording, asked: IntakeSettings | None, advice: str = "give --system or --imu"
) -> IntakeSettings:
    """Return the intake's settings for a recording, with the vehicle that it adopts."""
    vehicle, settings = NO_VEHICLE, asked
    if settings is None:
        found = recorded_settings(recording, advice)
        settings = IntakeSettings() if found is None else found.intake
        vehicle = _vehicle_kept(recording)
    if vehicle == NO_VEHICLE:
        vehicle = first_vehicle(recording.readings, settings)
    if vehicle == NO_VEHICLE:
        return settings
    return dataclasses.replace(settings, system=vehicle[0], component=vehicle[1])


def _vehicle_kept(recording: Recording) -> Vehicle:
    """Return the vehicle of the session that a recording continues, after a file rotation."""
    for mark in recording.marks:
        if mark.kind == MarkKind.STATE and mark.reading == 0:
            estimator = Estimator(Settings())
            # The replay refuses a state of another version; here it identifies no vehicle.
            with contextlib.suppress(StateError):
                estimator.restore(mark.data)
                state = estimator.intake_state[0]
                return int(state["system"]), int(state["component"])
    return NO_VEHICLE


def chosen_imu(recording: Recording, settings: IntakeSettings) -> ChosenImu:
    """Return the selected samples; RecordingError where no reading becomes one."""
    chosen = choose_imu(recording.readings, settings)
    if not len(chosen.samples):
        raise RecordingError(
            f"{recording.path}: none of its {len(recording.readings)} readings belongs to an IMU "
            f"of the vehicle looked for (--system {settings.system}, --component "
            f"{settings.component}, --imu {settings.imu_source}) after its HEARTBEAT; give others"
        )
    return chosen


def _number(text: str) -> int:
    if not (text.isdecimal() and int(text) <= 255):
        raise argparse.ArgumentTypeError(f"{text} is not a number from 0 to 255")
    return int(text)
