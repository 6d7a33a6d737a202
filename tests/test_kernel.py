"""The folder of compiled code follows every source that is compiled into it."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ahrs_service
from ahrs_service.kernel import kernel

PACKAGE = Path(ahrs_service.__file__).parent

SCRIPT = """
import sys
from pathlib import Path
from ahrs_service import kernel

root = Path(kernel.__file__).parent
assert str(root) == sys.argv[1], root
names = [kernel._cache_folder().name]
for name in sys.argv[2:]:
    path = root.parent / name
    before = path.read_bytes()
    path.write_bytes(before + b"# changed\\n")
    names.append(kernel._cache_folder().name)
    path.write_bytes(before)
names.append(kernel._cache_folder().name)
print(" ".join(names))
"""

STALE = """
from ahrs_service.fusion.{caller} import outer
print(outer(1.0))
"""


@pytest.fixture
def copy(tmp_path):
    """A copy of the sources, and how to run a script with them."""
    ignored = shutil.ignore_patterns("__pycache__")
    for package in (PACKAGE, PACKAGE / "links"):
        shutil.copytree(package, tmp_path / package.name, ignore=ignored)
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment["PYTHONPATH"] = str(tmp_path)
    environment["PYTHONDONTWRITEBYTECODE"] = "1"

    def run(script, *arguments):
        command = [sys.executable, "-c", script, *map(str, arguments)]
        done = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    run.root = tmp_path / "ahrs_service"
    return run


def test_every_kernel_source_has_its_say_and_no_other(copy):
    compiled = [
        "ahrs_service/fusion/gating.py",
        "ahrs_service/rotation.py",
        "ahrs_service/intake.py",
        "ahrs_service/constants.py",
        "ahrs_service/records.py",
        "ahrs_service/kernel_part.py",
        "ahrs_service/links/logs/dataflash_tables.py",
    ]
    others = ["ahrs_service/app/cli.py", "ahrs_service/settings.py", "ahrs_service/health.py"]
    first, *changed, last = copy(SCRIPT, copy.root, *compiled, *others)
    assert first == last
    assert len({first, *changed[: len(compiled)]}) == 1 + len(compiled)
    assert set(changed[len(compiled) :]) == {first}


@pytest.mark.parametrize("decorator", ["kernel", "inlined_kernel"])
def test_a_changed_callee_is_never_served_stale(copy, decorator):
    head = "from ahrs_service.kernel import kernel\n"
    callee = copy.root / "fusion" / "callee.py"
    inner = f"from ahrs_service.kernel import {decorator}\n@{decorator}\ndef inner(x):\n"
    callee.write_text(inner + "    return x + 1.0\n")
    (copy.root / "fusion" / "caller.py").write_text(
        head + "from ahrs_service.fusion.callee import inner\n"
        "@kernel\ndef outer(x):\n    return 10.0 * inner(x)\n"
    )
    script = STALE.format(caller="caller")
    assert copy(script) == ["20.0"]
    callee.write_text(inner + "    return x + 2.0\n")
    assert copy(script) == ["30.0"]


def test_the_code_lies_beside_the_sources_and_is_used_again(copy):
    folder = copy.root / "__pycache__"
    script = "from ahrs_service.rotation import normalise\nimport numpy as np\n"
    script += "normalise(np.array([2.0, 0, 0, 0]))\n"
    script += "print(sum(normalise.stats.cache_hits.values()))"
    assert copy(script) == ["0"]
    assert list(folder.glob("kernels-*/**/*.nbi"))
    assert copy(script) == ["1"]


def test_a_kernel_is_strict_about_floats():
    @kernel
    def forget(x, y):
        return (x + y) - y

    # With fast-math the compiler might return x.
    assert forget(1.0, 1e17) == 0.0
    assert np.isnan(forget(np.nan, 1.0))


def test_an_inlined_kernel_is_a_part_of_its_caller_and_what_it_calls_is_not(copy):
    """Left to numba, a callee inherits from its caller that it is inlined."""
    (copy.root / "fusion" / "nested.py").write_text(
        "import math\n"
        "from ahrs_service.kernel import inlined_kernel, kernel\n"
        "@kernel\ndef inner(x):\n    return math.sin(x)\n"
        "@inlined_kernel\ndef middle(x):\n    return inner(x)\n"
        "@kernel\ndef outer(x):\n    return middle(x)\n"
    )
    script = "from ahrs_service.fusion.nested import inner, middle, outer\n"
    script += "result = outer(0.5)\n"
    script += "for function in (inner, middle, outer):\n"
    script += "    (overload,) = (function.overloads or function.part.overloads).values()\n"
    script += "    print('alwaysinline' in overload.library.get_llvm_str())\n"
    script += "print(result)"
    assert copy(script) == ["False", "True", "False", str(math.sin(0.5))]


def test_a_kernel_called_by_a_kernel_has_no_way_in_from_python_until_python_calls_it(copy):
    (copy.root / "fusion" / "nested.py").write_text(
        "from ahrs_service.kernel import kernel\n"
        "@kernel\ndef element(x, i):\n    return x[i]\n"
        "@kernel\ndef outer(x):\n    return element(x, 0) + element(x, 1)\n"
    )
    script = "import numpy as np\nfrom ahrs_service.fusion.nested import element, outer\n"
    script += "x = np.array([1.0, 2.0])\n"
    script += "print(outer(x), len(element.part.overloads), len(element.overloads))\n"
    # Neither call finds the other's code in the cache.
    script += "print(element(x, 1), len(element.part.overloads), len(element.overloads))\n"
    # One for both of the literal numbers 0 and 1.
    assert copy(script) == ["3.0", "1", "0", "2.0", "1", "1"]
    assert copy(script) == ["3.0", "0", "0", "2.0", "0", "1"]
    names = {path.name.split("-")[0] for path in copy.root.rglob("nested*.nbi")}
    assert names == {"nested.element", "nested.element.part", "nested.outer"}


RAISING = """
import numpy as np
from ahrs_service.kernel import kernel


@kernel
def refuse(row):
    if row[0] < 0.0:
        raise ValueError("below zero", row[0])
    return row[0]


@kernel
def {caller}(row):
    return refuse(row) + 1.0


print({caller}(np.ones(1)), {caller}.stats.cache_hits.total())
try:
    {caller}(-np.ones(1))
except ValueError as error:
    print(*error.args)
"""


def test_what_a_part_raises_arrives_compiled_loaded_and_from_another_caller(tmp_path):
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": str(PACKAGE.parent),
    }
    script = tmp_path / "raising.py"

    def run(caller):
        script.write_text(RAISING.format(caller=caller))
        os.utime(script, (1e9, 1e9))
        command = [sys.executable, str(script)]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        ).stdout.split("\n")

    refused = "below zero -1.0"
    assert run("outer")[:2] == ["2.0 0", refused]
    assert run("outer")[:2] == ["2.0 1", refused]
    assert run("other")[:2] == ["2.0 0", refused]
