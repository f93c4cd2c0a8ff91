"""Convex bodies that together hold a solid, for collisions with a patient's skin.

A solid is cut in two by the plane, across one of the axes, that takes most volume off the convex
hulls, then the piece that gains most from the next cut, and so on. All cuts are chosen on a coarse
copy of the surface. The hulls are those of the whole surface, so that nothing reaches out of them:
the boundary of a piece's hull touches either the surface itself or the rim of a cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import Floats
from twinct.specimen.sketch import sketch

if TYPE_CHECKING:
    import trimesh

MOST_PARTS = 8
"""Largest number of convex bodies of one solid."""

LEAST_GAIN = 0.02
"""Share of the hull's volume that a cut takes off at least."""

CELLS = 24
"""Cells along the longest edge of the coarse copy."""

SHARES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Places of the planes that are tried, as shares of a piece's extent."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """Surface of a solid between some planes, without the faces on the planes.

    Attributes:
        vertices: (vertices, 3), mm.
        faces: (faces, 3).
    """

    vertices: Floats
    faces: NDArray[np.int64]

    @cached_property
    def volume(self) -> float:
        """Volume of the convex hull, mm^3; 0 if it is flat."""
        try:
            return float(scipy.spatial.ConvexHull(self.vertices).volume)
        except (scipy.spatial.QhullError, ValueError):
            return 0.0

    @cached_property
    def best_cut(self) -> tuple[float, int, float]:
        """Gain in volume, mm^3, axis and place, mm, of the best plane."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        tried = [
            (float(low[axis] + share * (high[axis] - low[axis])), axis)
            for axis in range(3)
            for share in SHARES
        ]
        gains = [self.volume - sum(p.volume for p in self.cut(a, at)) for at, a in tried]
        best = int(np.argmax(gains))
        return gains[best], tried[best][1], tried[best][0]

    def cut(self, axis: int, at: float) -> tuple[_Piece, _Piece]:
        """Return the pieces below and above a plane across an axis."""
        from trimesh.intersections import slice_faces_plane

        origin, normal = np.zeros(3), np.zeros(3)
        origin[axis], normal[axis] = at, -1.0
        sides = (
            slice_faces_plane(self.vertices, self.faces, sign * normal, origin) for sign in (1, -1)
        )
        below, above = (_Piece(vertices, faces) for vertices, faces, *_ in sides)
        return below, above


def convex_parts(mesh: trimesh.Trimesh) -> list[Floats]:
    """Return points whose convex hulls together hold the solid within a closed surface.

    Args:
        mesh: the surface, mm.

    Returns:
        The points of each convex body, (points, 3), mm: 1 to ``MOST_PARTS`` bodies.
    """
    rough = sketch(mesh, CELLS)
    coarse = [_Piece(np.asarray(rough.vertices), np.asarray(rough.faces, np.int64))]
    fine = [_Piece(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64))]
    least = LEAST_GAIN * coarse[0].volume
    while len(coarse) < MOST_PARTS:
        gains = [piece.best_cut[0] for piece in coarse]
        which = int(np.argmax(gains))
        if gains[which] < least:
            break
        _, axis, at = coarse[which].best_cut
        coarse[which : which + 1] = coarse[which].cut(axis, at)
        fine[which : which + 1] = fine[which].cut(axis, at)
    return [piece.vertices for piece in fine]
