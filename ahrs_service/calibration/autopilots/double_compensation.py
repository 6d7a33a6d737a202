"""Whether an autopilot had already compensated what it recorded.

Both autopilots send and log an IMU after their own calibration, so a calibration made from that is
one of what theirs left: used where theirs stays as it was it is right; put into the autopilot
it must replace both (`ardupilot_params.to_ardupilot`, `below`). Sources: those of ardupilot_params
and px4_params; PX4 src/modules/mavlink/streams/HIGHRES_IMU.hpp, which takes off the bias that the
estimator (EKF2) has found.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from ahrs_service.calibration.autopilots import ardupilot_params, px4_params
from ahrs_service.calibration.autopilots.compensation_model import Triad, TriadForm
from ahrs_service.errors import InvalidValueError
from ahrs_service.records import IMU_OF_SOURCE, ImuSource

PX4: Final = 12
"""MAV_AUTOPILOT_PX4."""

_HIGHRES: Final = (ImuSource.HIGHRES_IMU, ImuSource.HIGHRES_IMU_1, ImuSource.HIGHRES_IMU_2)
_UNDO: Final = (
    "what is fitted comes on top of it: give the recording to `calibrate export` as "
    "--compensated-by, or record again with {off}"
)


def imu_of(source: ImuSource) -> int:
    """Return which of the autopilot's IMUs a source is, counted from 1."""
    return IMU_OF_SOURCE.get(source, 0) + 1


def forms_in_force(parameters: Mapping[str, float], imu: int = 1) -> dict[Triad, TriadForm]:
    """Return what the autopilot whose parameters these are did to an IMU.

    ValueError where they are neither ArduPilot's nor PX4's, or incomplete.
    """
    if any(name.startswith("INS_ACC") for name in parameters):
        return ardupilot_params.forms_of_ardupilot(parameters, imu)
    if any(name.startswith("CAL_ACC") for name in parameters):
        return px4_params.forms_of_px4(parameters, imu)
    raise InvalidValueError(
        f"none of the {len(parameters)} parameters calibrates an IMU (INS_ACC* of ArduPilot, "
        "CAL_ACC* of PX4): give all of the autopilot's"
    )


def already_compensated(
    parameters: Mapping[str, float], source: ImuSource, autopilot: int = 0
) -> list[str]:
    """Return sentences on what the autopilot had taken off the samples of `source` before.

    `parameters` of the recording, as far as it carries them; `autopilot` MAV_AUTOPILOT, where it is
    known. Each sentence gives what was done and what to do; none means that nothing was found,
    which with no parameters at all proves nothing.
    """
    imu = imu_of(source)
    sentences = []
    if autopilot == PX4 and source in _HIGHRES:
        sentences.append(
            "HIGHRES_IMU of PX4: the estimator's own bias is taken off, and changes in flight; "
            "calibrate from SCALED_IMU, or from the ULog"
        )
    if not any(name.startswith(("INS_ACC", "CAL_ACC")) for name in parameters):
        return sentences
    try:
        forms = forms_in_force(parameters, imu)
    except ValueError as error:
        return [*sentences, f"IMU {imu}: what the autopilot did to it is not known: {error}"]
    is_px4 = "CAL_ACC0_ID" in parameters
    for triad in ("accel", "gyro"):
        sentences += _thermal(triad, forms[triad], imu, is_px4)
    sentences += _accel(forms["accel"], imu, is_px4)
    sentences += _gyro(forms["gyro"], imu, is_px4)
    return sentences


def _thermal(triad: Triad, form: TriadForm, imu: int, is_px4: bool) -> list[str]:
    if form.span_degc is None:
        return []
    switch = px4_params.enable(triad) if is_px4 else ardupilot_params.Names(imu).tcal("ENABLE")
    low, high = form.span_degc
    undo = _UNDO.format(off=f"{switch} = 0")
    return [
        f"IMU {imu}, {triad}: {switch} = 1, so the autopilot had compensated temperature over "
        f"{low:.0f}..{high:.0f} degC; {undo}"
    ]


def _accel(form: TriadForm, imu: int, is_px4: bool) -> list[str]:
    offset = form.powers[0] if form.span_degc is None else form.bias(np.array(form.span_degc))
    if not offset.any() and (form.scale == 1.0).all():
        return []
    names = f"CAL_ACC{imu - 1}_*" if is_px4 else f"INS_ACC{'' if imu == 1 else imu}OFFS and SCAL"
    undo = _UNDO.format(off="them at 0 and 1")
    return [
        f"IMU {imu}, accel: offsets up to {np.abs(offset).max():.3f} m/s^2 and scales of "
        f"{form.scale.min():.4f}..{form.scale.max():.4f} had been applied ({names}); {undo}"
    ]


def _gyro(form: TriadForm, imu: int, is_px4: bool) -> list[str]:
    offset = form.powers[0] if form.span_degc is None else form.bias(np.array(form.span_degc))
    if not offset.any():
        return []
    names = f"CAL_GYRO{imu - 1}_*OFF" if is_px4 else f"INS_GYR{'' if imu == 1 else imu}OFFS"
    anew = "" if is_px4 else ", which ArduPilot measures anew at every start unless INS_GYR_CAL = 0"
    return [
        f"IMU {imu}, gyro: offsets up to {np.degrees(np.abs(offset).max()):.2f} deg/s had been "
        f"taken off ({names}{anew}): the bias fitted is what they left; how it changes with "
        "temperature is not touched"
    ]
