"""A whole recording as one .rrd file, with the entities and the layout of the live stream."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt
import rerun as rr

from ahrs_service.records import Rows
from ahrs_service.settings import GateSettings
from ahrs_service.viz import entities
from ahrs_service.viz.blueprint import blueprint
from ahrs_service.viz.rerun_columns import Columns
from ahrs_service.viz.scene import send_scene

Series = tuple[npt.ArrayLike, npt.ArrayLike]
Message = tuple[int, str, str]

_CHUNK: Final = 50_000


class Reference(Protocol):
    """An attitude to compare with: `time_ns` [N], `ned_from_body` [N, 4] wxyz."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def time_ns(self) -> npt.NDArray[np.int64]: ...  # noqa: D102
    @property
    def ned_from_body(self) -> npt.NDArray[np.float64]: ...  # noqa: D102


def write_rrd(
    path: str | Path,
    estimates: Rows,
    references: Sequence[Reference] = (),
    temperatures: Mapping[str, Series] | None = None,
    rates: Mapping[str, Series] | None = None,
    drops: Mapping[str, Series] | None = None,
    messages: Iterable[Message] = (),
    gate: GateSettings | None = None,
    readings: Rows | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write ESTIMATE rows and their companion data to `path`, whole and with a footer.

    The first of `references` is drawn as "theirs"; `temperatures` [degC], `rates` [Hz] and
    `drops` (counts) are (time_ns [N], values [N]) by name; `messages` are (time_ns, level, text);
    `gate` are the limits to which the gate's values are compared; `readings` [N], where given, are
    those behind the estimates, plotted raw next to them; `progress` is called with the share
    done, 0 to 1. All times on the clock of the estimates. Every row is in every series;
    only the 3D scene is thinned, to 25 Hz (see Columns).
    """
    path = Path(path)
    path.open("wb").close()
    layout = blueprint(live=False, shows_sensor=readings is not None)
    recording = rr.RecordingStream(entities.APPLICATION, recording_id=path.stem)
    recording.set_sinks(rr.FileSink(path), default_blueprint=layout)
    send_scene(recording)
    columns = Columns(recording, gate or GateSettings())
    for start in range(0, len(estimates), _CHUNK):
        part = slice(start, start + _CHUNK)
        raw = None if readings is None else _raw(readings[part])
        columns.estimates(estimates[part], raw)
        if progress is not None:
            progress(min(1.0, (start + _CHUNK) / len(estimates)))
    for index, reference in enumerate(references):
        t = columns.clock.whole(reference.time_ns)
        columns.reference(reference.name, t, reference.ned_from_body, drawn=index == 0)
    for send, named in (
        (columns.temperature, temperatures),
        (columns.rate, rates),
        (columns.drops, drops),
    ):
        for name, (time_ns, values) in (named or {}).items():
            t = columns.clock.whole(np.asarray(time_ns, np.int64))
            send(name, t, np.asarray(values, np.float64))
    lines = sorted(messages)
    stamps = columns.clock.whole(np.array([line[0] for line in lines], np.int64))
    columns.messages(stamps, [line[1] for line in lines], [line[2] for line in lines])
    recording.flush()
    recording.disconnect()


def _raw(readings: Rows) -> npt.NDArray[np.float64]:
    return np.concatenate([readings["gyro_rad_s"], readings["accel_m_s2"]], axis=1)
