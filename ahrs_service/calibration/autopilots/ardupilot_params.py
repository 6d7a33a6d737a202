"""Our calibration as ArduPilot's INS_* parameters, and back.

With t = T - 35 degC, T and INS_ACCn_CALTEMP held within INS_TCALn_TMIN..TMAX, and in the sensor's
axes (before AHRS_ORIENTATION), ArduPilot computes

    accel = (raw - P(t) + P(CALTEMP - 35) - INS_ACCnOFFS) INS_ACCnSCAL
    gyro  =  raw - P(t) + P(CALTEMP - 35) - INS_GYRnOFFS
    P(t)  = 1e-6 (c1 t + c2 t^2 + c3 t^3)            c1..c3 = INS_TCALn_ACC1..3 and GYR1..3

if INS_TCALn_ENABLE is 1, else without P. Source: libraries/AP_InertialSensor:
AP_InertialSensor_tempcal.cpp (polynomial_eval, correct_sensor), AP_InertialSensor_Backend.cpp
(_rotate_and_correct_accel and _gyro), AP_InertialSensor.cpp and _Params.cpp (names, ranges).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from ahrs_service.calibration.autopilots import compensation_model as form_of
from ahrs_service.calibration.autopilots.compensation_model import Triad, TriadForm
from ahrs_service.calibration.autopilots.export_plan import Export, Values, number, vector
from ahrs_service.calibration.autopilots.loss import lag_remarks, loss
from ahrs_service.errors import InvalidValueError
from ahrs_service.records import Floats
from ahrs_service.sensor.parameters import Calibration

REFERENCE_DEGC: Final = 35.0  # ArduPilot's TEMP_REFERENCE [degC]
SCALE_FACTOR: Final = 1e6  # ArduPilot's SCALE_FACTOR: parameters are in millionths
LEAST_SPAN_DEGC: Final = 10.0
"""ArduPilot's TEMP_RANGE_MIN [degC]: it learns no calibration over less."""
LARGEST_OFFSET_M_S2: Final = 3.5  # Range of INS_ACCOFFS_* in ArduPilot's parameter list [m/s^2]
SCALES: Final = (0.8, 1.2)  # Range of INS_ACCSCAL_* in ArduPilot's parameter list
IMUS: Final = range(1, 6)  # ArduPilot's INS_MAX_INSTANCES is 5

_AXES: Final = "XYZ"
_POWERS: Final = (1, 2, 3)  # P(t) is a cubic without a constant
_ENABLED: Final = 1  # INS_TCALn_ENABLE: 0 off, 1 on, 2 learns
_LETTERS: Final[dict[Triad, str]] = {"accel": "ACC", "gyro": "GYR"}


@dataclass(frozen=True, slots=True)
class Names:
    """Names of the parameters of one IMU, counted from 1; those beyond the third are grouped."""

    imu: int

    def __post_init__(self) -> None:
        """Raise ValueError for an IMU that ArduPilot cannot have."""
        if self.imu not in IMUS:
            raise InvalidValueError(
                f"IMU {self.imu}: ArduPilot counts its IMUs from 1 to {IMUS[-1]}"
            )

    def vector(self, triad: Triad, what: str) -> list[str]:
        """Return the names of SCAL or OFFS of x, y, z."""
        letters = _LETTERS[triad]
        if self.imu > 3:
            return [f"INS{self.imu}_{letters}{what}_{axis}" for axis in _AXES]
        count = "" if self.imu == 1 else str(self.imu)
        return [f"INS_{letters}{count}{what}_{axis}" for axis in _AXES]

    def caltemp(self, triad: Triad) -> str:
        """Return the name of the temperature at which the offsets hold."""
        letters = _LETTERS[triad]
        if self.imu > 3:
            return f"INS{self.imu}_{letters}_CALTEMP"
        return f"INS_{letters}{self.imu}_CALTEMP"

    def tcal(self, what: str) -> str:
        """Return the name of one of the thermal calibration."""
        return f"INS{self.imu}_TCAL_{what}" if self.imu > 3 else f"INS_TCAL{self.imu}_{what}"

    def power(self, triad: Triad, k: int) -> list[str]:
        """Return the names of the coefficients of t^k of x, y, z."""
        return [self.tcal(f"{_LETTERS[triad]}{k}_{axis}") for axis in _AXES]


def to_ardupilot(
    calibration: Calibration,
    imu: int = 1,
    body_from_sensor: Floats | None = None,
    below: Mapping[Triad, TriadForm] | None = None,
    caltemp_degc: float | None = None,
    works_at: tuple[float, float] | None = None,
) -> Export:
    """Return the parameters of one IMU nearest to `calibration`, and what they lose.

    `body_from_sensor` [3, 3] by AHRS_ORIENTATION; `below` what the autopilot had done to the output
    before the calibration was made from it (`forms_of_ardupilot`); the offsets are those at
    `caltemp_degc`, room temperature unless given; `works_at` as autopilot_form.fit takes it. Of a
    triad that the calibration says nothing of there are no offsets and scales.
    ValueError where ArduPilot cannot hold it: a span below 10 degC, offsets or scales out of range.
    """
    names, turn = Names(imu), np.eye(3) if body_from_sensor is None else body_from_sensor
    below = below or {}
    span = form_of.joint_span(
        calibration.gyro.span_degc,
        calibration.accel.span_degc,
        *(form.span_degc for form in below.values()),
    )
    _check_span(span)
    room = calibration.room_degc if caltemp_degc is None else caltemp_degc
    values: Values = {}
    losses, remarks = {}, list(_remarks(names, calibration, span))
    for triad in _LETTERS:
        if form_of.says_nothing(calibration, triad, below):
            values |= _no_drift(names, triad) if span is not None else {}
            remarks.append(f"the calibration says nothing of the {triad}: offsets stay as they are")
            continue
        bench = form_of.bench(calibration, triad, turn, below.get(triad), span)
        values |= _triad_values(names, triad, form_of.fit(bench, REFERENCE_DEGC, works_at), room)
        losses[triad] = loss(bench, _form(values, names, triad, span is not None))
        if triad == "accel":
            remarks += _check_accel(values, names)
    values[names.tcal("ENABLE")] = 0 if span is None else _ENABLED
    return Export(values, losses, (names.tcal("ENABLE"),), tuple(remarks))


def _no_drift(names: Names, triad: Triad) -> Values:
    return {name: 0.0 for k in _POWERS for name in names.power(triad, k)}


def _check_span(span: tuple[float, float] | None) -> None:
    if span is not None and span[1] - span[0] < LEAST_SPAN_DEGC:
        raise InvalidValueError(
            f"the calibration spans {span[0]:.1f}..{span[1]:.1f} degC and ArduPilot wants "
            f"{LEAST_SPAN_DEGC:.0f} degC at least: calibrate over more"
        )


def _triad_values(names: Names, triad: Triad, fitted: TriadForm, room_degc: float) -> Values:
    """Return the parameters of a fitted form; the offset takes up what rounding P moves."""
    values: Values = {}
    bias = fitted.powers[0].copy()
    if fitted.span_degc is not None:
        low, high = (number(t) for t in fitted.span_degc)
        caltemp = number(min(max(room_degc, low), high))
        values |= {names.tcal("TMIN"): low, names.tcal("TMAX"): high}
        values[names.caltemp(triad)] = caltemp
        for k in _POWERS:
            rounded = [number(c * SCALE_FACTOR) for c in fitted.powers[k]]
            values |= dict(zip(names.power(triad, k), rounded, strict=True))
            bias += np.array(rounded) / SCALE_FACTOR * (caltemp - REFERENCE_DEGC) ** k
    values |= dict(zip(names.vector(triad, "OFFS"), map(number, bias), strict=True))
    if triad == "accel":
        values |= dict(zip(names.vector(triad, "SCAL"), map(number, fitted.scale), strict=True))
    return values


def _check_accel(values: Values, names: Names) -> list[str]:
    """Raise ValueError for what ArduPilot does not take, and remark on what it misunderstands."""
    offset = vector(values, names.vector("accel", "OFFS"))
    scale = vector(values, names.vector("accel", "SCAL"))
    if np.abs(offset).max() > LARGEST_OFFSET_M_S2:
        raise InvalidValueError(
            f"accelerometer offsets {(np.round(offset, 3) + 0.0).tolist()} m/s^2: ArduPilot takes "
            f"at most {LARGEST_OFFSET_M_S2}; was the calibration made in m/s^2?"
        )
    if scale.min() < SCALES[0] or scale.max() > SCALES[1]:
        raise InvalidValueError(
            f"accelerometer scales {np.round(scale, 4).tolist()}: ArduPilot takes {SCALES[0]} to "
            f"{SCALES[1]}; was the calibration made in m/s^2?"
        )
    if not offset.any():
        return ["ArduPilot takes offsets of exactly 0 for an accelerometer never calibrated"]
    return []


def _remarks(
    names: Names, calibration: Calibration, span: tuple[float, float] | None
) -> tuple[str, ...]:
    remarks = [
        "ArduPilot measures INS_GYR*OFFS anew at every start unless INS_GYR_CAL is 0; with the "
        "thermal calibration on, what it finds holds at all temperatures"
    ]
    if span is None:
        remarks.append(
            f"the calibration has no thermal part: {names.tcal('ENABLE')} is set to 0, for the "
            "offsets hold without ArduPilot's"
        )
    return (*remarks, *lag_remarks(calibration))


def all_names(imu: int) -> list[str]:
    """Return the names of all that calibrates an IMU, and of the board's rotation."""
    names = Names(imu)
    wanted = ["AHRS_ORIENTATION", *map(names.tcal, ("ENABLE", "TMIN", "TMAX"))]
    for triad in _LETTERS:
        wanted += [*names.vector(triad, "OFFS"), names.caltemp(triad)]
        wanted += [name for k in _POWERS for name in names.power(triad, k)]
    return [*wanted, *names.vector("accel", "SCAL")]


def is_thermal(parameters: Mapping[str, float], imu: int = 1) -> bool:
    """Return whether ArduPilot compensates temperature with these parameters; 2 is learning."""
    return parameters.get(Names(imu).tcal("ENABLE"), 0) == _ENABLED


def forms_of_ardupilot(parameters: Mapping[str, float], imu: int = 1) -> dict[Triad, TriadForm]:
    """Return what ArduPilot does to each triad's output with these parameters.

    ValueError names a parameter that is missing, or reports that there is no such IMU.
    """
    names = Names(imu)
    thermal = is_thermal(parameters, imu)
    return {triad: _form(parameters, names, triad, thermal) for triad in _LETTERS}


def _form(parameters: Mapping[str, float], names: Names, triad: Triad, thermal: bool) -> TriadForm:
    scale = np.ones(3)
    if triad == "accel":
        scale = vector(parameters, names.vector(triad, "SCAL"))
        if not scale.all():
            raise InvalidValueError(
                f"{names.vector(triad, 'SCAL')[0]} = 0: the autopilot has no IMU {names.imu}, or "
                "it was never calibrated"
            )
    powers = np.zeros((4, 3))
    powers[0] = vector(parameters, names.vector(triad, "OFFS"))
    if not thermal:
        return TriadForm(scale, powers)
    for k in _POWERS:
        powers[k] = vector(parameters, names.power(triad, k)) / SCALE_FACTOR
    bounds = vector(parameters, [names.tcal("TMIN"), names.tcal("TMAX"), names.caltemp(triad)])
    low, high, caltemp = bounds.tolist()
    if not low < high:
        raise InvalidValueError(
            f"{names.tcal('TMIN')} = {low:g} is not below {names.tcal('TMAX')} = {high:g}: the "
            "thermal calibration is damaged"
        )
    step = min(max(caltemp, low), high) - REFERENCE_DEGC
    for k in _POWERS:
        powers[0] -= powers[k] * step**k
    return TriadForm(scale, powers, REFERENCE_DEGC, (low, high))


def from_ardupilot(
    parameters: Mapping[str, float], imu: int = 1, body_from_sensor: Floats | None = None
) -> Calibration:
    """Return the calibration, in body axes, that compensates exactly as ArduPilot does."""
    turn = np.eye(3) if body_from_sensor is None else body_from_sensor
    forms = forms_of_ardupilot(parameters, imu)
    room = Calibration().room_degc
    if (span := forms["accel"].span_degc) is not None:
        room = min(max(parameters[Names(imu).caltemp("accel")], span[0]), span[1])
    return form_of.as_calibration(forms, turn, room)
