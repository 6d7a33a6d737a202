"""What stands still in the viewer: the drawn aircraft, the compass, names and colours of series."""

from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

from ahrs_service.viz import entities, state_lanes
from ahrs_service.viz.airframe import aircraft
from ahrs_service.viz.entities import X_FAINT, Y_FAINT, Z_FAINT, X, Y, Z

FORCE_SCALE: Final = 2.6
"""Drawn length of one g [m]."""

_PALE: Final = 0x9AA7B8FF
_BRIGHT: Final = 0xF4F5F7FF
_COMPASS_RADIUS: Final = 3.0
_GROUND: Final = 2.0


def send_scene(recording: rr.RecordingStream) -> None:
    """Send everything static but what belongs to a reference."""
    _aircraft(recording)
    _compass(recording)
    _series(recording)
    recording.log(
        entities.GATE,
        rr.StateConfiguration(
            values=state_lanes.GATE_TEXTS,
            labels=[text.removeprefix("closed: ") for text in state_lanes.GATE_TEXTS],
            colors=_rgba(*state_lanes.GATE_COLOURS),
        ),
        static=True,
    )
    for entity, texts, colours in (
        (entities.TRUST, state_lanes.TRUST_TEXTS, state_lanes.TRUST_COLOURS),
        (entities.SAMPLE, ("good",), (state_lanes.GREEN,)),
    ):
        look = rr.StateConfiguration(values=texts, labels=texts, colors=_rgba(*colours))
        recording.log(entity, look, static=True)


def send_reference(recording: rr.RecordingStream, entity: str, name: str, drawn: bool) -> None:
    """Send the look of another estimator's attitude: pale lines, and if `drawn` a grey ghost."""
    names = [f"{angle} {name}" for angle in ("roll", "pitch", "heading")]
    _style(recording, entity, names, [X_FAINT, Y_FAINT, Z_FAINT], 1.25)
    if drawn:
        mesh = aircraft(entities.THEIRS_PAINT)
        ghost = rr.Mesh3D(
            vertex_positions=mesh.positions,
            vertex_normals=mesh.normals,
            albedo_factor=(*entities.THEIRS_PAINT, 90),
        )
        recording.log(f"{entities.THEIRS}/airframe", ghost, static=True)


def _rgba(*colours: int) -> npt.NDArray[np.uint32]:
    return np.array(colours, np.uint32)


def _aircraft(recording: rr.RecordingStream) -> None:
    recording.log(entities.WORLD, rr.ViewCoordinates.FRD, static=True)
    mesh = aircraft(entities.OURS_PAINT)
    shape = rr.Mesh3D(
        vertex_positions=mesh.positions,
        vertex_normals=mesh.normals,
        vertex_colors=mesh.colours,
    )
    recording.log(f"{entities.OURS}/airframe", shape, static=True)
    axes = rr.Arrows3D(
        vectors=[[2.3, 0.0, 0.0], [0.0, 2.6, 0.0]],
        colors=_rgba(X, Y),
        radii=0.018,
        labels=["x", "y"],
    )
    recording.log(f"{entities.OURS}/axes", axes, static=True)
    force = rr.Arrows3D.from_fields(radii=[0.05], show_labels=True)
    recording.log(entities.OURS, force, static=True)
    gravity = rr.Arrows3D(vectors=[[0.0, 0.0, FORCE_SCALE]], colors=_rgba(_BRIGHT), radii=[0.03])
    recording.log(entities.GRAVITY, gravity, static=True)


def _compass(recording: rr.RecordingStream) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(73)], axis=1)
    ticks = [np.stack([k * ring[i] for k in (0.93, 1.0)]) for i in range(0, 72, 6)]
    strips = [_COMPASS_RADIUS * strip + [0.0, 0.0, _GROUND] for strip in (ring, *ticks)]
    recording.log(
        f"{entities.NED}/compass",
        rr.LineStrips3D(strips, colors=_rgba(_PALE), radii=rr.Radius.ui_points(1.2)),
        static=True,
    )
    disc = rr.Mesh3D(
        vertex_positions=_COMPASS_RADIUS * ring + [0.0, 0.0, _GROUND + 0.01],
        triangle_indices=[[0, i, i + 1] for i in range(1, 71)],
        albedo_factor=(60, 82, 66, 150),
    )
    recording.log(f"{entities.NED}/ground", disc, static=True)
    names = rr.Points3D(
        positions=0.85 * _COMPASS_RADIUS * ring[[0, 18, 36, 54]] + [0.0, 0.0, _GROUND],
        labels=["N", "E", "S", "W"],
        colors=_rgba(X, *[_PALE] * 3),
        radii=0.01,
        show_labels=True,
    )
    recording.log(f"{entities.NED}/compass/names", names, static=True)


def _style(
    recording: rr.RecordingStream,
    entity: str,
    names: list[str],
    colours: list[int],
    width: float = 1.5,
) -> None:
    lines = rr.SeriesLines(names=names, colors=_rgba(*colours), widths=[width] * len(names))
    recording.log(entity, lines, static=True)


def _series(recording: rr.RecordingStream) -> None:
    ours = ["roll", "pitch", "heading"]
    _style(recording, f"{entities.ATTITUDE}/ours", ours, [X, Y, Z], 2.0)
    _style(recording, entities.SIGMA, ["north", "east", "down"], [X, Y, Z])
    _style(recording, entities.RESIDUAL, ["x", "y", "z"], [X, Y, Z])
    _style(recording, entities.INNOVATION, ["x", "y", "z"], [X, Y, Z])
    for raw in (entities.RAW_RATE, entities.RAW_FORCE):
        _style(recording, raw, ["x raw", "y raw", "z raw"], [X_FAINT, Y_FAINT, Z_FAINT])
    for used in (
        entities.USED_RATE,
        entities.USED_FORCE,
        entities.RATE_CORRECTION,
        entities.FORCE_CORRECTION,
    ):
        _style(recording, used, ["x", "y", "z"], [X, Y, Z])
    bias = rr.SeriesLines(
        names=["x", "y", "z", *(f"{axis} {sign} sigma" for sign in "-+" for axis in "xyz")],
        colors=_rgba(X, Y, Z, *[X_FAINT, Y_FAINT, Z_FAINT] * 2),
        widths=[1.75] * 3 + [0.75] * 6,
    )
    recording.log(entities.BIAS, bias, static=True)
    reasons = ["norm", "rate", "ang. accel.", "innovation", "limit"]
    hues = [state_lanes.AMBER, Z, entities.VIOLET, state_lanes.ORANGE, state_lanes.RED]
    _style(recording, entities.LOAD, reasons, hues)
