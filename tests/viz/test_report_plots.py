"""Pictures hold the data given: read back from the SVG, and identical each time."""

import re
from dataclasses import dataclass, field

import numpy as np

from ahrs_service.viz import report_plots as plots


@dataclass(frozen=True)
class Against:
    triad: str = "accel"
    channel: str = "accel_z"
    covariate: str = "vibration"
    unit: str = "m/s^2"
    edges: np.ndarray = field(default_factory=lambda: np.linspace(0.0, 5.0, 11))
    mean: np.ndarray = field(default_factory=lambda: np.linspace(0.0, -0.4, 10))
    null_std: np.ndarray = field(default_factory=lambda: np.full(10, 0.01))
    fitted: np.ndarray = field(default_factory=lambda: np.linspace(0.0, -0.4, 10))
    p_value: float = 1e-20


def texts(svg):
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_covariates_are_drawn_with_their_names_and_dots():
    svg = plots.as_svg(
        plots.against_covariates([Against(), Against("gyro", "gyro_x", "throttle", "1")])
    )
    words = texts(svg)
    assert "accel z [m/s²], p &lt; 1e-12" in words
    assert "vibration [m/s^2]" in words
    assert "throttle [1]" in words
    # One marker per bin of each panel, and one in the legend.
    assert svg.count("<use ") >= 20


def test_no_picture_reaches_for_a_network():
    svg = plots.as_svg(plots.against_covariates([Against()]))
    links = set(re.findall(r'(?:href|src)="([^"#][^"]*)"', svg))
    assert links == set()


def test_the_same_figures_give_the_same_bytes():
    time_s = np.arange(0.0, 100.0, 0.1)
    values = np.random.default_rng(2).normal(0.0, 1.0, (len(time_s), 6))

    def draw():
        return plots.as_svg(plots.residual_over_time(time_s, values, 0.5 * values, [(10.0, 20.0)]))

    assert draw() == draw()


def test_bins_average_and_leave_out_what_is_not_there():
    time_s = np.arange(0.0, 600.0, 0.1)
    values = np.sin(2.0 * np.pi * time_s / 600.0)
    values[::7] = np.nan
    t, mean = plots._binned(time_s, values)
    assert len(t) == 300
    np.testing.assert_allclose(mean, np.sin(2.0 * np.pi * t / 600.0), atol=2e-3)


def test_bars_and_time_line_carry_their_names():
    bars = plots.evidence_bars(["gyro_scale_factor", "instead: gyro_misalignment"], [120.0, 30.0])
    assert {"gyro_scale_factor", "instead: gyro_misalignment", " 120"} <= set(
        texts(plots.as_svg(bars))
    )
    line = plots.timeline([("gyro_scale_factor", [(3.0, 9.0)])], (0.0, 10.0))
    assert "gyro_scale_factor" in texts(plots.as_svg(line))
    held = plots.holdout_bars(["rms"], [np.ones(3)], [np.zeros(3)], "m/s²")
    assert plots.as_png(held)[:8] == b"\x89PNG\r\n\x1a\n"
