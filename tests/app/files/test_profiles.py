"""Profiles: their contents, where they are found, and what overrides them."""

import dataclasses

import numpy as np
import pytest

from ahrs_service.app.cli import main
from ahrs_service.app.files import profiles, toml_file
from ahrs_service.app.files.config_file import from_json, load, to_json
from ahrs_service.app.replay.replay_log import replay_log
from ahrs_service.errors import ConfigError
from ahrs_service.fusion import gating
from ahrs_service.settings import FusionSettings, GateBudget, Settings
from ahrs_service.simulation.scenario import make_flight

NAMES = ["fixed_wing", "ground_test", "hand_held", "multirotor"]
CLASSES = {"ground_test": "other"}


def test_there_is_one_of_each_kind_of_vehicle():
    assert profiles.names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_profile_names_its_class_and_gives_all_its_numbers(name):
    """All of them, for the file to name the source of each."""
    airframe = CLASSES.get(name, name)
    settings = load(profile=name)
    assert settings.fusion.airframe == airframe
    document = toml_file.read(profiles.file_of(name))
    fields = [field.name for field in dataclasses.fields(getattr(settings, airframe))]
    assert set(document[airframe]) == set(fields)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in CLASSES])
def test_the_class_that_a_heartbeat_chooses_has_the_numbers_of_the_profile(name):
    assert getattr(load(profile=name), name) == getattr(Settings(), name)


@pytest.mark.parametrize("name", NAMES)
def test_a_profile_leaves_what_is_not_about_motion_or_its_sensor_to_the_service(name):
    settings, default = load(profile=name), Settings()
    fusion = dataclasses.replace(
        settings.fusion,
        airframe="auto",
        gyro_sample=FusionSettings().gyro_sample,
        gyro_scale_error_rts=FusionSettings().gyro_scale_error_rts,
    )
    airframe = CLASSES.get(name, name)
    changed = {"gate_budget": default.gate_budget, airframe: getattr(default, airframe)}
    assert dataclasses.replace(settings, fusion=fusion, **changed) == default


@pytest.mark.parametrize("name", NAMES)
def test_the_gates_follow_from_the_budget_of_the_profile(name):
    settings = load(profile=name)
    limits, default = gating.limits(settings), Settings().gate
    for field in ("norm_m_s2", "rate_rad_s", "angular_acceleration_rad_s2"):
        assert getattr(limits, field) != getattr(default, field)


def test_the_limits_that_the_files_state_are_those_of_their_budgets():
    stated = {
        "fixed_wing": (0.60, 0.19, 2.2),
        "multirotor": (0.60, 0.24, 4.1),
        "hand_held": (0.13, 0.41, 2.4),
        "ground_test": (2.7, 3.6, 12.9),
    }
    for name, expected in stated.items():
        gate = gating.limits(load(profile=name))
        found = gate.norm_m_s2, gate.rate_rad_s, gate.angular_acceleration_rad_s2
        assert found == pytest.approx(expected, rel=0.02), name
        comment = profiles.file_of(name).read_text().replace("\n# ", " ")
        assert f"{expected[0]:.2f} m/s^2" in comment or f"{expected[0]} m/s^2" in comment
        assert f"{expected[1]} rad/s," in comment
        assert f"{expected[2]} rad/s^2" in comment


def test_only_sensors_that_integrate_are_taken_to_give_means():
    assert {name: load(profile=name).fusion.gyro_sample for name in NAMES} == {
        "fixed_wing": "instant",
        "ground_test": "instant",
        "hand_held": "mean",
        "multirotor": "instant",
    }


def test_profile_then_file_then_command_line(tmp_path):
    path = tmp_path / "flight.toml"
    path.write_text("[fixed_wing]\nclimb_sigma_m_s = 4.5\nforward_speed_m_s = 20\n")
    settings = load(path, ["fixed_wing.forward_speed_m_s=25"], "fixed_wing")
    assert settings.fusion.airframe == "fixed_wing"
    assert settings.fixed_wing == dataclasses.replace(
        Settings().fixed_wing, climb_sigma_m_s=4.5, forward_speed_m_s=25.0
    )
    assert load(None, ["fusion.airframe=other"], "fixed_wing").fusion.airframe == "other"


@pytest.mark.parametrize(
    ("override", "field", "value"),
    [
        ("gate.norm_m_s2=0.4", "norm_m_s2", 0.4),
        ("gate.rate_rad_s=0.4", "rate_rad_s", 0.4),
        ("gate.angular_acceleration_rad_s2=0.4", "angular_acceleration_rad_s2", 0.4),
        ("gate_budget.acceleration_m_s2=1.0", "norm_m_s2", 4.24),
    ],
)
@pytest.mark.parametrize("by_file", [False, True])
def test_a_limit_stated_above_the_profile_replaces_its_budget(
    tmp_path, override, field, value, by_file
):
    lower = gating.limits(load(profile="fixed_wing"))
    if by_file:
        path = tmp_path / "above.toml"
        section, rest = override.split(".", 1)
        path.write_text(f"[{section}]\n{rest}\n")
        settings = load(path, profile="fixed_wing")
    else:
        settings = load(None, [override], "fixed_wing")
    limits = gating.limits(settings)
    assert getattr(limits, field) == pytest.approx(value, rel=0.2)
    assert dataclasses.replace(limits, **{field: getattr(lower, field)}) == lower


def test_a_budget_beside_an_explicit_limit_of_the_same_layer_still_wins():
    settings = load(None, ["gate.norm_m_s2=5", "gate_budget.tilt_deg=10"], "fixed_wing")
    assert settings.gate_budget.tilt_deg == 10.0
    assert gating.limits(settings).norm_m_s2 == pytest.approx(0.751, abs=1e-3)


def test_a_profile_is_a_file_too(tmp_path):
    path = tmp_path / "glider.toml"
    path.write_text('[fusion]\nairframe = "fixed_wing"\n[fixed_wing]\nclimb_sigma_m_s = 1\n')
    settings = load(profile=str(path))
    assert settings.fixed_wing.climb_sigma_m_s == 1.0
    assert settings.gate_budget == GateBudget()


def test_both_spellings_are_one_profile():
    assert load(profile="hand-held") == load(profile="hand_held")


def test_an_unknown_name_lists_those_there_are(tmp_path, capsys):
    with pytest.raises(ConfigError, match="--profile bird: no such profile") as caught:
        load(profile="bird")
    assert all(name in str(caught.value) for name in NAMES)
    words = ["estimate", "--in", "a.npz", "--out", str(tmp_path / "o.npz"), "--profile", "bird"]
    assert main(words) == 2
    assert "fixed_wing, ground_test, hand_held, multirotor" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["", ".", "..", "../fixed_wing", "airframes/fixed_wing", "x y"])
def test_a_name_is_no_path(name):
    with pytest.raises(ConfigError, match="no such profile"):
        load(profile=name)


def test_a_file_that_cannot_be_used_is_named(tmp_path):
    absent, wrong = tmp_path / "absent.toml", tmp_path / "wrong.toml"
    wrong.write_text("[fixed_wing]\nclimb_sigma_m_s = -1\n")
    with pytest.raises(ConfigError, match="give a readable TOML file"):
        load(profile=str(absent))
    other = tmp_path / "other.toml"
    other.write_text("[link]\nimu_rate_hz = 50\n")
    with pytest.raises(ConfigError, match="climb_sigma_m_s") as caught:
        load(other, profile=str(wrong))
    assert str(caught.value).startswith(f"{wrong}: ")


def test_what_the_command_line_got_wrong_is_not_laid_on_the_profile_alone():
    with pytest.raises(ConfigError, match=r"the command line: fusion\.mode = 'best'"):
        load(None, ["fusion.mode=best"], "fixed_wing")


@pytest.mark.parametrize("command", ["run", "replay", "estimate", "demo"])
def test_help_names_the_profiles(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert all(name in text for name in NAMES)


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Half a minute of a flight as IN.npz."""
    rows = make_flight("flight", 30.0, seed=2, rate_hz=100.0).rows
    path = tmp_path_factory.mktemp("given") / "in.npz"
    np.savez(path, imu_gyr=rows["gyro_rad_s"], imu_acc=rows["accel_m_s2"], sampling_rate=100.0)
    return path


def estimated(given, out, *options):
    assert main(["estimate", "--in", str(given), "--out", str(out), *options]) == 0
    with np.load(out) as file:
        return {name: file[name].tobytes() for name in file.files}


@pytest.mark.parametrize("name", NAMES)
def test_estimate_with_a_profile_is_estimate_with_its_settings(given, tmp_path, name):
    document = toml_file.read(profiles.file_of(name))
    overrides = [
        f"--set={section}.{key}={value}"
        for section, part in document.items()
        for key, value in part.items()
    ]
    by_name = estimated(given, tmp_path / "name.npz", "--profile", name)
    assert by_name == estimated(given, tmp_path / "each.npz", *overrides)
    by_file = estimated(given, tmp_path / "f.npz", "--profile", str(profiles.file_of(name)))
    assert by_name == by_file
    other = "hand_held" if name == "ground_test" else "ground_test"
    assert by_name["quat"] != estimated(given, tmp_path / "o.npz", "--profile", other)["quat"]


def test_replay_with_a_profile_holds_it_against_the_recordings_own(tmp_path, capsys):
    flown = tmp_path / "flight.tlog"
    words = ["simulate", "--scenario", "flight", "--seconds", "20", "--tlog", str(flown)]
    assert main(words) == 0
    expected = replay_log(flown, load(profile="multirotor"))
    capsys.readouterr()
    assert main(["replay", str(flown), "--profile", "multirotor"]) == 0
    said = capsys.readouterr().out
    assert expected.summary.digest in said
    assert replay_log(flown).summary.digest not in said


def test_what_a_recording_carries_is_the_profile_resolved():
    settings = load(profile="ground_test")
    assert from_json(to_json(settings), "here") == settings
