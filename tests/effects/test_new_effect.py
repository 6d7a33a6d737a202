"""An effect that the package does not have goes the whole way: one class is all it takes.

From a twin into a simulated flight, from that by name into a report, into a twin and into a
calibration that takes it away again.
"""

import json
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.diagnose.loaded_recording import load
from ahrs_service.app.diagnose.recording_diagnosis import compensated
from ahrs_service.app.files import calibration_file, twin_file
from ahrs_service.calibration.folding import fold
from ahrs_service.diagnosis.input.effect_removal import without_effects
from ahrs_service.effects.base import (
    PER_AXIS,
    REFERENCE_DEGC,
    Addition,
    Contribution,
    Effect,
    Parameter,
    polynomial,
)
from ahrs_service.effects.catalogue import EFFECTS, effect_of, forget, register
from ahrs_service.sensor.parameters import Calibration

CUBIC = np.array([6e-7, -4e-7, 5e-7])
FLIGHT = """
[warmth]
ambient_degc = -10.0
heating_k = 75.0
time_constant_s = 50.0
[[phases]]
name = "warm-up"
seconds = 60.0
speed_m_s = 0.0
throttle = 0.1
is_airborne = false
[[phases]]
name = "take-off run"
seconds = 6.0
throttle = 1.0
is_airborne = false
[[phases]]
name = "turn to the right"
seconds = 15.0
roll_deg = 40.0
throttle = 0.75
[[phases]]
name = "turn to the left"
seconds = 15.0
roll_deg = -40.0
throttle = 0.75
is_closing = true
[[phases]]
name = "landing"
seconds = 8.0
speed_m_s = 0.0
throttle = 0.1
is_airborne = false
"""


@dataclass(frozen=True)
class ThermalCubic(Effect):
    """k (T - T0)^3."""

    triads: ClassVar[tuple[str, ...]] = ("gyro", "accel")
    name: ClassVar[str] = "thermal_cubic"
    title: ClassVar[str] = "bias that bends with the temperature"
    equation: ClassVar[str] = "k (T - T0)^3"
    needs: ClassVar[tuple[str, ...]] = ("temperature_degc",)
    excited_by: ClassVar[str] = "a span of temperature of 50 degC or more"
    taken_for: ClassVar[tuple[str, ...]] = ("thermal_bias",)
    separated_by: ClassVar[str] = "heat from -20 to 70 degC at rest"

    @property
    def parameters(self):
        unit = "rad/s" if self.triad == "gyro" else "m/s^2"
        return (
            Parameter("cubic", f"{unit}/degC^3", PER_AXIS, 1e-6, "made up", step=1.0),
            Parameter("reference_degC", "degC", (), 85.0, "made up", default=REFERENCE_DEGC),
        )

    def add(self, columns, values):
        above = (columns.temperature_degc - values["reference_degC"])[:, None]
        return self.on_triad(values["cubic"] * above**3)

    def in_calibration(self, values):
        none = np.zeros(3)
        return Contribution(bias=polynomial(values["reference_degC"], none, none, values["cubic"]))


@dataclass(frozen=True)
class ThrottlePush(Effect):
    """A minimal effect: it can be simulated, and not be compensated live."""

    triads: ClassVar[tuple[str, ...]] = ("accel",)
    name: ClassVar[str] = "throttle_push"
    title: ClassVar[str] = "push with the throttle"
    equation: ClassVar[str] = "k throttle"
    needs: ClassVar[tuple[str, ...]] = ("throttle",)
    excited_by: ClassVar[str] = "throttle steps"
    separated_by: ClassVar[str] = "throttle steps held down"

    @property
    def parameters(self):
        return (Parameter("k", "m/s^2", PER_AXIS, 1.0, "made up", step=1.0),)

    def add(self, columns, values):
        return Addition(accel=values["k"] * columns.throttle[:, None])


@pytest.fixture(scope="module", autouse=True)
def registered():
    before = tuple(EFFECTS)
    for kind in (ThermalCubic, ThrottlePush):
        assert register(kind) is kind
    yield
    for kind in (ThermalCubic, ThrottlePush):
        forget(kind)
    assert tuple(EFFECTS) == before


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """A flight of a twin with the new effect, its report, the twin and calibration of that."""
    folder = tmp_path_factory.mktemp("new")
    effect = effect_of("gyro_thermal_cubic")
    sensor = folder / "sensor.toml"
    sensor.write_text("[gyro_noise]\ndensity = 1e-4\n[accel_noise]\ndensity = 1e-3\n")
    plain = twin_file.read(sensor)
    twin = twin_file.with_effects(plain, [(effect, effect.checked({"cubic": CUBIC}))])
    twin_file.write(folder / "true.toml", twin, "test")
    (folder / "flight.toml").write_text(FLIGHT)
    flight = folder / "flight.tlog"
    words = ["--script", str(folder / "flight.toml"), "--twin", str(folder / "true.toml")]
    assert main(["simulate", *words, "--rate", "250", "--tlog", str(flight)]) == 0
    files = {"json": "report.json", "write-twin": "twin.toml", "write-calibration": "cal.toml"}
    words = [word for option, name in files.items() for word in (f"--{option}", str(folder / name))]
    said = StringIO()
    with redirect_stdout(said):
        assert main(["diagnose", str(flight), *words]) == 0
    (folder / "said.txt").write_text(" ".join(said.getvalue().split()))
    return folder


def test_it_is_found_by_name_and_measured(diagnosed):
    report = json.loads((diagnosed / "report.json").read_text())
    assert [one["effect"] for one in report["effects"]] == ["gyro_thermal_cubic"]
    (found,) = report["effects"]
    cubic = found["parameters"]["cubic"]
    assert (np.abs(np.array(cubic["value"]) - CUBIC) < 4.0 * np.array(cubic["std"])).all()
    assert np.abs(np.array(cubic["value"]) / CUBIC - 1.0).max() < 0.05
    said = (diagnosed / "said.txt").read_text()
    assert "most on x: bias that bends with the temperature" in said
    assert "Added to the reading: k (T - T0)^3." in said
    assert "The estimator can compensate it live" in said


def test_the_twin_written_holds_it(diagnosed):
    ((effect, values),) = twin_file.read(diagnosed / "twin.toml").effects
    assert effect == ThermalCubic("gyro")
    np.testing.assert_allclose(values["cubic"], CUBIC, rtol=0.05)


def bends(columns):
    """Return how many times (T - T0)^3 the gyro reads at rest, where it should read zero."""
    rest = columns.imu_time_s < columns.imu_time_s[0] + 50.0
    warm = (columns.temperature_degc.at(columns.imu_time_s[rest]) - REFERENCE_DEGC) ** 3
    return [float(np.polyfit(warm, rate, 1)[0]) for rate in columns.gyro_rad_s[rest].T]


def test_the_calibration_written_takes_it_away(diagnosed):
    """After the service's own compensation no dependence on temperature remains."""
    columns = load(diagnosed / "flight.tlog").columns
    np.testing.assert_allclose(bends(columns), CUBIC, rtol=0.02)
    calibration = calibration_file.load(diagnosed / "cal.toml")
    assert np.abs(bends(compensated(columns, calibration))).max() < 1e-8
    known = twin_file.read(diagnosed / "true.toml").effects
    assert np.abs(bends(without_effects(columns, known))).max() < 1e-8


def test_what_it_becomes_in_a_calibration_is_its_own_curve():
    """6e-7 of 30 degC cubed above 25 degC: 0.0162 rad/s."""
    effect = ThermalCubic("gyro")
    folded = fold(Calibration.ideal(), [(effect, effect.checked({"cubic": CUBIC}))])
    assert folded.taken == ("gyro_thermal_cubic",)
    gyro = folded.calibration.gyro
    felt = gyro.c.at([55.0, -5.0])[:, 0] + gyro.bias[0]
    np.testing.assert_allclose(felt, [0.0162, -0.0162], atol=1e-12)


def test_an_effect_that_says_nothing_of_a_calibration_is_left_out_with_a_reason():
    effect = effect_of("accel_throttle_push")
    folded = fold(Calibration.ideal(), [(effect, effect.checked({"k": [0.1, 0.0, 0.0]}))])
    assert folded.calibration == Calibration.ideal()
    assert folded.left == (("accel_throttle_push", effect.why_not_live),)
    assert effect.why_not_live == "the calibration has no term of its form"


def test_a_name_that_is_taken_is_refused():
    class Another(ThermalCubic):
        name: ClassVar[str] = "thermal_bias"

    with pytest.raises(ValueError, match="gyro_thermal_bias is a ThermalBias"):
        register(Another)
    assert effect_of("gyro_thermal_bias").title == "bias that follows the temperature"


def test_an_effect_that_does_not_say_what_it_must_is_refused():
    class Mute(Effect):
        name: ClassVar[str] = "mute"
        triads: ClassVar[tuple[str, ...]] = ("gyro",)

    with pytest.raises(ValueError, match="Mute has no title, equation, excited_by, separated_by"):
        register(Mute)
    assert "gyro_mute" not in EFFECTS


def test_a_new_file_beside_the_others_is_found(tmp_path, monkeypatch):
    """Nothing else names it: the folder of the package is looked through."""
    from ahrs_service import effects
    from ahrs_service.effects import catalogue

    source = Path(effects.__path__[0], "thermal_rate.py").read_text()
    changed = source.replace('"thermal_rate"', '"thermal_rush"').replace("ThermalRate", "Rush")
    (tmp_path / "thermal_rush.py").write_text(changed)
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    names = [kind.name for kind in catalogue._kinds()]
    assert names[-1] == "thermal_rush"
    assert len(names) == len({effect.name for effect in EFFECTS.values()} - {"thermal_cubic"})
