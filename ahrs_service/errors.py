"""Every error of the service; the message names the thing, the value and what to do.

    AhrsError
    ├── ConfigError              a setting, calibration or twin that cannot be used
    ├── InvalidValueError        a value or array that an argument cannot take (also a ValueError)
    ├── StateError               saved state of another version (also a ValueError)
    ├── CalibrationError         data that cannot be calibrated from (also a ValueError)
    ├── DiagnosisError           data that cannot be diagnosed (also a ValueError)
    ├── ViewerError              a viewer that cannot be opened
    └── LinkError                what links raise
        ├── UriError             a link URI that cannot be understood
        ├── LinkOpenError        a link that cannot be opened
        ├── RecordingError       a recording that cannot be read or written
        ├── ParamFileError       a file of parameters
        ├── ParamError           a conversation about an autopilot's parameters
        └── SigningError         a signing key

One `except AhrsError` catches whatever is wrong with what was given; all else is a fault of ours.
The command `ahrs-service` prints `headline` and the message and returns `exit_code`: 1 failed, 2
wrong usage or settings.
"""

from typing import ClassVar


class AhrsError(Exception):
    """Base of all errors of the service.

    >>> from ahrs_service import AhrsError, read_recording
    >>> try:
    ...     read_recording("missing.tlog")
    ... except AhrsError as error:
    ...     print(error)
    missing.tlog: no such file; check the path
    """

    exit_code: ClassVar[int] = 1
    headline: ClassVar[str] = "error"


class ConfigError(AhrsError):
    """A setting that cannot be used; the message names the file, the field and the value."""

    exit_code: ClassVar[int] = 2


class InvalidValueError(AhrsError, ValueError):
    """A value that an argument cannot take, or arrays that do not go together."""

    exit_code: ClassVar[int] = 2


class StateError(AhrsError, ValueError):
    """Saved state bytes that this version cannot take, or that are damaged."""


class CalibrationError(AhrsError, ValueError):
    """The data cannot be calibrated from; the text says in a sentence why and what to do."""

    headline: ClassVar[str] = "refused"


class DiagnosisError(AhrsError, ValueError):
    """The data cannot be diagnosed; the text says in a sentence what is missing."""


class ViewerError(AhrsError):
    """A viewer that cannot be opened or fed."""


class LinkError(AhrsError):
    """Base of all errors of links."""


class UriError(LinkError):
    """A link URI that cannot be understood."""


class LinkOpenError(LinkError):
    """A link that cannot be opened, and trying again will not help."""


class RecordingError(LinkError):
    """A recording that cannot be read, or holds no IMU."""


class ParamFileError(LinkError):
    """A file of parameters that cannot be read or written."""


class ParamError(LinkError):
    """A conversation about an autopilot's parameters that failed."""


class SigningError(LinkError):
    """A signing key that cannot be used."""
