"""The command line: help for everything, and exit codes that scripts can rely on."""

import pytest

from ahrs_service.app import cli
from ahrs_service.app.calibrate.command import PROCEDURES


def call(words):
    """Exit code of the command line, also where argparse ends the program."""
    try:
        return cli.main(words)
    except SystemExit as ended:
        return ended.code


def test_help_names_every_command_and_the_exit_codes(capsys):
    assert call(["--help"]) == 0
    shown = capsys.readouterr().out
    for name, (_, text) in cli.COMMANDS.items():
        assert f"  {name} " in shown
        assert text in shown
    assert "ahrs-service demo" in shown
    assert "exit codes: 0 done, 1 failed, 2 wrong usage or settings, 130 interrupted" in shown


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_explains_itself(command, capsys):
    assert call([command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"usage: ahrs-service {command}")
    known = tuple(f"    {name} " for name in PROCEDURES) if command == "calibrate" else ("  --",)
    assert [line for line in shown.splitlines() if line.startswith(known)]
    assert "None" not in shown


@pytest.mark.parametrize("procedure", PROCEDURES)
def test_every_procedure_of_calibrate_explains_itself(procedure, capsys):
    assert call(["calibrate", procedure, "--help"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"usage: ahrs-service calibrate {procedure}")
    assert [line for line in shown.splitlines() if line.startswith("  --")]
    assert "None" not in shown


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "COMMAND"),
        (["fly"], "invalid choice: 'fly'"),
        (["replay"], "LOG"),
        (["play", "flight.tlog"], "--link"),
        (["simulate"], "--link --tlog"),
        (["simulate", "--tlog", "x.tlog", "--seconds", "never"], "--seconds"),
        (["simulate", "--tlog", "x.tlog", "--seconds", "-1"], "--seconds"),
        (["simulate", "--tlog", "x.tlog", "--scenario", "moon"], "moon"),
        (["run", "--unknown"], "--unknown"),
        (["run", "--viewer", "99999"], "99999 is not a port, 1 to 65535"),
        (["run", "--seconds", "soon"], "soon is not a number above 0"),
        (["simulate", "--tlog", "x.tlog", "--truth", "-1"], "-1 is not a number of 0 or more"),
        (["play", "x.tlog", "--link", "tcp:h:1", "--speed", "0"], "0 is not a number above 0"),
        (["prove", "--jobs", "0.5"], "0.5 is not a whole number above 0"),
        (["diagnose", "x.tlog", "--html", "no/x.html"], "no/x.html: there is no folder no"),
        (["diagnose", "x.tlog", "--json", "."], ". is a folder; give a file"),
        (["calibrate", "thermal", "x.tlog", "--out", "no/x.toml"], "there is no folder no"),
        (["replay", "x.tlog", "--set", "gate=3"], "section.key=value"),
        (["demo", "--seconds"], "--seconds"),
        (["replay", "x.tlog", "--set", "gate.norm_m_s2=-1"], "gate.norm_m_s2"),
        (["replay", "x.tlog", "--set", "gate"], "section.key=value"),
        (["replay", "x.tlog", "--config", "absent.toml"], "absent.toml"),
        (["run", "--config", "absent.toml"], "absent.toml"),
        (["run", "--set", "link.system=300"], "link.system"),
    ],
)
def test_wrong_usage_ends_with_2_and_says_what(words, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call(words) == 2
    printed = capsys.readouterr()
    assert says in printed.err
    assert "Traceback" not in printed.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["replay", "absent.tlog"], "absent.tlog: no such file"),
        (["play", "absent.tlog", "--link", "udpout:127.0.0.1:14550"], "absent.tlog: no such file"),
        (["run", "--link", "carrier:pigeon"], "'carrier:pigeon'"),
        (["simulate", "--link", "udpout:127.0.0.1"], "HOST:PORT"),
        (["simulate", "--tlog", "absent/flight.tlog", "--seconds", "1"], "absent/flight.tlog"),
    ],
)
def test_what_fails_ends_with_1_and_one_line(words, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call(words) == 1
    printed = capsys.readouterr()
    assert says in printed.err
    assert "Traceback" not in printed.err


def test_an_interrupt_ends_with_130(monkeypatch):
    from ahrs_service.app.replay import command as replay

    def interrupted(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(replay, "run", interrupted)
    assert call(["replay", "x.tlog"]) == cli.EXIT_INTERRUPTED
