"""Estimates and related data as Rerun columns, for live and replay alike."""

from collections.abc import Iterable
from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.records import Flag, Gate, Phase, Rows
from ahrs_service.rotation import euler_columns
from ahrs_service.settings import GateSettings
from ahrs_service.viz import entities, state_lanes
from ahrs_service.viz.clock import Clock, Nanoseconds
from ahrs_service.viz.scene import FORCE_SCALE, send_reference

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

SCENE_PERIOD_NS: Final = 40_000_000
SECOND_NS: Final = 1_000_000_000
USED_TEMPERATURE: Final = "IMU used"
USED_RATE: Final = "samples used"
_AFTER_NS: Final = 1000

_SCALARS: Final = rr.Scalars.descriptor_scalars()
_QUATERNION: Final = rr.Transform3D.descriptor_quaternion()
_VECTORS: Final = rr.Arrows3D.descriptor_vectors()
_COLOURS: Final = rr.Arrows3D.descriptor_colors()
_LABELS: Final = rr.Arrows3D.descriptor_labels()


class Columns:
    """Converts ESTIMATE rows to the viewer's columns; keeps state between calls.

    Every row goes into every series but two: the 3D scene (the attitude is whole in its series)
    takes the first row of each 40 ms, the IMU's temperature the first of each second. Angles
    in deg, rates in deg/s, specific force in m/s^2.
    """

    def __init__(self, recording: rr.RecordingStream, gate: GateSettings) -> None:
        self.clock = Clock()
        self.gate = gate
        self._recording = recording
        self._gate_changes = state_lanes.Changes()
        self._flag_changes = state_lanes.Changes()
        self._scene_changes = {
            entities.OURS: state_lanes.Changes(),
            entities.THEIRS: state_lanes.Changes(),
        }
        self._second_changes = state_lanes.Changes()
        self._last_ns: int | None = None
        self._trust_changes = state_lanes.Changes()
        self._mark: Nanoseconds | None = None
        self._counted = self._opened = 0
        self._styled: set[str] = set()
        self._time_of: Nanoseconds | None = None

    def estimates(self, rows: Rows, raw: Floats | None = None) -> None:
        """Send ESTIMATE rows [N] in order, together with the sensor's readings.

        `raw` [N, 6] rate [rad/s] and specific force [m/s^2], NaN where it is not to be shown.
        """
        if len(rows) == 0:
            return
        t = self.clock.estimates(rows)
        if raw is not None:
            self._sensor(rows, t, raw)
        euler = np.degrees(euler_columns(rows["ned_from_body"]))
        bias = np.degrees(rows["gyro_bias_rad_s"])
        sigma = np.degrees(rows["gyro_bias_sigma_rad_s"])
        self._scalars(f"{entities.ATTITUDE}/ours", t, _with_heading(euler))
        self._scalars(entities.SIGMA, t, np.degrees(rows["attitude_sigma_rad"]))
        self._scalars(entities.RESIDUAL, t, rows["residual_m_s2"])
        self._scalars(entities.INNOVATION, t, np.degrees(rows["innovation_rad"]))
        band = np.concatenate([bias, bias - sigma, bias + sigma], axis=1)
        self._scalars(entities.BIAS, t, band)
        self._scalars(entities.LOAD, t, self._load(rows))
        second = self._second_changes.of(t // SECOND_NS)
        self.temperature(USED_TEMPERATURE, t[second], rows["temperature_degc"][second])
        self._each_second(t, second, rows["gate"])
        self._states(rows, t)
        self._scene(rows, t, euler[:, 2])
        self._last_ns = int(t[-1])

    def _sensor(self, rows: Rows, t: Nanoseconds, raw: Floats) -> None:
        """Send raw output, what is used of it, and the difference, which compensation took away."""
        shown = np.flatnonzero(~np.isnan(raw).all(axis=1))
        if len(shown) < len(rows):
            rows, t, raw = rows[shown], t[shown], raw[shown]
        for measured, used, entity_raw, entity_used, entity_correction in (
            (
                np.degrees(raw[:, :3]),
                np.degrees(rows["rate_rad_s"]),
                entities.RAW_RATE,
                entities.USED_RATE,
                entities.RATE_CORRECTION,
            ),
            (
                raw[:, 3:],
                rows["accel_m_s2"],
                entities.RAW_FORCE,
                entities.USED_FORCE,
                entities.FORCE_CORRECTION,
            ),
        ):
            self._scalars(entity_raw, t, measured)
            self._scalars(entity_used, t, used)
            self._scalars(entity_correction, t, measured - used)

    def reference(
        self, name: str, t: Nanoseconds, ned_from_body: Floats, drawn: bool = True
    ) -> None:
        """Send the attitude [N, 4] of the estimator `name`; if `drawn` it is "theirs" in 3D too."""
        entity = f"{entities.ATTITUDE}/{'theirs' if drawn else rr.escape_entity_path_part(name)}"
        if entity not in self._styled:
            self._styled.add(entity)
            send_reference(self._recording, entity, name, drawn)
        euler = np.degrees(euler_columns(ned_from_body))
        self._scalars(entity, t, _with_heading(euler))
        if drawn:
            kept = self._thinned(entities.THEIRS, t, ned_from_body)
            self._transform(entities.THEIRS, t[kept], ned_from_body[kept])

    def temperature(self, site: str, t: Nanoseconds, degc: Floats) -> None:
        """Send the temperature [N] [degC] of one site."""
        self._named(entities.TEMPERATURE, site, t, degc)

    def rate(self, name: str, t: Nanoseconds, hertz: Floats) -> None:
        """Send the rate [N] [Hz] of one message."""
        self._named(entities.RATES, name, t, hertz)

    def drops(self, name: str, t: Nanoseconds, count: Floats) -> None:
        """Send how many [N] of something were lost so far."""
        self._named(entities.DROPS, name, t, count)

    def messages(self, t: Nanoseconds, levels: list[str], texts: list[str]) -> None:
        """Send lines of the log."""
        if texts:
            columns = rr.TextLog.columns(text=texts, level=levels)
            self._send(entities.LOG, t, columns)

    def _named(self, folder: str, name: str, t: Nanoseconds, values: Floats) -> None:
        entity = f"{folder}/{rr.escape_entity_path_part(name)}"
        if entity not in self._styled:
            self._styled.add(entity)
            self._recording.log(entity, rr.SeriesLines(names=name, widths=1.5), static=True)
        self._scalars(entity, t, np.asarray(values, np.float64))

    def _send(self, entity: str, t: Nanoseconds, columns: Iterable[rr.ComponentColumn]) -> None:
        if t is not self._time_of:
            stamps = t.astype("timedelta64[ns]")
            self._time, self._time_of = rr.TimeColumn(entities.TIMELINE, duration=stamps), t
        self._recording.send_columns(entity, [self._time], columns)

    def _scalars(self, entity: str, t: Nanoseconds, values: Floats) -> None:
        if len(t):
            batch = rr.components.ScalarBatch(np.ascontiguousarray(values).ravel())
            self._send(entity, t, [_column(_SCALARS, batch, len(t), values.size // len(t))])

    def _load(self, rows: Rows) -> Floats:
        """What the gate compared as shares of its limits, and the limit 1 that closes it [N, 5]."""
        return np.stack(
            [
                rows["gate_norm_m_s2"] / self.gate.norm_m_s2,
                rows["gate_rate_rad_s"] / self.gate.rate_rad_s,
                rows["gate_angular_acceleration_rad_s2"] / self.gate.angular_acceleration_rad_s2,
                rows["gate_innovation"] / self.gate.innovation_sigma,
                np.ones(len(rows)),
            ],
            axis=1,
        )

    def _each_second(self, t: Nanoseconds, second: Indices, gate: npt.NDArray[np.uint32]) -> None:
        """At the first sample of each second report the rate and trust of the last second.

        The trust is stamped where its second began.
        """
        opened = np.concatenate([[0], np.cumsum(gate == Gate.OPEN)]) + self._opened
        index = np.arange(len(t)) + self._counted
        marks = np.stack([t, index, opened[:-1]], axis=1)[second]
        if self._mark is not None:
            marks = np.concatenate([self._mark, marks])
        self._mark, self._counted, self._opened = marks[-1:], index[-1] + 1, opened[-1]
        span_ns, count, opened = np.diff(marks, axis=0).T
        ahead = span_ns > 0
        self.rate(USED_RATE, marks[1:, 0][ahead], count[ahead] * 1e9 / span_ns[ahead])
        codes = state_lanes.trust_codes(opened / count)
        changed = self._trust_changes.of(codes)
        texts = [state_lanes.TRUST_TEXTS[code] for code in codes[changed]]
        self._state(entities.TRUST, marks[:-1, 0][changed], texts)

    def _states(self, rows: Rows, t: Nanoseconds) -> None:
        """Send changes of state; a gap begins just after the last sample before it."""
        codes, times = state_lanes.gate_codes(rows), t
        gaps = np.flatnonzero(rows["flags"] & Flag.GAP)
        if len(gaps):
            before = np.concatenate([[t[0] if self._last_ns is None else self._last_ns], t[:-1]])
            codes = np.insert(codes, gaps, state_lanes.GAP)
            times = np.insert(t, gaps, np.minimum(before[gaps] + _AFTER_NS, t[gaps]))
        changed = self._gate_changes.of(codes)
        texts = [state_lanes.GATE_TEXTS[code] for code in codes[changed]]
        self._state(entities.GATE, times[changed], texts)
        flags = rows["flags"].astype(np.int64)
        changed = self._flag_changes.of(flags)
        self._state(
            entities.SAMPLE, t[changed], [state_lanes.flag_text(int(f)) for f in flags[changed]]
        )

    def _state(self, entity: str, t: Nanoseconds, texts: list[str]) -> None:
        if texts:
            columns = rr.StateChange.columns(state=texts)
            self._send(entity, t, columns)

    def _scene(self, rows: Rows, t: Nanoseconds, yaw_deg: Floats) -> None:
        kept = self._thinned(entities.OURS, t, rows["ned_from_body"])
        rows, t, half = rows[kept], t[kept], np.radians(yaw_deg[kept]) / 2.0
        if len(t) == 0:
            return
        still = np.zeros_like(half)
        heading_up = np.stack([np.cos(half), still, still, -np.sin(half)], axis=1)
        self._transform(entities.NED, t, heading_up)
        trusted = (rows["gate"] == Gate.OPEN) & (rows["phase"] == Phase.RUNNING)
        force = np.nan_to_num(rows["accel_m_s2"]) * (FORCE_SCALE / STANDARD_GRAVITY_M_S2)
        colours = np.where(trusted, state_lanes.GREEN, state_lanes.RED).astype(np.uint32)
        labels = [state_lanes.GATE_TEXTS[code] for code in state_lanes.gate_codes(rows)]
        columns = [
            _rotation(rows["ned_from_body"]),
            _column(_VECTORS, rr.components.Vector3DBatch(-force), len(t)),
            _column(_COLOURS, rr.components.ColorBatch(colours), len(t)),
            _column(_LABELS, rr.components.TextBatch(labels), len(t)),
        ]
        self._send(entities.OURS, t, columns)

    def _thinned(self, entity: str, t: Nanoseconds, attitude: Floats) -> Indices:
        kept = self._scene_changes[entity].of(t // SCENE_PERIOD_NS)
        finite: Indices = kept[np.isfinite(attitude[kept]).all(axis=1)]
        return finite

    def _transform(self, entity: str, t: Nanoseconds, rotation: Floats) -> None:
        if len(t):
            self._send(entity, t, [_rotation(rotation)])


def _column(
    descriptor: rr.ComponentDescriptor, batch: rr.ComponentBatchLike, rows: int, width: int = 1
) -> rr.ComponentColumn:
    """One component for `rows` rows of `width` each.

    The same as the archetype's own `columns`, at half its cost for the few rows of a live period.
    """
    offsets = np.arange(0, rows * width + 1, width, dtype=np.int32)
    return rr.ComponentColumn(descriptor, batch, offsets=offsets)


def _rotation(wxyz: Floats) -> rr.ComponentColumn:
    batch = rr.components.RotationQuatBatch(wxyz[:, [1, 2, 3, 0]])
    return _column(_QUATERNION, batch, len(wxyz))


def _with_heading(euler_deg: Floats) -> Floats:
    """Roll, pitch and, for yaw, the heading 0 to 360 deg [N, 3]."""
    return np.concatenate([euler_deg[:, :2], euler_deg[:, 2:] % 360.0], axis=1)
