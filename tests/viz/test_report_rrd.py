"""The report in the viewer holds residuals, spans, words and pictures."""

import numpy as np
import pytest

from ahrs_service.viz import report_plots
from ahrs_service.viz.report_rrd import write_report


@pytest.fixture
def residuals():
    time_s = np.arange(0.0, 60.0, 0.1)
    before = np.random.default_rng(1).normal(0.0, 1e-3, (len(time_s), 6))
    before[200:400, 5] -= 0.4
    after = before.copy()
    after[200:400, 5] += 0.4
    return time_s, before, after


def test_residuals_and_spans_are_on_the_time_line(tmp_path, residuals, read):
    time_s, before, after = residuals
    picture = report_plots.as_png(report_plots.residual_over_time(*residuals, [(20.0, 40.0)]))
    path = tmp_path / "report.rrd"
    where = {"accel_vibration_rectification": [(20.0, 40.0, "vibration above 2 m/s^2")]}
    write_report(path, *residuals, where, "# What was found", {"over time": picture})
    tables = read(path)
    for index, channel in enumerate(report_plots.CHANNELS):
        factor = 1e3 if channel.startswith("gyro") else 1.0
        for kind, values in (("before", before), ("after", after)):
            table = tables[f"/residual/{channel}/{kind}"]
            np.testing.assert_allclose(table.t * 1e-9, time_s, atol=1e-9)
            drawn = table.numbers("Scalars:scalars").ravel()
            np.testing.assert_allclose(drawn, values[:, index] * factor)
    states = tables["/where/accel_vibration_rectification"]
    assert (states.t * 1e-9).tolist() == [0.0, 20.0, 40.0]


def test_a_report_of_nothing_is_written(tmp_path, read):
    path = tmp_path / "empty.rrd"
    nothing = np.zeros((0, 6))
    write_report(path, np.zeros(0), nothing, nothing, {}, "nothing", {})
    assert path.stat().st_size > 0
    assert all(name.startswith("/residual") for name in read(path))
