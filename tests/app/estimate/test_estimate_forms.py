"""The same speeds in other forms, and data that looks like other units."""

import numpy as np
import pytest

from ahrs_service.app.cli import main
from tests.app.estimate.conftest import angle_deg

SLOW_ROWS = 20
"""At 100 Hz, with speeds at 5 Hz."""


@pytest.fixture(scope="module")
def aided(flight):
    """The fields of IN with speeds five times a second, NaN between, and no vertical one."""
    fields, rows = flight
    seldom = np.arange(len(rows)) % SLOW_ROWS != 0
    fields = {
        name: np.array(fields[name]) for name in ("imu_gyr", "imu_acc", "airspeed", "vel_ned")
    }
    fields["vel_ned"][:, 2] = np.nan
    for name in ("airspeed", "vel_ned"):
        fields[name][seldom] = np.nan
    return fields | {"t": np.arange(len(rows)) / 100.0}


def held(values):
    return values[np.arange(len(values)) // SLOW_ROWS * SLOW_ROWS]


@pytest.mark.parametrize(
    "form",
    [
        lambda fields: {name: held(fields[name]) for name in ("airspeed", "vel_ned")},
        lambda fields: {name: np.nan_to_num(fields[name]) for name in ("airspeed", "vel_ned")},
        lambda fields: {"vel_ned": np.nan_to_num(fields["vel_ned"])},
        lambda fields: {"vel_ned": fields["vel_ned"][:, :2]},
    ],
    ids=["held", "0 where there is none", "vertical 0", "two columns"],
)
def test_every_form_of_the_same_speeds_gives_the_same(aided, run, form):
    expected = run(aided, "--profile", "fixed_wing")["quat"]
    assert angle_deg(run(only_imu(aided), "--profile", "fixed_wing")["quat"], expected).max() > 1.0
    answer = run(aided | form(aided), "--profile", "fixed_wing")["quat"]
    # One filter update may use a held airspeed where another used none.
    assert angle_deg(answer, expected).max() < 0.3


def only_imu(fields):
    return {name: fields[name] for name in ("imu_gyr", "imu_acc", "t")}


def test_an_airspeed_that_stands_still_is_no_longer_heard(aided, run):
    stuck = held(aided["airspeed"])
    stuck[3000:] = stuck[3000]
    gone = stuck.copy()
    gone[3301:] = np.nan
    answers = [
        run(only_imu(aided) | {"airspeed": one}, "--profile", "fixed_wing")["quat"]
        for one in (stuck, gone)
    ]
    np.testing.assert_array_equal(*answers)


def test_time_may_begin_anywhere(aided, run):
    """Speeds in the first seconds after 0 are heard as later ones are."""
    expected = run(aided, "--profile", "fixed_wing")["quat"]
    later = run(aided | {"t": aided["t"] + 1e5}, "--profile", "fixed_wing")["quat"]
    assert angle_deg(later, expected).max() < 1e-6


@pytest.mark.parametrize(
    ("fields", "frame", "said"),
    [
        ({"imu_acc": lambda acc: acc / 9.80665}, "frd", ["imu_acc", "median length of 1"]),
        ({"imu_gyr": np.degrees}, "frd", ["imu_gyr", "not deg/s"]),
        ({"imu_mag": lambda mag: mag * 0.01}, "frd", ["imu_mag", "uT"]),
        ({}, "flu", ["upside down", "--frame frd"]),
        ({}, "frd", []),
    ],
)
def test_other_units_and_axes_are_reported(flight, tmp_path, capsys, fields, frame, said):
    given_ = dict(flight[0])
    for name, change in fields.items():
        given_[name] = change(given_[name])
    source = tmp_path / "in.npz"
    np.savez(source, **given_)
    words = ["--in", str(source), "--out", str(tmp_path / "out.npz"), "--frame", frame]
    assert main(["estimate", *words]) == 0
    message = capsys.readouterr().err
    assert message.count("give") == (1 if said else 0)
    for text in said:
        assert text in message
