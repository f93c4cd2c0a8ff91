"""Soft tissue around the built-in skull: the head with its airways, and the brain.

Both are built in the skull's design frame and moved like the skull, so that the three parts fit
together at one pose. List the skull last: where parts overlap, the later one wins.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy

from twinct.specimen.canvas import Canvas
from twinct.specimen.implicit import ImplicitSolid, block, ellipsoid, rod
from twinct.specimen.skull import WALL_MM, ear_canal, orbit, skull_canvas, vault
from twinct.specimen.surface import surface

if TYPE_CHECKING:
    import trimesh

MIDDLE = np.array([0.0, 1.7, -35.5])
"""Middle of the skull's bounds in its design frame, mm."""

SKIN_MM = 5.0
"""Distance from the outermost bone to the skin."""

BRIDGE_MM = 40.0
"""Radius of a ball that rolls over the bones and enters neither orbits nor hollows of the cheeks.

The skin runs along the ball's surface, SKIN_MM further out (a morphological closing).
"""


def head_surface(scale: float = 1.0, resolution_mm: float = 2.0) -> trimesh.Trimesh:
    """Return the closed surface of a head down to the chin: skin, nasal cavity, sinuses and throat.

    Args:
        scale: 1 is adult size, as for the skull.
        resolution_mm: cell of the lattice for the surface extraction, mm of the scaled head.
    """
    return _head(float(scale), float(resolution_mm)).copy()


def brain_surface(scale: float = 1.0, resolution_mm: float = 2.0) -> trimesh.Trimesh:
    """Return the closed surface of the braincase's content, up to the middle of the wall.

    Args:
        scale: 1 is adult size, as for the skull.
        resolution_mm: cell of the lattice for the surface extraction, mm of the scaled brain.
    """
    return _brain(float(scale), float(resolution_mm)).copy()


@lru_cache(maxsize=2)
def _head(scale: float, resolution_mm: float) -> trimesh.Trimesh:
    head = head_canvas(resolution_mm / scale)
    head.draw(*(airway.cut(2) for airway in airways()))
    return _placed(head, scale)


@lru_cache(maxsize=2)
def _brain(scale: float, resolution_mm: float) -> trimesh.Trimesh:
    return _placed(brain_canvas(resolution_mm / scale), scale)


def head_canvas(step: float) -> Canvas:
    """Return the head without its airways on half a lattice, in the skull's design frame."""
    head = skull_canvas(step, margin_mm=BRIDGE_MM + 2 * SKIN_MM)
    nose = rod((0, 84, -34), (0, 97, -60), 4, 6)
    neck = rod((0, -26, -60), (0, -22, -160), 52, flatten=(1, 1.15, 1))
    head.draw(vault(), nose, neck.within(block((0, -24, -98), (60, 60, 40))))
    # Distances refer to the middles of voxels: voxels that bone reaches into count as bone.
    away = scipy.ndimage.distance_transform_edt(head.mirrored >= step / 2, sampling=step)
    depth = scipy.ndimage.distance_transform_edt(away < BRIDGE_MM, sampling=step)
    outside = scipy.ndimage.gaussian_filter(BRIDGE_MM - SKIN_MM - depth, 1.0)
    head.field = np.asarray(outside[len(head.field) - 1 :], np.float32)
    return head


def brain_canvas(step: float) -> Canvas:
    """Return the brain on half a lattice, in the skull's design frame."""
    outer = vault()
    brain = Canvas(step, outer.low * (0, 1, 1), outer.high)
    inner = ImplicitSolid(lambda x, y, z: outer(x, y, z) + WALL_MM / 2, outer.low, outer.high)
    brain.draw(inner, orbit(1.6).cut(), ear_canal(1.5).cut())
    return brain


def airways() -> tuple[ImplicitSolid, ...]:
    """Return the airways; they leave about 1.5 mm of mucosa on the bone."""
    return (
        ellipsoid((6, 52, -52), (6.5, 21.5, 15.5)),  # nasal cavity with both openings
        rod((5, 66, -63), (5, 112, -66), 4, 3.5),
        rod((6.5, 62, -60), (4, 16, -62), 4.5, 6),
        ellipsoid((27, 63, -63), (8, 11.5, 8.5)),  # maxillary sinus
        rod((0, 15, -62), (0, 14, -160), 8, 9, flatten=(0.8, 1, 1)),  # throat
        ear_canal(-1.0),
    )


def _placed(canvas: Canvas, scale: float) -> trimesh.Trimesh:
    mesh = canvas.surface()
    return surface((mesh.vertices - MIDDLE) * scale, mesh.faces)
