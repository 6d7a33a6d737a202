"""A diagnosis in the viewer: residuals on the time line, where each finding shows, the words."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb

from ahrs_service.viz import entities
from ahrs_service.viz.report_plots import CHANNELS, TRIADS, unit_of, words

Floats = npt.NDArray[np.float64]
Span = tuple[float, float, str]

_COLOURS: Final = (entities.X, entities.Y, entities.Z)
_BEFORE: Final = 0x9AA0A6FF
_QUIET: Final = "quiet"
_SHOWS: Final = 0xE3A21AFF
_GREY: Final = 0x70757DFF


def write_report(
    path: str | Path,
    time_s: Floats,
    before: Floats,
    after: Floats,
    where: Mapping[str, Sequence[Span]],
    markdown: str,
    pictures: Mapping[str, bytes],
) -> None:
    """Write residuals [N, 6] at times [N] [s] before and after, with related data.

    `where` are spans (begin, end [s], regime) by name of a finding; `markdown` the words;
    `pictures` PNG files by name. Times are on the recording's clock.
    """
    path = Path(path)
    path.open("wb").close()
    recording = rr.RecordingStream(f"{entities.APPLICATION} diagnosis", recording_id=path.stem)
    layout = _blueprint(list(where), list(pictures), _whole(time_s))
    recording.set_sinks(rr.FileSink(path), default_blueprint=layout)
    recording.log("words", rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN), static=True)
    for name, content in pictures.items():
        entity = f"pictures/{rr.escape_entity_path_part(name)}"
        recording.log(
            entity, rr.EncodedImage(contents=content, media_type="image/png"), static=True
        )
    times = rr.TimeColumn(entities.TIMELINE, duration=time_s)
    for index, channel in enumerate(CHANNELS):
        _, factor = unit_of(TRIADS[index])
        for kind, values, colour in (
            ("before", before, _BEFORE),
            ("after", after, _COLOURS[index % 3]),
        ):
            entity = f"residual/{channel}/{kind}"
            recording.log(entity, rr.SeriesLines(colors=[colour], names=[kind]), static=True)
            column = rr.Scalars.columns(scalars=values[:, index] * factor)
            recording.send_columns(entity, indexes=[times], columns=column)
    for name, spans in where.items():
        _send_spans(recording, f"where/{rr.escape_entity_path_part(name)}", spans, time_s)
    recording.flush()
    recording.disconnect()


def _send_spans(
    recording: rr.RecordingStream, entity: str, spans: Sequence[Span], time_s: Floats
) -> None:
    """Send a state that names its regime inside the spans and is empty outside."""
    texts = sorted({text or "shows" for _, _, text in spans})
    values = [_QUIET, *texts]
    recording.log(
        entity,
        rr.StateConfiguration(
            values=values,
            labels=values,
            colors=np.array([_GREY] + [_SHOWS] * len(texts), np.uint32),
        ),
        static=True,
    )
    changes = [(float(time_s[0]), _QUIET)] if len(time_s) else []
    for start, stop, text in sorted(spans):
        changes += [(start, text or "shows"), (stop, _QUIET)]
    for at, text in changes:
        recording.set_time(entities.TIMELINE, duration=at)
        recording.log(entity, rr.StateChange(state=text))


def _whole(time_s: Floats) -> rrb.TimeAxis:
    """Return an axis that shows the whole recording."""
    if not len(time_s):
        return rrb.TimeAxis()
    first, last = (rrb.TimeRangeBoundary.absolute(seconds=t) for t in time_s[[0, -1]].tolist())
    return rrb.TimeAxis(view_range=rr.TimeRange(start=first, end=last))


def _blueprint(findings: list[str], pictures: list[str], axis: rrb.TimeAxis) -> rrb.Blueprint:
    plots = [
        rrb.TimeSeriesView(
            origin=f"residual/{channel}",
            name=f"{words(channel)} [{unit_of(triad)[0]}]: grey before, colour after",
            axis_x=axis,
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for triad, channel in zip(TRIADS, CHANNELS, strict=True)
    ]
    views = [
        rrb.Spatial2DView(origin=f"pictures/{rr.escape_entity_path_part(name)}", name=name)
        for name in pictures
    ]
    lower: list[rrb.View | rrb.Container] = []
    if findings:
        lower.append(
            rrb.StateTimelineView(origin="/where", name="When it is present", time_view=axis)
        )
    if views:
        lower.append(rrb.Tabs(*views))
    shares = [1.0, *([0.3] if findings else []), *([0.8] if views else [])]
    right = rrb.Vertical(rrb.Grid(*plots, grid_columns=3), *lower, row_shares=shares)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.TextDocumentView(origin="words", name="What was found"),
            right,
            column_shares=[0.45, 1.0],
        ),
        rrb.TimePanel(timeline=entities.TIMELINE, play_state="paused", state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )
