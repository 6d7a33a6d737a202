"""What a program finds at `import ahrs_service`: names that load late, one tree of errors."""

import ast
import builtins
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import ahrs_service
from ahrs_service import (
    AhrsError,
    Estimator,
    errors,
    read_recording,
)
from ahrs_service.app.cli import main
from ahrs_service.sensor.parameters import TriadCalibration
from ahrs_service.settings import GateBudget

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("numba", "rerun", "scipy", "pymavlink", "pydantic", "numpy")


def python(*words):
    """Run a fresh interpreter; return what it printed."""
    done = subprocess.run(
        [sys.executable, *words],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_to_import_the_package_loads_nothing_heavy():
    script = f"import sys, ahrs_service; print([m for m in {HEAVY} if m in sys.modules])"
    assert python("-c", script) == "[]"


def test_errors_and_settings_load_no_compiler():
    script = (
        "import sys; from ahrs_service import AhrsError, Settings, __version__; Settings(); "
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    assert python("-c", script) == "[]"


def test_every_name_is_there_and_documented():
    for name in ahrs_service.__all__:
        assert name in dir(ahrs_service)
        value = getattr(ahrs_service, name)
        assert name == "__version__" or ">>> " in value.__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'estimator_of'"):
        ahrs_service.estimator_of  # noqa: B018


def test_no_room_imports_from_the_front_door():
    """A chain from a lower room through the front door would reach up to the app."""
    for folder in ("ahrs_service", "links", "viz"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if "app" in path.relative_to(ROOT).parts:
                continue
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module == "ahrs_service":
                    taken = {alias.name for alias in node.names}
                    assert not taken & set(ahrs_service.__all__), path


def test_the_version_is_reported_in_three_ways(capsys):
    assert ahrs_service.__version__ == version("ahrs-service")
    with pytest.raises(SystemExit) as left:
        main(["--version"])
    assert left.value.code == 0
    line = f"ahrs-service {ahrs_service.__version__}"
    assert capsys.readouterr().out.strip() == line
    assert python("-m", "ahrs_service", "--version") == line


def test_the_package_is_typed():
    assert (Path(ahrs_service.__file__).parent / "py.typed").is_file()


# -- errors -----------------------------------------------------------------------------------


def tree_drawn():
    """Each class of the drawing in errors.py, with the class it hangs from."""
    drawn, above = {}, []
    for line in errors.__doc__.splitlines():
        text = line.lstrip(" │├└─")
        name = text.split(" ", maxsplit=1)[0]
        if not name.endswith("Error") or not line.startswith("    "):
            continue
        depth = (len(line) - len(text)) // 4 - 1
        above[depth:] = [name]
        drawn[name] = above[depth - 1] if depth else None
    return drawn


def test_the_tree_of_errors_is_as_drawn():
    there = {
        name: value
        for name, value in vars(errors).items()
        if isinstance(value, type) and issubclass(value, Exception)
    }
    drawn = tree_drawn()
    assert set(drawn) == set(there)
    for name, above in drawn.items():
        assert issubclass(there[name], AhrsError)
        assert above is None or there[name].__bases__[0] is there[above], name
        is_value_error = "(also a ValueError)" in next(
            line
            for line in errors.__doc__.splitlines()
            if f" {name} " in line or line.strip() == name
        )
        assert issubclass(there[name], ValueError) == is_value_error, name


def test_no_error_stands_outside_the_tree():
    known = {
        name
        for name, value in vars(builtins).items()
        if isinstance(value, type) and issubclass(value, BaseException)
    }
    for folder in ("ahrs_service", "links", "viz"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                bases = {ast.unparse(base) for base in getattr(node, "bases", ())}
                if isinstance(node, ast.ClassDef) and bases & (known | set(tree_drawn())):
                    assert path.name == "errors.py", f"{path}: {node.name}"


@pytest.mark.parametrize(
    "spoil",
    [
        lambda: GateBudget(acceleration_m_s2=1.0, tilt_deg=2.0),
        lambda: TriadCalibration(matrix=((0.0, 0.0, 0.0),) * 3),
        lambda: Estimator().restore(b"x"),
        lambda: read_recording("absent.tlog"),
        lambda: ahrs_service.load_settings(overrides=["gate.nrom=1"]),
        lambda: ahrs_service.load_calibration("absent.toml"),
        lambda: ahrs_service.diagnose("absent.tlog"),
    ],
)
def test_whatever_is_wrong_with_what_is_given_is_an_ahrs_error(spoil):
    with pytest.raises(AhrsError) as caught:
        spoil()
    assert caught.value.exit_code in (1, 2)
