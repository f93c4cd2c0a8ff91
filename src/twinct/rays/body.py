"""Closed bodies, and their shadows in the views of a scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.geometry.arrays import frozen


class PixelRectangle(NamedTuple):
    """Rectangle of pixels: rows and columns of a panel."""

    rows: slice
    columns: slice

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns; 0 if the rectangle is empty."""
        down, across = self
        return max(down.stop - down.start, 0), max(across.stop - across.start, 0)


class Shadow(NamedTuple):
    """Shadow of a body in one view.

    Attributes:
        box: the pixels of the arrays; rays outside it miss the body.
        lengths: path length of each ray inside the body, (rows, columns), mm.
        slopes: derivatives of the path lengths by a motion of the body along a twist (v, w) in its
            own axes, ``world_from_body @ Pose.exp(twist)``, (rows, columns, 6), mm per mm and rad.
    """

    box: PixelRectangle
    lengths: Floats
    slopes: Floats


@dataclass(frozen=True, eq=False)
class Body:
    """Closed body of triangles, in its own frame.

    Attributes:
        vertices: (vertices, 3), mm.
        faces: (faces, 3), counter-clockwise seen from outside.
    """

    vertices: Floats
    faces: NDArray[np.int64]

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        """Copy and freeze the arrays.

        Raises:
            InputError: the surface is open or inside out.
        """
        triangles = np.array(faces, dtype=np.int64)
        triangles.setflags(write=False)
        corners = np.asarray(vertices, dtype=np.float64)
        object.__setattr__(self, "vertices", frozen(corners, corners.shape, "vertices"))
        object.__setattr__(self, "faces", triangles)
        edges = np.concatenate([triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        there, back = (np.unique(way, axis=0) for way in (edges, edges[:, ::-1]))
        if len(there) != len(edges) or not np.array_equal(there, back):
            raise InputError("the mesh of a body is open: paths through it need a closed surface")
        a, b, c = (self.vertices[triangles[:, i]] for i in range(3))
        if np.einsum("ij,ij", a, np.cross(b, c)) <= 0:
            raise InputError("the mesh of a body is inside out: its normals must point outwards")

    @property
    def radius_mm(self) -> float:
        """Radius of the smallest sphere about the frame's origin that contains the body, mm."""
        return float(np.linalg.norm(self.vertices, axis=1).max())


class Rays:
    """Rays of a scan to its pixel centres, for intersection with bodies.

    Attributes:
        geometry: the views.
    """

    def __init__(self, geometry: ScanGeometry) -> None:
        """Compute the quantities that all shadows of a view share."""
        self.geometry, panel = geometry, geometry.panel
        column, row = panel.middle
        self._steps = np.stack([geometry.u * panel.pitch_u, geometry.v * panel.pitch_v], axis=1)
        to_panel = geometry.detector - geometry.source
        self._first = to_panel - column * self._steps[:, 0] - row * self._steps[:, 1]
        self._matrices = geometry.matrices()

    def box(
        self, body: Body, world_from_body: Pose, view: int, margin: float = 0
    ) -> PixelRectangle:
        """Return the pixels that a body may shade in a view, with a margin, within the panel.

        Raises:
            InputError: the body reaches the plane through the source parallel to the panel.
        """
        places, panel = self._places(body, world_from_body, view), self.geometry.panel
        low = np.clip(np.floor(places.min(axis=0) - margin), 0, (panel.columns, panel.rows))
        high = np.clip(np.ceil(places.max(axis=0) + margin) + 1, 0, (panel.columns, panel.rows))
        columns, rows = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        return PixelRectangle(rows, columns)

    def shadow(
        self,
        body: Body,
        world_from_body: Pose,
        view: int,
        *,
        slopes: bool = False,
        box: PixelRectangle | None = None,
    ) -> Shadow:
        """Return the path lengths of a view's rays inside a body, and their derivatives.

        A path length is the sum of the distances at which the ray leaves the body, less the sum at
        which it enters. If a facet with normal n moves by u where a ray along d meets it, the
        crossing moves along the ray by n u / (n d). With u = v + w x x for a twist, the derivatives
        are exact, except for rays that touch an edge.

        Args:
            body: shape of the body.
            world_from_body: pose of the body.
            view: number of the view.
            slopes: also compute the derivatives; otherwise they have no columns.
            box: requested pixels; by default all that the body may shade.

        Raises:
            InputError: as for ``box``.
        """
        box = box or self.box(body, world_from_body, view)
        lengths = np.zeros(box.shape)
        derivatives = np.zeros((*box.shape, 6 if slopes else 0))
        if lengths.size:
            # Imported late: reading the settings of algorithms must not need a compiler.
            from twinct.rays._plain import crossings

            turned = world_from_body.rotation  # its transpose maps the world to the body
            source = (self.geometry.source[view] - world_from_body.position) @ turned
            first, (across, up) = self._first[view] @ turned, self._steps[view] @ turned
            crossings(
                body.vertices - source,
                body.faces,
                self._places(body, world_from_body, view),
                source,
                first,
                across,
                up,
                (box.rows.start, box.columns.start),
                lengths,
                derivatives,
            )
        return Shadow(box, lengths, derivatives)

    def _places(self, body: Body, world_from_body: Pose, view: int) -> Floats:
        """Return the projections of the body's corners, (column, row), (vertices, 2)."""
        matrix = self._matrices[view] @ world_from_body.matrix
        column, row, depth = matrix[:, :3] @ body.vertices.T + matrix[:, 3:]
        if depth.min() <= 0:
            raise InputError(f"a body reaches behind the source of view {view}")
        return np.stack([column, row], axis=1) / depth[:, None]
