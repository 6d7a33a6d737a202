"""Prior of the gyro bias, from a calibration that gives the bias's uncertainty."""

import math
from typing import Final

from ahrs_service.records import Rows
from ahrs_service.sensor.parameters import Calibration

CORRELATION_DEGC: Final = 10.0
"""How far what a calibration leaves of the bias is alike: two segments of 5 degC [degC]."""


def narrow(parameters: Rows, calibration: Calibration) -> Rows:
    """Lower the filter's doubts about the gyro bias to those of the calibration, never raise them.

    Changes and returns `parameters` [1] of the pipeline. What is left over temperature has the RMS
    r of the worst axis and is alike over L = CORRELATION_DEGC, so over a small change d of
    temperature its variance grows by 2 r^2 d / L. The sigma at power-on follows only where the
    calibration also gives how the bias differs from one power-on to the next.
    """
    known = calibration.gyro.uncertainty
    if known.bias_residual is None:
        return parameters
    left = max(known.bias_residual)
    limits = {"compensated_bias_per_rtdegc_rad_s": left * math.sqrt(2.0 / CORRELATION_DEGC)}
    if known.bias_turn_on is not None:
        limits["gyro_bias_sigma_rad_s"] = math.hypot(left, max(known.bias_turn_on))
    for name, limit in limits.items():
        # A sigma of zero would end all learning of the bias.
        if 0.0 < limit < parameters[name][0]:
            parameters[name] = limit
    return parameters
