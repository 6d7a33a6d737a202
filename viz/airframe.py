"""The drawn aircraft: a small fixed wing made of lofted sections, body axes forward-right-down."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]
Colour = tuple[int, int, int]

PORT_RED: Final = (230, 40, 40)
STARBOARD_GREEN: Final = (30, 190, 70)
_WHITE: Final = (236, 240, 245)
_DARK: Final = (38, 50, 70)

# Sections: x [m] along the fuselage, half width, half height, height of the centre line (down +).
_FUSELAGE: Final = (
    (1.55, 0.02, 0.02, 0.02),
    (1.45, 0.12, 0.12, 0.02),
    (1.05, 0.21, 0.22, 0.00),
    (0.55, 0.25, 0.29, -0.03),
    (-0.10, 0.23, 0.26, -0.03),
    (-0.90, 0.12, 0.13, -0.04),
    (-1.80, 0.05, 0.06, -0.06),
)
_CANOPY: Final = (
    (0.85, 0.02, 0.02, -0.20),
    (0.62, 0.13, 0.12, -0.25),
    (0.25, 0.16, 0.16, -0.27),
    (-0.20, 0.02, 0.02, -0.24),
)


@dataclass(frozen=True, slots=True)
class Mesh:
    """Flat-shaded triangles: `positions`, `normals` [3 T, 3], `colours` [3 T, 3] uint8."""

    positions: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    colours: npt.NDArray[np.uint8]


def _ring(x: float, half_width: float, half_height: float, z: float) -> Points:
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    around = [np.full(16, x), half_width * np.cos(angle), z + half_height * np.sin(angle)]
    return np.stack(around, axis=-1)


def _aerofoil(
    leading: tuple[float, float, float], chord: float, thickness: float, below: float = 0.5
) -> Points:
    """Section of a horizontal surface [6, 3] behind its leading edge point."""
    along = np.array([0.0, 0.15, 0.45, 1.0, 0.45, 0.15])
    up = np.array([0.0, 0.8, 1.0, 0.0, -below, -0.8 * below])
    section = np.tile(np.asarray(leading, np.float64), (6, 1))
    section[:, 0] -= chord * along
    section[:, 2] -= 0.5 * thickness * up
    return section


def _fin(leading: tuple[float, float, float], chord: float, thickness: float) -> Points:
    """Section of an upright surface: an aerofoil that lies on its side."""
    section = _aerofoil((0.0, 0.0, 0.0), chord, thickness, below=1.0)
    return section[:, [0, 2, 1]] + np.asarray(leading)


def _loft(sections: list[Points]) -> Points:
    """Triangles [T, 3, 3] of the skin through `sections`, ends closed, seen from outside."""
    triangles = []
    for a, b in pairwise(sections):
        a1, b1 = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
        skin = np.concatenate([np.stack([a, a1, b], axis=1), np.stack([a1, b1, b], axis=1)])
        triangles.append(_outward(skin, np.concatenate([a, b]).mean(axis=0)))
    for end in (sections[0], sections[-1]):
        centre = np.broadcast_to(end.mean(axis=0), end.shape)
        cap = np.stack([centre, np.roll(end, -1, axis=0), end], axis=1)
        triangles.append(_outward(cap, sections[len(sections) // 2].mean(axis=0)))
    return np.concatenate(triangles)


def _outward(triangles: Points, inside: Points) -> Points:
    """Wind `triangles` [T, 3, 3] counter-clockwise as seen from away of the point `inside` [3]."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    away = triangles.mean(axis=1) - inside
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), away) < 0.0
    return np.where(inward[:, None, None], triangles[:, ::-1], triangles)


def _wing(side: int) -> list[tuple[Points, Colour | None]]:
    def at(y: float, x: float, z: float, chord: float, thickness: float) -> Points:
        return _aerofoil((x, side * y, z), chord, thickness)

    light = STARBOARD_GREEN if side > 0 else PORT_RED
    main = [at(0.0, 0.55, -0.16, 0.66, 0.11), at(1.95, 0.36, -0.27, 0.42, 0.06)]
    tip = [at(1.95, 0.36, -0.27, 0.42, 0.06), at(2.15, 0.28, -0.30, 0.24, 0.03)]
    tail = [at(0.0, -1.40, -0.08, 0.40, 0.05), at(0.72, -1.52, -0.10, 0.26, 0.03)]
    return [(_loft(main), None), (_loft(tip), light), (_loft(tail), None)]


def aircraft(paint: Colour) -> Mesh:
    """Return the aircraft with wings and tail in `paint` and lights on the wing tips [m]."""
    fin = [_fin((-1.25, 0.0, -0.06), 0.55, 0.06), _fin((-1.62, 0.0, -0.80), 0.26, 0.03)]
    parts: list[tuple[Points, Colour | None]] = [
        (_loft([_ring(*station) for station in _FUSELAGE]), _WHITE),
        (_loft([_ring(*station) for station in _CANOPY]), _DARK),
        (_loft(fin), None),
        *_wing(1),
        *_wing(-1),
    ]
    positions, colours = [], []
    for triangles, colour in parts:
        positions.append(triangles.reshape(-1, 3))
        colours.append(np.tile(np.array(colour or paint, np.uint8), (3 * len(triangles), 1)))
    corners = np.concatenate(positions)
    return Mesh(corners.astype(np.float32), _normals(corners), np.concatenate(colours))


def _normals(corners: Points) -> npt.NDArray[np.float32]:
    """Unit normals [3 T, 3] of triangles, one for all three corners."""
    a, b, c = corners[0::3], corners[1::3], corners[2::3]
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    return np.repeat(normal, 3, axis=0).astype(np.float32)
