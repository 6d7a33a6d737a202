"""The rules of the rooms, checked on the source."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ahrs_service", "links", "viz")
MODULES = sorted(path for name in PACKAGES for path in (ROOT / name).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
CLOCKS = {
    "time.time",
    "time.time_ns",
    "time.monotonic",
    "time.monotonic_ns",
    "time.perf_counter",
    "time.perf_counter_ns",
    "time.sleep",
    "datetime.now",
    "datetime.utcnow",
    "datetime.today",
    "date.today",
}


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def tree_of(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def imports_of(path):
    """Every module that a file imports, also inside its functions."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name_of(path)}: imports are absolute"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def importers_of(package):
    return {
        name_of(path)
        for path in MODULES
        if any(module.split(".")[0] == package for module in imports_of(path))
    }


def test_the_import_contracts_hold():
    tool = Path(sys.executable).parent / "lint-imports"
    if not tool.exists():
        pytest.skip("import-linter is not installed (pip install -e .[dev])")
    done = subprocess.run([tool], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_pymavlink_enters_by_the_codec_alone():
    assert importers_of("pymavlink") == {"links/mavlink/codec.py"}


def test_rerun_enters_by_the_viewer_alone():
    assert importers_of("rerun")
    assert all(name.startswith("viz/") for name in importers_of("rerun"))


@pytest.mark.parametrize("package", ["asyncio", "logging", "rich", "pydantic", "argparse"])
def test_the_service_outside_its_app_needs_no(package):
    inside = {name for name in importers_of(package) if name.startswith("ahrs_service/")}
    assert all(name.startswith("ahrs_service/app/") for name in inside)


def test_no_clock_is_read_outside_links_viewer_and_app():
    for path in MODULES:
        name = name_of(path)
        if not name.startswith("ahrs_service/") or name.startswith("ahrs_service/app/"):
            continue
        assert "time" not in set(imports_of(path)), name
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Attribute):
                assert ast.unparse(node) not in CLOCKS, f"{name}:{node.lineno}"


def test_random_numbers_have_a_seed():
    for path in MODULES:
        name = name_of(path)
        if name.startswith("ahrs_service/"):
            assert "random" not in set(imports_of(path)), name
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("default_rng"):
                assert node.args, f"{name}:{node.lineno}: a generator without a seed"


def test_package_files_hold_a_docstring_only():
    """All but the front door, whose names load when they are first used."""
    packages = [path for path in MODULES if path.name == "__init__.py"]
    assert {path.parent.name for path in packages} >= set(PACKAGES)
    for path in packages:
        if path == ROOT / "ahrs_service" / "__init__.py":
            continue
        (only,) = tree_of(path).body
        assert isinstance(only, ast.Expr), name_of(path)
        assert isinstance(only.value, ast.Constant), name_of(path)


def test_every_folder_of_modules_is_a_package():
    for folder in {path.parent for path in MODULES}:
        assert (folder / "__init__.py").is_file(), name_of(folder)


def test_no_module_is_longer_than_400_lines():
    lengths = {name_of(path): len(path.read_text().splitlines()) for path in [*MODULES, *TESTS]}
    assert {name: length for name, length in lengths.items() if length > 400} == {}


def public(body, prefix=""):
    """Public functions and classes of a module, and the public methods of those classes."""
    for node in body:
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            continue
        if node.name.startswith("_"):
            continue
        is_protocol_field = prefix and ast.unparse(node.body[-1]) == "..."
        if not is_protocol_field:
            yield prefix + node.name, node
        if isinstance(node, ast.ClassDef):
            yield from public(node.body, f"{node.name}.")


def test_everything_public_has_a_docstring():
    missing = []
    for path in MODULES:
        tree = tree_of(path)
        if ast.get_docstring(tree) is None:
            missing.append(name_of(path))
        for name, node in public(tree.body):
            if ast.get_docstring(node) is None:
                missing.append(f"{name_of(path)}: {name}")
    assert missing == []


def test_kernels_are_strict():
    """Neither fast-math nor threads: both would change bytes between machines and runs."""
    for path in MODULES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.keyword) and node.arg in ("fastmath", "parallel", "nogil"):
                raise AssertionError(f"{name_of(path)}:{node.value.lineno}: {node.arg}")


def test_the_sources_speak_of_no_machine():
    configs = sorted(path for path in (ROOT / "configs").rglob("*") if path.is_file())
    for path in [*MODULES, ROOT / "README.md", *configs]:
        text = path.read_text(encoding="utf-8")
        for folder in (ROOT.parent, Path.home(), Path(sys.prefix)):
            assert f"{folder}/" not in text, f"{name_of(path)}: {folder}"
