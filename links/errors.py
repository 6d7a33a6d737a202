"""The errors that links raise, of the tree in `ahrs_service.errors`."""

from ahrs_service.errors import (
    LinkError,
    LinkOpenError,
    ParamError,
    ParamFileError,
    RecordingError,
    SigningError,
    UriError,
)

__all__ = [
    "LinkError",
    "LinkOpenError",
    "ParamError",
    "ParamFileError",
    "RecordingError",
    "SigningError",
    "UriError",
]
