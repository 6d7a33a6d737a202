"""Our calibration as PX4's TC_* and CAL_* parameters, and back.

With t = T - TREF, T held within TMIN..TMAX, and in the sensor's axes (before SENS_BOARD_ROT), PX4
computes

    accel = (raw - X0 - X1 t - X2 t^2 - X3 t^3 - OFF) SCALE
    gyro  =  raw - X0 - X1 t - X2 t^2 - X3 t^3 - OFF

X0..X3 of TC_An_* and TC_Gn_*, if TC_A_ENABLE or TC_G_ENABLE is 1 and TC_*n_ID is the sensor's own;
OFF and SCALE of CAL_ACCn_* and CAL_GYROn_*. Releases before 1.11 had CAL_GYROn_*SCALE, too.
Source: src/modules/temperature_compensation/TemperatureCompensation.cpp
(calc_thermal_offsets_3D, set_sensor_id), src/lib/sensor_calibration/Accelerometer.hpp and
Gyroscope.hpp (Correct), Utilities.cpp (names, rotation).
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from ahrs_service.calibration.autopilots import compensation_model as form_of
from ahrs_service.calibration.autopilots.compensation_model import Triad, TriadForm
from ahrs_service.calibration.autopilots.export_plan import Export, Values, number, vector
from ahrs_service.calibration.autopilots.loss import lag_remarks, loss
from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats
from ahrs_service.sensor.parameters import Calibration

IMUS: Final = range(1, 5)  # PX4's MAX_SENSOR_COUNT is 4

_ENABLED: Final = 1  # TC_A_ENABLE, TC_G_ENABLE: 0 off, 1 on
_TC: Final[dict[Triad, str]] = {"accel": "A", "gyro": "G"}
_CAL: Final[dict[Triad, str]] = {"accel": "ACC", "gyro": "GYRO"}


def _tc(triad: Triad, imu: int, what: str) -> str:
    return f"TC_{_TC[triad]}{_index(imu)}_{what}"


def tc_id(triad: Triad, imu: int) -> str:
    """Return the name of the parameter with the id of the n-th thermal calibration's sensor."""
    return _tc(triad, imu, "ID")


def _power(triad: Triad, imu: int, k: int) -> list[str]:
    return [_tc(triad, imu, f"X{k}_{axis}") for axis in range(3)]


def _cal(triad: Triad, imu: int, what: str) -> list[str]:
    return [f"CAL_{_CAL[triad]}{_index(imu)}_{axis}{what}" for axis in "XYZ"]


def _index(imu: int) -> int:
    if imu not in IMUS:
        raise InvalidValueError(f"IMU {imu}: give 1 for PX4's CAL_ACC0, to {IMUS[-1]}")
    return imu - 1


def device_id(triad: Triad, imu: int) -> str:
    """Return the name of the parameter with the id of an IMU's sensor."""
    return f"CAL_{_CAL[triad]}{_index(imu)}_ID"


def enable(triad: Triad) -> str:
    """Return the name of the switch of thermal compensation, one for all IMUs."""
    return f"TC_{_TC[triad]}_ENABLE"


def to_px4(
    calibration: Calibration,
    imu: int = 1,
    body_from_sensor: Floats | None = None,
    below: Mapping[Triad, TriadForm] | None = None,
    device_ids: Mapping[Triad, int] | None = None,
    reference_degc: float | None = None,
    works_at: tuple[float, float] | None = None,
) -> Export:
    """Return the parameters of one IMU (1 is PX4's 0) nearest to `calibration`, and their loss.

    `body_from_sensor` [3, 3] by SENS_BOARD_ROT; `below` what the autopilot had done to the output
    before the calibration was made from it (`forms_of_px4`); `device_ids` of the sensors, without
    which PX4 does not know whose TC_* they are; TREF is `reference_degc`, room temperature unless
    given, and X0 is 0 there; `works_at` as autopilot_form.fit takes it. A triad that the
    calibration says nothing of is left out.
    """
    turn = np.eye(3) if body_from_sensor is None else body_from_sensor
    reference = number(calibration.room_degc if reference_degc is None else reference_degc)
    values: Values = {}
    losses = {}
    remarks = ["PX4 goes on adapting CAL_*OFF after flights unless SENS_IMU_AUTOCAL is 0"]
    for triad in _TC:
        if form_of.says_nothing(calibration, triad, below or {}):
            remarks.append(f"the calibration says nothing of the {triad}: it is left as it is")
            continue
        under = (below or {}).get(triad)
        own = getattr(calibration, triad).span_degc
        span = form_of.joint_span(own, under.span_degc if under else None)
        bench = form_of.bench(calibration, triad, turn, under, span)
        fitted = form_of.fit(bench, reference, works_at)
        values |= _triad_values(triad, imu, fitted, (device_ids or {}).get(triad))
        losses[triad] = loss(bench, _form(values, triad, imu, None if span is None else imu))
        remarks += _remarks(triad, imu, span is not None, triad in (device_ids or {}))
    switches = tuple(name for name in map(enable, _TC) if name in values)
    lag = lag_remarks(calibration)
    return Export(values, losses, switches, (*remarks, *lag))


def _triad_values(triad: Triad, imu: int, fitted: TriadForm, device: int | None) -> Values:
    values: Values = dict(zip(_cal(triad, imu, "OFF"), map(number, fitted.powers[0]), strict=True))
    if triad == "accel":
        values |= dict(zip(_cal(triad, imu, "SCALE"), map(number, fitted.scale), strict=True))
    if fitted.span_degc is None:
        return {tc_id(triad, imu): 0, **values}
    if device is not None:
        values[tc_id(triad, imu)] = device
    low, high = fitted.span_degc
    values[_tc(triad, imu, "TMIN")] = number(low)
    values[_tc(triad, imu, "TMAX")] = number(high)
    values[_tc(triad, imu, "TREF")] = number(fitted.reference_degc)
    for k, powers in enumerate(fitted.powers):
        # PX4's own calibration leaves the offset at TREF to CAL_*, too.
        row = powers if k else np.zeros(3)
        values |= dict(zip(_power(triad, imu, k), map(number, row), strict=True))
    values[enable(triad)] = _ENABLED
    return values


def _remarks(triad: Triad, imu: int, thermal: bool, known: bool) -> list[str]:
    name = tc_id(triad, imu)
    if not thermal:
        return [
            f"the {triad} calibration has no thermal part: {name} is set to 0, for the offsets "
            "hold without PX4's"
        ]
    if not known:
        return [
            f"{name} is left out: set it to {device_id(triad, imu)} of the autopilot, for PX4 "
            "compensates only the sensor of that id"
        ]
    return []


def thermal_slot(parameters: Mapping[str, float], triad: Triad, imu: int = 1) -> int | None:
    """Return which TC_* (1 is PX4's 0) compensates this sensor: the first of its id, if any."""
    own = parameters.get(device_id(triad, imu), 0)
    if parameters.get(enable(triad), 0) != _ENABLED or not own:
        return None
    return next((n for n in IMUS if parameters.get(tc_id(triad, n)) == own), None)


def known_ids(parameters: Mapping[str, float], imu: int = 1) -> dict[Triad, int]:
    """Return the ids of an IMU's sensors, as far as the parameters give them."""
    ids = {triad: int(parameters.get(device_id(triad, imu), 0)) for triad in _TC}
    return {triad: number for triad, number in ids.items() if number}


def all_names(imu: int) -> list[str]:
    """Return the names of all that calibrates an IMU, and of the board's rotation."""
    names = ["SENS_BOARD_ROT", *(f"SENS_BOARD_{axis}_OFF" for axis in "XYZ")]
    names.append(f"CAL_ACC{_index(imu)}_ROT")
    for triad in _TC:
        names += [enable(triad), device_id(triad, imu), *_cal(triad, imu, "OFF")]
        names += [tc_id(triad, n) for n in IMUS[:-1]]
        names += [_tc(triad, imu, what) for what in ("TMIN", "TMAX", "TREF")]
        names += [name for k in range(4) for name in _power(triad, imu, k)]
    return [*names, *_cal("accel", imu, "SCALE")]


def check_slots(parameters: Mapping[str, float], imu: int) -> None:
    """Raise ValueError where PX4 would take another TC_* of the same sensor before this one."""
    for triad in _TC:
        slot = thermal_slot(parameters, triad, imu)
        if slot not in (None, imu) and parameters.get(tc_id(triad, imu)):
            raise InvalidValueError(
                f"{tc_id(triad, slot or imu)} is of the same sensor and PX4 takes the first of its "
                "id: set it to 0 on the autopilot"
            )


def forms_of_px4(parameters: Mapping[str, float], imu: int = 1) -> dict[Triad, TriadForm]:
    """Return what PX4 does to each triad's output with these parameters.

    ValueError names a parameter that is missing.
    """
    return {
        triad: _form(parameters, triad, imu, thermal_slot(parameters, triad, imu)) for triad in _TC
    }


def _form(parameters: Mapping[str, float], triad: Triad, imu: int, slot: int | None) -> TriadForm:
    scale = np.ones(3)
    names = _cal(triad, imu, "SCALE")
    if triad == "accel" or names[0] in parameters:
        scale = vector(parameters, names)
    if not scale.all():
        raise InvalidValueError(f"{names[0]} = 0: the sensor was never calibrated")
    powers = np.zeros((4, 3))
    powers[0] = vector(parameters, _cal(triad, imu, "OFF"))
    if slot is None:
        return TriadForm(scale, powers)
    for k in range(4):
        powers[k] += vector(parameters, _power(triad, slot, k))
    names = [_tc(triad, slot, what) for what in ("TMIN", "TMAX", "TREF")]
    low, high, reference = vector(parameters, names).tolist()
    if not low < high:
        raise InvalidValueError(
            f"{names[0]} = {low:g} is not below {names[1]} = {high:g}: the thermal calibration is "
            "damaged"
        )
    return TriadForm(scale, powers, reference, (low, high))


def from_px4(
    parameters: Mapping[str, float], imu: int = 1, body_from_sensor: Floats | None = None
) -> Calibration:
    """Return the calibration, in body axes, that compensates exactly as PX4 does."""
    turn = np.eye(3) if body_from_sensor is None else body_from_sensor
    forms = forms_of_px4(parameters, imu)
    room = Calibration().room_degc
    for form in forms.values():
        if form.span_degc is not None:
            room = min(max(form.reference_degc, form.span_degc[0]), form.span_degc[1])
    return form_of.as_calibration(forms, turn, room)
