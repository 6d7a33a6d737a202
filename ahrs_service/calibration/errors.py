"""Why a calibration was not begun or not finished."""


class CalibrationError(ValueError):
    """The data cannot be calibrated from; the text says in a sentence why and what to do."""
