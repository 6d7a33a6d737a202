"""Which calibration is used: a given file, or the one of this unit from a folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ahrs_service.app.files import calibration_file
from ahrs_service.errors import ConfigError
from ahrs_service.sensor.parameters import Calibration
from ahrs_service.settings import SensorSettings

NONE: Final = "none"
"""Given in place of a file: no calibration, not even that of a recording."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A calibration in use, and where it was found."""

    path: Path
    calibration: Calibration

    def text(self) -> str:
        """Describe which one is used, and for which temperatures it is valid."""
        known = self.calibration
        parts = [f"serial {known.serial or 'not known'}"]
        if known.provenance.date:
            parts.append(f"of {known.provenance.date[:10]}")
        for name, triad in (("gyro", known.gyro), ("accel", known.accel)):
            if triad.span_degc is not None:
                low, high = triad.span_degc
                parts.append(f"{name} {low:.3g} to {high:.3g} degC")
        doubt = "" if known.verdict.usable else "; its verdict says DO NOT USE, forced"
        return f"calibration {self.path}: {', '.join(parts)}{doubt}"


class CalibrationStore:
    """The calibrations that the settings offer.

    The constructor raises ConfigError for a path that cannot be read and, where the settings name a
    file, for a file that is invalid or must not be used. `notes` list which files of a folder were
    skipped, and why.
    """

    def __init__(self, settings: SensorSettings) -> None:
        self._settings = settings
        self.notes: list[str] = []
        self._path = Path(settings.calibration)
        self._choices: list[Choice] = []
        self.is_folder = False
        if settings.calibration in ("", NONE):
            return
        self.is_folder = self._path.is_dir()
        if self.is_folder:
            self._read_folder()
        else:
            self._choices = [self._checked(self._path)]

    def _checked(self, path: Path) -> Choice:
        choice = Choice(path, calibration_file.load(path))
        verdict = choice.calibration.verdict
        if not (verdict.usable or self._settings.force_calibration):
            why = "; ".join(verdict.sentences) or "it gives no reason"
            raise ConfigError(
                f"{path}: its verdict is not to use it: {why}; calibrate again, "
                "or use it anyway with --force-calibration"
            )
        return choice

    def _read_folder(self) -> None:
        for path in sorted(self._path.glob(f"*{calibration_file.SUFFIX}")):
            try:
                self._choices.append(self._checked(path))
            except ConfigError as error:
                self.notes.append(f"skipped: {error}")
        if not self._choices and not self.notes:
            raise ConfigError(
                f"{self._path}: holds no {calibration_file.SUFFIX} file; give a calibration file, "
                "or a folder of them"
            )

    def choose(self, unit: str) -> Choice | None:
        """Return the calibration of `unit` (its number, "" if unknown), None if there is none.

        A file that the settings name is used for any unit. In a folder the unit is known by
        `sensor.unit`, else by the number that the autopilot reports; of several calibrations of one
        unit the newest is used.
        """
        if not self.is_folder:
            return self._choices[0] if self._choices else None
        name = (self._settings.unit or unit).lower()
        same = [
            choice
            for choice in self._choices
            if name and name in (choice.calibration.serial.lower(), choice.calibration.uid.lower())
        ]
        return max(same, key=lambda one: one.calibration.provenance.date, default=None)

    def refusal(self, unit: str) -> str:
        """Explain why a folder has no calibration for `unit`, and what to do."""
        name = self._settings.unit or unit
        wanted = f"unit {name}" if name else "a unit whose number is not known"
        serials = ", ".join(
            sorted(choice.calibration.serial or choice.path.name for choice in self._choices)
        )
        return (
            f"{self._path}: no calibration for {wanted} (it has those of {serials or 'nobody'}); "
            "name the unit by sensor.unit, or the file by --calibration"
        )

    def mismatch(self, unit: str) -> str:
        """Warn if a file named by the settings is of another unit than `unit`; else ""."""
        choice = None if self.is_folder else self.choose(unit)
        if choice is None or not unit or choice.calibration.uid.lower() in ("", unit.lower()):
            return ""
        return (
            f"{choice.path} is the calibration of unit {choice.calibration.uid}, "
            f"but the autopilot is unit {unit}: it may increase the errors"
        )
