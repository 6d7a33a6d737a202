"""What each room may know: allow-lists over the import graph, down to the rooms inside a room."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1] / "ahrs_service"
DIVIDED = {"app", "blind", "diagnosis", "links"}
"""Packages with sub-packages that have their own rules; other modules are single."""

LOWEST = {"errors", "records", "constants"}
"""What every room may know."""

LINKS = {"links.logs", "links.mavlink"}
DIAGNOSIS = {"diagnosis.diagnose", "diagnosis.input", "diagnosis.judgement", "diagnosis.result"}
FLIGHT = {"estimator", "fusion", "intake", "pipeline", "rotation", "sensor", "settings"}

MAY_KNOW = {
    "errors": set(),
    "records": set(),
    "constants": set(),
    "settings": set(),
    "kernel_part": set(),
    "kernel": {"kernel_part"},
    "rotation": {"kernel"},
    "effects": {"kernel", "rotation"},
    "vehicle_axes": {"kernel", "rotation"},
    "sensor": {"kernel"},
    "fusion": {"kernel", "rotation", "settings"},
    "adoption": {"kernel", "settings"},
    "flat_columns": {"rotation"},
    "intake": {"adoption", "kernel", "settings", "vehicle_axes"},
    "chosen_imu": {"adoption", "intake", "settings"},
    "pipeline": {"fusion", "kernel", "sensor", "settings", "vehicle_axes"},
    "smoothing": {"fusion", "kernel", "pipeline", "sensor", "settings"},
    "attitude_interpolation": {"rotation"},
    "comparison": {"attitude_interpolation", "rotation"},
    "health": set(),
    "simulation": {"effects", "kernel", "rotation", "sensor"},
    "estimator": {"rotation", "fusion", "intake", "pipeline", "sensor", "settings", "smoothing"},
    "calibration": {"effects", "kernel", "rotation", "sensor"},
    "diagnosis.result": set(),
    "diagnosis.noise_model": {"kernel"},
    "diagnosis.input": {"diagnosis.noise_model", "effects", "kernel", "rotation"},
    "diagnosis.hypotheses": {"diagnosis.input", "effects"},
    "diagnosis.judgement": {
        "diagnosis.hypotheses",
        "diagnosis.input",
        "diagnosis.result",
        "effects",
        "rotation",
    },
    "diagnosis.search": {
        "diagnosis.hypotheses",
        "diagnosis.input",
        "diagnosis.judgement",
        "diagnosis.result",
        "effects",
    },
    "diagnosis.diagnose": {
        "diagnosis.hypotheses",
        "diagnosis.input",
        "diagnosis.judgement",
        "diagnosis.result",
        "diagnosis.search",
    },
    "blind.making": {"rotation"},
    "blind.judging": {"blind.making", "diagnosis.input", "effects"},
    "links.transport": set(),
    "links.mavlink": set(),
    "links.logs": {
        "adoption",
        "settings",
        "kernel",
        "links.mavlink",
        "links.transport",
        "rotation",
    },
    "links.component": LINKS | {"adoption", "links.transport", "rotation", "settings"},
    "links.simulated": {"links.logs", "links.mavlink", "rotation"},
    "viz": {"rotation", "settings"},
    "app.statistics": set(),
    "app.settings": {"app.files", "app.options", "settings"},
    "app.compile": LINKS | {"calibration", "effects", "estimator", "sensor", "settings"},
    "app.intake_choice": LINKS
    | {"adoption", "app.files", "app.options", "chosen_imu", "estimator", "intake", "settings"},
    "app.options": {"app.files", "settings"},
    "app.files": {
        "diagnosis.input",
        "diagnosis.judgement",
        "effects",
        "intake",
        "sensor",
        "settings",
        "simulation",
    },
    "app.replay": LINKS
    | FLIGHT
    | {
        "adoption",
        "app.intake_choice",
        "flat_columns",
        "app.files",
        "app.options",
        "app.statistics",
        "comparison",
        "links.component",
        "smoothing",
        "viz",
    },
    "app.live": LINKS
    | FLIGHT
    | {
        "app.files",
        "app.options",
        "app.replay",
        "app.statistics",
        "health",
        "links.component",
        "links.simulated",
        "links.transport",
        "simulation",
        "viz",
    },
    "app.estimate": FLIGHT | {"app.files", "app.options", "smoothing"},
    "app.calibrate": LINKS
    | {
        "app.intake_choice",
        "chosen_imu",
        "app.files",
        "app.live",
        "app.options",
        "app.replay",
        "calibration",
        "intake",
        "links.component",
        "sensor",
        "settings",
        "viz",
    },
    "app.diagnose": LINKS
    | DIAGNOSIS
    | {
        "adoption",
        "app.intake_choice",
        "settings",
        "app.files",
        "app.options",
        "app.replay",
        "calibration",
        "effects",
        "intake",
        "rotation",
        "sensor",
        "simulation",
        "viz",
    },
    "app.simulate": LINKS
    | {
        "app.diagnose",
        "app.intake_choice",
        "settings",
        "app.files",
        "app.options",
        "attitude_interpolation",
        "diagnosis.input",
        "intake",
        "links.simulated",
        "links.transport",
        "simulation",
    },
    "app.prove": {
        "app.diagnose",
        "app.files",
        "app.options",
        "blind.judging",
        "blind.making",
        "diagnosis.diagnose",
        "diagnosis.result",
        "links.mavlink",
    },
    "app.cli": {"app.files"},
}
"""What the modules of each room may import directly, besides `LOWEST` and their own room."""

MATHEMATICS = {
    "__future__",
    "abc",
    "annotated_types",
    "collections",
    "dataclasses",
    "datetime",
    "enum",
    "functools",
    "hashlib",
    "itertools",
    "math",
    "numpy",
    "scipy",
    "statistics",
    "types",
    "typing",
}
"""All that the estimator's own rooms may take from outside: no clock, no file, no event loop."""

FROM_OUTSIDE = {
    "kernel": MATHEMATICS | {"numba", "os", "pathlib"},
    "kernel_part": MATHEMATICS | {"llvmlite", "numba"},
    # Effects are found by looking through their folder.
    "effects": MATHEMATICS | {"importlib", "pkgutil"},
    "viz": MATHEMATICS
    | {"io", "matplotlib", "os", "pathlib", "rerun", "socket", "textwrap"}
    | {"threading"},
}
"""The same for rooms that need more; `links` and `app` are where the outside is."""


def files_in(folder):
    """Yield the modules of a folder and of those in it, also where they are links to folders."""
    for entry in sorted(folder.iterdir()):
        if entry.is_dir():
            yield from files_in(entry)
        elif entry.suffix == ".py":
            yield entry


def modules():
    """Yield the parts of every module's name, with its path."""
    for path in files_in(ROOT):
        parts = path.relative_to(ROOT).with_suffix("").parts
        yield tuple(part for part in parts if part != "__init__"), path


def room_of(parts):
    """Return the room of a module by the parts of its name; None for the package itself."""
    if not parts or (parts[0] in DIVIDED and len(parts) == 1):
        return None
    return ".".join(parts[:2]) if parts[0] in DIVIDED else parts[0]


KNOWN = {parts for parts, _ in modules()}


def imported(path):
    """Yield what a file imports, also inside its functions, as parts of names."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (tuple(alias.name.split(".")) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = tuple((node.module or "").split("."))
            for alias in node.names:
                whole = (*module, alias.name)
                yield whole if whole[1:] in KNOWN else module


def test_each_room_says_what_it_may_know():
    rooms = {room_of(parts) for parts, _ in modules()} - {None}
    entrances = {"__main__"}
    assert rooms - entrances <= set(MAY_KNOW)


@pytest.mark.parametrize("room", sorted(MAY_KNOW))
def test_a_room_knows_what_it_may_and_nothing_else(room):
    allowed = MAY_KNOW[room] | LOWEST | {room}
    for parts, path in modules():
        if room_of(parts) != room:
            continue
        for name in imported(path):
            if name[0] == "ahrs_service" and room_of(name[1:]) is not None:
                assert room_of(name[1:]) in allowed, f"{'.'.join(parts)} imports {'.'.join(name)}"


def test_rooms_have_no_circle():
    done, left = set(), {room: known | LOWEST - {room} for room, known in MAY_KNOW.items()}
    for lowest in LOWEST:
        left[lowest] = set()
    while left:
        free = {room for room, known in left.items() if known - {room} <= done}
        assert free, f"rooms that know each other in a circle, or above one: {sorted(left)}"
        done |= free
        left = {room: known for room, known in left.items() if room not in free}


def test_the_estimators_rooms_take_nothing_from_outside_but_mathematics():
    for parts, path in modules():
        room = room_of(parts)
        if room is None or room.split(".")[0] in ("app", "links") or room == "__main__":
            continue
        allowed = FROM_OUTSIDE.get(room, MATHEMATICS) | {"ahrs_service"}
        for name in imported(path):
            assert name[0] in allowed, f"{'.'.join(parts)} imports {name[0]}"


def test_sealed_recordings_are_made_without_what_finds_them():
    """Directly and by way of others: the making may not reach effects, diagnosis or the twin."""
    paths = dict(modules())
    reached, left = set(), [parts for parts in paths if parts[:2] == ("blind", "making")]
    while left:
        parts = left.pop()
        if parts in reached:
            continue
        reached.add(parts)
        left += [name[1:] for name in imported(paths[parts]) if name[1:] and name[1:] in paths]
    rooms = {room_of(parts) for parts in reached}
    assert rooms - {None} <= {"blind.making", "rotation", "kernel", "kernel_part"} | LOWEST
