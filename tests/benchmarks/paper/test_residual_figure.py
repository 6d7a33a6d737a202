"""The picture of the thermal comparison: it is drawn, and small."""

import numpy as np

from tests.benchmarks.paper.residual_figure import draw_residuals


def test_the_picture_is_drawn_and_small(tmp_path):
    rng = np.random.default_rng(1)
    path = tmp_path / "residuals.png"
    methods = {"one": 20.0 * rng.normal(size=(700, 3)), "two": rng.normal(size=(700, 3))}
    draw_residuals(path, "title", "mg", np.linspace(-40.0, 70.0, 700), methods, near=6.0)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert 10_000 < path.stat().st_size < 300_000
