"""Every named number has a documented source."""

import ast
import io
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "ahrs_service"
ROOMS = (
    "fusion",
    "intake.py",
    "pipeline.py",
    "smoothing.py",
    "vehicle_axes.py",
    "attitude_interpolation.py",
    "diagnosis",
    "calibration",
    "blind",
)  # rooms and modules below ahrs_service that hold to it


def modules() -> list[Path]:
    """Return the modules of the rooms; a name ending in .py is one module."""
    found: list[Path] = []
    for room in ROOMS:
        path = PACKAGE / room
        found += [path] if path.suffix == ".py" else sorted(path.rglob("*.py"))
    return found


def is_number(node: ast.expr | None) -> bool:
    """Return whether the value is a number, or a tuple, list, dict or array of literal numbers."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return not is_bit_flag(node) and holds_number(node)
    if isinstance(node, ast.Tuple | ast.List):
        return any(is_number(element) for element in node.elts)
    if isinstance(node, ast.Dict):
        return any(is_number(value) for value in node.values)
    if isinstance(node, ast.Call):  # np.array([...]), float(chi2.ppf(...)), np.radians(...)
        return not is_table(node) and any(is_number(argument) for argument in node.args)
    return False


def holds_number(node: ast.expr) -> bool:
    """Return whether a number stands anywhere in the expression."""
    return any(is_number(inner) for inner in ast.walk(node) if isinstance(inner, ast.Constant))


def is_bit_flag(node: ast.BinOp) -> bool:
    """Return whether the expression makes bits: 1 << 3, A | B."""
    return isinstance(node.op, ast.LShift | ast.RShift | ast.BitOr | ast.BitAnd)


def is_table(node: ast.Call) -> bool:
    """Return whether the call makes a dtype, or an int of a member of an enum."""
    called = ast.unparse(node.func)
    copy = called == "int" and all(isinstance(argument, ast.Attribute) for argument in node.args)
    return copy or called.rpartition(".")[2] in ("dtype", "TypeVar", "NewType")


def constants(body: list[ast.stmt]) -> Iterator[tuple[str, ast.stmt, ast.stmt | None]]:
    """Give each named number of the module: name, statement, statement below."""
    for position, statement in enumerate(body):
        if isinstance(statement, ast.Assign):
            targets = statement.targets
        elif isinstance(statement, ast.AnnAssign):
            targets = [statement.target]
        else:
            continue
        below = body[position + 1] if position + 1 < len(body) else None
        for target in targets:
            if isinstance(target, ast.Name) and target.id.isupper() and is_number(statement.value):
                yield target.id, statement, below


def comment_lines(source: str) -> set[int]:
    """Return the lines that hold a comment meant for the reader, not for a tool."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    tools = ("# noqa", "# type:", "# fmt:", "# pragma")
    return {
        token.start[0]
        for token in tokens
        if token.type == tokenize.COMMENT and not token.string.startswith(tools)
    }


def without_a_word(source: str) -> list[str]:
    """Return the names of the module's numbers that have neither comment nor docstring."""
    comments, missing = comment_lines(source), []
    for name, statement, below in constants(ast.parse(source).body):
        end = statement.end_lineno or statement.lineno
        documented = (
            isinstance(below, ast.Expr)
            and isinstance(below.value, ast.Constant)
            and isinstance(below.value.value, str)
        )
        own_line_above = source.splitlines()[statement.lineno - 2].lstrip().startswith("#")
        above = own_line_above and statement.lineno - 1 in comments
        if not (documented or above or comments & set(range(statement.lineno, end + 1))):
            missing.append(name)
    return missing


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_every_number_says_where_it_comes_from(path: Path) -> None:
    missing = without_a_word(path.read_text())
    assert not missing, f"{path}: no explanation of {', '.join(missing)}"


@pytest.mark.parametrize(
    "silent",
    [
        "LIMIT = 3.0",
        "_LIMIT = -1e-3",
        "LIMIT: Final = 2 * OTHER",
        "LIMITS = (1.0, 2.0)",
        'LIMITS = {"gyro": 0.3}',
        "LIMIT = float(chi2.ppf(0.99, 3))",
        "LIMITS = np.array([1.0, 2.0])",
        "LIMIT = 3.0  # noqa: N816",
    ],
)
def test_silent_number_is_found(silent: str) -> None:
    assert without_a_word(f"import x\n\n{silent}\n") == [silent.split(maxsplit=1)[0].rstrip(":")]


@pytest.mark.parametrize(
    "spoken",
    [
        "LIMIT = 3.0  # a choice: wide",
        "# a choice: wide\nLIMIT = 3.0",
        'LIMIT = 3.0\n"""A choice: wide."""',
        "LIMITS = (\n    1.0,  # [m]\n    2.0,\n)",
        "_IMU = int(Kind.IMU)",
        "FLAG = 1 << 3",
        'ROW = np.dtype([("t", "<f8", (3,))])',
        "lower = 3.0",
        "NAMES = ('a', 'b')",
        "ENABLED = True",
    ],
)
def test_spoken_or_exempt_is_let_be(spoken: str) -> None:
    assert without_a_word(f"import x\n\n{spoken}\n") == []
