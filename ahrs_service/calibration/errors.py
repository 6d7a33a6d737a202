"""Why a calibration was not begun or not finished: of the tree in `ahrs_service.errors`."""

from ahrs_service.errors import CalibrationError

__all__ = ["CalibrationError"]
