"""Each module of the filter writes the fields of the state that it lists, and asks for the rest."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2] / "ahrs_service"
MODULES = [*sorted((ROOT / "fusion").glob("*.py")), ROOT / "pipeline.py"]
FILTER = {"filter_state", "mekf", "propagation"}
"""One filter: what it estimates, its correction and its prediction."""

HANDED_OVER = {"measured"}
"""h of a measurement: its module writes it, `mekf.correct` reads it, and it is zero after that."""

ALLOWED = {
    ("alignment", "covariance"): "the covariance of a first velocity that points along the nose",
    ("alignment", "velocity_ned_m_s"): "that velocity",
    ("ground_velocity", "correction"): "pending corrections rotate with a heading found",
    ("ground_velocity", "velocity_lag_s"): "the lag as set, until it is estimated",
    ("heading", "correction"): "the tilt is considered, not corrected, by a magnetic field",
    ("heading", "covariance"): "and keeps its covariance",
    ("mekf", "history_m_s"): "stored velocities in earth axes rotate with the heading",
    ("pipeline", "dcm"): "the state before the first sample",
    ("pipeline", "ned_from_body"): "the state before the first sample",
}
"""What is written from outside its module, each with the reason."""


def fields_of(tree):
    """Yield the fields of the state that a module lists in its `..._FIELDS` or `STATE_DTYPE`."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.AnnAssign):
            continue
        name = ast.unparse(node.target)
        if name.endswith("_FIELDS") or name == "STATE_DTYPE":
            for part in ast.walk(node.value):
                if isinstance(part, ast.Tuple) and isinstance(part.elts[0], ast.Constant):
                    name = part.elts[0].value
                    yield from [name] if isinstance(name, str) else []


def field_in(node, names):
    """Return the field that `state["field"]...`, or a name given to that, is part of."""
    while isinstance(node, ast.Subscript):
        if ast.unparse(node.value) == "state" and isinstance(node.slice, ast.Constant):
            return node.slice.value
        node = node.value
    return names.get(node.id) if isinstance(node, ast.Name) else None


def assigned(function):
    """Yield what is assigned to, and the value where it is one."""
    for node in ast.walk(function):
        if isinstance(node, ast.AugAssign):
            yield node.target, None
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                if isinstance(target, ast.Tuple):
                    values = getattr(node.value, "elts", [None] * len(target.elts))
                    yield from zip(target.elts, values, strict=True)
                else:
                    yield target, node.value
        elif isinstance(node, ast.For) and isinstance(node.iter, ast.Tuple):
            yield from ((node.target, value) for value in node.iter.elts)


def written(function):
    """Return the fields of the state that a function writes into."""
    names, found = {}, set()
    for target, value in assigned(function):
        if isinstance(target, ast.Name) and isinstance(value, ast.Subscript):
            names.setdefault(target.id, set()).add(field_in(value, {}))
    for target, _ in assigned(function):
        if isinstance(target, ast.Subscript):
            direct = field_in(target, {name: name for name in names})
            found |= names.get(direct, {direct})
    return found - {None}


def test_only_the_owner_of_a_field_writes_it_but_for_what_is_listed():
    trees = {path.stem: ast.parse(path.read_text()) for path in MODULES}
    owner = {field: name for name, tree in trees.items() for field in fields_of(tree)}
    across = set()
    for name, tree in trees.items():
        for function in ast.walk(tree):
            if not isinstance(function, ast.FunctionDef):
                continue
            for field in written(function) & set(owner) - HANDED_OVER:
                both_filter = name in FILTER and owner[field] in FILTER
                if owner[field] != name and not both_filter:
                    across.add((name, field))
    assert across == set(ALLOWED)


def test_no_field_has_two_owners():
    listed = [field for path in MODULES for field in fields_of(ast.parse(path.read_text()))]
    assert len(listed) > 90
    assert len(listed) == len(set(listed))
