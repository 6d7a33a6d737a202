"""One layout of the viewer for live and replay: aircraft, gate, and why."""

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumnKind

from ahrs_service.viz import entities

LIVE_WINDOW_S = 60.0


def blueprint(live: bool, shows_sensor: bool = False) -> rrb.Blueprint:
    """Return the layout; live it follows the stream and shows the last minute.

    With `shows_sensor` a second tab has the sensor's raw output next to the compensated.
    """
    window = _last(LIVE_WINDOW_S) if live else None
    plots: rrb.Grid | rrb.Tabs = _plots(window)
    if shows_sensor:
        plots = rrb.Tabs(plots, _sensor(window))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(_scene(), plots, column_shares=[0.8, 1.0]),
            _states(window),
            _bottom(window),
            row_shares=[0.625, 0.18, 0.195],
        ),
        rrb.TimePanel(
            timeline=entities.TIMELINE,
            play_state="following" if live else "paused",
            state="collapsed",
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _last(seconds: float) -> rrb.VisibleTimeRange:
    return rrb.VisibleTimeRange(
        entities.TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )


def _scene() -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=entities.WORLD,
        name="Ours blue, theirs grey. Thick arrow: felt gravity, green if trusted",
        eye_controls=rrb.EyeControls3D(
            position=(-6.0, 1.6, -2.1), look_target=(0.2, 0.0, 0.95), eye_up=(0.0, 0.0, -1.0)
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def _plot(
    entity: str,
    name: str,
    window: rrb.VisibleTimeRange | None,
    legend: rrb.Corner2D | None = None,
    limits: tuple[float, float] | None = None,
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=entity,
        name=name,
        time_ranges=window,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits, zoom_lock=True),
        plot_legend=rrb.PlotLegend(corner=legend, visible=legend is not None),
    )


def _attitude(
    name: str, angles: list[bool], window: rrb.VisibleTimeRange | None
) -> rrb.TimeSeriesView:
    """Plot some of the three angles of ours and of theirs."""
    shown = rr.SeriesLines(visible_series=angles)
    whose = (f"{entities.ATTITUDE}/ours", f"{entities.ATTITUDE}/theirs")
    return rrb.TimeSeriesView(
        origin=entities.ATTITUDE,
        contents=list(whose),
        name=name,
        time_ranges=window,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend(visible=False),
        overrides=dict.fromkeys(whose, shown),
    )


def _plots(window: rrb.VisibleTimeRange | None) -> rrb.Grid:
    load = (0.0, 2.0)
    return rrb.Grid(
        _attitude("Roll red, pitch green [deg]; theirs pale", [True, True, False], window),
        _plot(entities.LOAD, "Gate: closed above 1", window, rrb.Corner2D.LeftTop, load),
        _plot(entities.RESIDUAL, "Force less gravity, x y z [m/s²]", window),
        _plot(entities.INNOVATION, "Tilt innovation, x y z [deg]", window),
        _plot(entities.BIAS, "Gyro bias ± 1 sigma, x y z [deg/s]", window),
        rrb.Tabs(
            _attitude("Heading [deg]; theirs pale", [False, False, True], window),
            _plot(entities.SIGMA, "1 sigma north, east, down [deg]", window),
        ),
        grid_columns=2,
        name="Estimate",
    )


def _sensor(window: rrb.VisibleTimeRange | None) -> rrb.Grid:
    return rrb.Grid(
        _plot(entities.RAW_RATE, "Rate, raw [deg/s]", window),
        _plot(entities.USED_RATE, "Rate, compensated [deg/s]", window),
        _plot(entities.RAW_FORCE, "Force, raw [m/s²]", window),
        _plot(entities.USED_FORCE, "Force, compensated [m/s²]", window),
        _plot(entities.RATE_CORRECTION, "Raw less compensated, x y z [deg/s]", window),
        _plot(entities.FORCE_CORRECTION, "Raw less compensated, x y z [m/s²]", window),
        grid_columns=2,
        name="Sensor",
    )


def _states(window: rrb.VisibleTimeRange | None) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(
        origin="/state",
        name="Is the accelerometer taken for the vertical (each second), the gate, the samples",
        time_ranges=window,
        time_view=rrb.TimeAxis(link="LinkToGlobal"),
    )


def _bottom(window: rrb.VisibleTimeRange | None) -> rrb.Horizontal:
    corner = rrb.Corner2D.LeftBottom
    kinds = TextLogColumnKind
    return rrb.Horizontal(
        _plot(entities.TEMPERATURE, "Temperature [°C]", window, corner),
        _plot(entities.RATES, "Rates [Hz]", window, corner),
        _plot(entities.DROPS, "Dropped", window, corner),
        rrb.TextLogView(
            origin=entities.LOG,
            name="Log",
            columns=rrb.TextLogColumns(
                timeline_columns=[],
                text_log_columns=[kinds.LogLevel, kinds.Body],
            ),
        ),
        column_shares=[1.0, 1.0, 1.0, 1.6],
    )
