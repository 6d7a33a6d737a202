"""Every error that links raise; the message names the thing, the value and what to do."""


class LinkError(Exception):
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
