"""Convex bodies that together hold a solid: what collides in its place.

CoACD (Wei, Liu, Ling and Su, "Approximate convex decomposition for 3D meshes with collision-aware
concavity and tree search", 2022) chooses the cuts, on a copy with fewer triangles. Whatever of the
solid its parts leave uncovered is added to the nearest part, so that no surface is outside by more
than a rounding.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import manifold3d
import numpy as np
from numpy.typing import NDArray

from twinct.core.disk_cache import made_once
from twinct.core.extras import require
from twinct.geometry import Floats
from twinct.specimen.surface import from_manifold, surface, to_manifold

if TYPE_CHECKING:
    import trimesh

ENOUGH_MM = 10.0
"""Gap up to which one hull is enough: the default of ``motion.clearance_mm``, kept anyway."""

CONCAVITY, LEAST_MM = 0.05, 20.0
"""Depth of a hollow below which a part is not cut: share of half the longest edge, and at least mm.

The share is CoACD's default. From a sweep (benchmarks/bench_convex_parts.py): at 20 mm, the walls
of a room are 254 bodies, at the share 7; at 10 mm, a head is 13 bodies, at 20 mm 5, with gaps only
0.6 mm larger.
"""

TOLERANCE = 0.1
"""Distance by which the copy with fewer triangles may leave the solid, over the concavity."""

ITERATIONS, PLANES = 30, 10
"""Steps of CoACD's tree search for each cut, and cuts that a node of the tree offers.

At CoACD's defaults, 150 and 20, a head takes twice as long for bodies that are 0.4 % smaller.
"""

CONVEX = 1e-6
"""Share of a hull's volume that a convex solid may lack: rounding of single precision in files."""

ROUNDING_MM = 1e-3
"""Distance by which a solid may reach out of its bodies, and thickness of films between both."""

KEPT = 64
"""Solids whose parts are kept on disk for later processes."""

SAMPLES = 100
"""Distances between samples, along the longest edge, with which the largest gap is measured."""


@dataclass(frozen=True)
class Fit:
    """Closeness of convex bodies to a solid.

    Attributes:
        bodies: number of bodies.
        volume: volume of all bodies together, over that of the solid.
        gap_mm: largest distance of a point of the bodies from the solid.
    """

    bodies: int
    volume: float
    gap_mm: float

    @property
    def words(self) -> str:
        """Sentence part for a finding."""
        bodies = "1 convex body" if self.bodies == 1 else f"{self.bodies} convex bodies"
        return f"{bodies}, {self.volume - 1:.1%} too large, largest gap {self.gap_mm:.0f} mm"


def convex_parts(
    mesh: trimesh.Trimesh, concavity_mm: float | None = None
) -> tuple[trimesh.Trimesh, ...]:
    """Return convex bodies that hold the solid within a closed surface; one if it is nearly convex.

    Args:
        mesh: the surface, mm.
        concavity_mm: depth of a hollow below which a part is not cut; ``CONCAVITY`` by default.

    Raises:
        MissingExtraError: CoACD is not installed.
    """
    hull, solid = mesh.convex_hull, to_manifold(mesh)
    if solid.is_empty() or hull.volume - solid.volume() <= CONVEX * hull.volume:
        return (hull,)
    if fit_of(mesh, (hull,)).gap_mm <= ENOUGH_MM:
        return (hull,)
    if concavity_mm is None:
        concavity_mm = max(LEAST_MM, CONCAVITY * float(mesh.extents.max()) / 2)
    require("robots")
    libraries = [f"{name} {version(name)}".encode() for name in ("coacd", "manifold3d", "scipy")]
    inputs = [
        Path(__file__).read_bytes(),
        *libraries,
        repr(concavity_mm).encode(),
        np.asarray(mesh.vertices, np.float64).tobytes(),
        np.asarray(mesh.faces, np.int64).tobytes(),
    ]
    arrays = made_once("convex", inputs, lambda: _arrays(_cut(solid, concavity_mm)), keep=KEPT)
    return tuple(
        surface(arrays[f"{part}.vertices"], arrays[f"{part}.faces"])
        for part in range(len(arrays) // 2)
    )


def pieces_or_hull(mesh: trimesh.Trimesh, most: int) -> list[trimesh.Trimesh]:
    """Return the convex hulls of a mesh's connected pieces, or of the whole if they are many.

    Pieces inside the hull of a larger one, such as screws, do not count. The mesh may be open.
    """
    import trimesh

    hulls: list[trimesh.Trimesh] = []
    whole = mesh.convex_hull
    least = CONVEX * whole.volume
    for points in _pieces(mesh):
        try:
            hull = trimesh.convex.convex_hull(points)
        except Exception:  # a flat piece has none
            return [whole]
        if hull.volume <= least:
            continue
        if any(beyond(other, hull.vertices).max() <= 1e-6 for other in hulls):
            continue
        hulls.append(hull)
        if len(hulls) > most:
            return [whole]
    return hulls or [whole]


def beyond(hull: trimesh.Trimesh, points: Floats) -> Floats:
    """Return how far points (n, 3) lie outside the planes of a convex body; negative inside."""
    normals = hull.face_normals
    return (points @ normals.T - np.einsum("ij,ij->i", normals, hull.triangles[:, 0])).max(axis=1)


def fit_of(mesh: trimesh.Trimesh, bodies: Sequence[trimesh.Trimesh]) -> Fit:
    """Measure how closely convex bodies hold the solid within a closed surface.

    The gap is too large by at most the distance between samples.
    """
    from scipy.spatial import cKDTree

    solid, together = to_manifold(mesh), _union(bodies)
    step = float(mesh.extents.max()) / SAMPLES
    free = together - solid
    if free.is_empty() or not solid.volume():
        return Fit(len(bodies), 1.0, 0.0)
    near = cKDTree(from_manifold(solid.refine_to_length(step)).vertices)
    gaps, _ = near.query(from_manifold(free.refine_to_length(step)).vertices)
    return Fit(len(bodies), together.volume() / solid.volume(), float(np.max(gaps)))


def _cut(solid: manifold3d.Manifold, concavity_mm: float) -> list[trimesh.Trimesh]:
    """Return the convex hulls of CoACD's parts, which hold the whole solid."""
    import coacd
    import trimesh

    coacd.set_log_level("off")
    few = from_manifold(solid.simplify(TOLERANCE * concavity_mm))
    parts = coacd.run_coacd(
        coacd.Mesh(few.vertices, few.faces),
        threshold=concavity_mm,
        real_metric=True,
        mcts_iterations=ITERATIONS,
        mcts_nodes=PLANES,
        seed=0,
    )
    hulls = [trimesh.convex.convex_hull(vertices) for vertices, _ in parts]
    uncovered = manifold3d.Manifold.compose(
        [
            piece
            for piece in (solid - _union(hulls)).decompose()
            if 2 * piece.volume() > ROUNDING_MM * piece.surface_area()
        ]
    )
    if uncovered.is_empty():
        return hulls
    # A long triangle would stretch its part across the others.
    left = from_manifold(uncovered.refine_to_length(LEAST_MM))
    corners = np.min([beyond(hull, left.vertices) for hull in hulls], axis=0)
    corners = left.triangles[(corners > ROUNDING_MM)[left.faces].any(axis=1)]
    nearest = np.argmin([beyond(hull, corners.mean(axis=1)) for hull in hulls], axis=0)
    return [
        trimesh.convex.convex_hull(
            np.concatenate([hull.vertices, corners[nearest == part].reshape(-1, 3)])
        )
        for part, hull in enumerate(hulls)
    ]


def _union(bodies: Sequence[trimesh.Trimesh]) -> manifold3d.Manifold:
    return manifold3d.Manifold.batch_boolean(
        [to_manifold(body) for body in bodies], manifold3d.OpType.Add
    )


def _arrays(bodies: Sequence[trimesh.Trimesh]) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    for part, body in enumerate(bodies):
        arrays[f"{part}.vertices"] = np.asarray(body.vertices, np.float64)
        arrays[f"{part}.faces"] = np.asarray(body.faces, np.int64)
    return arrays


def _pieces(mesh: trimesh.Trimesh) -> Iterator[Floats]:
    """Yield the vertices of each connected piece, those of the largest bounding box first.

    Meshes of vendors have thousands of pieces, such as letters and threads; most of them are never
    looked at.
    """
    import trimesh

    faces = trimesh.graph.connected_component_labels(mesh.face_adjacency, len(mesh.faces))
    order = np.argsort(faces, kind="stable")
    starts = np.flatnonzero(np.diff(faces[order], prepend=-1))
    corners = mesh.triangles[order]
    low = np.minimum.reduceat(corners.min(axis=1), starts)
    high = np.maximum.reduceat(corners.max(axis=1), starts)
    ends = np.append(starts[1:], len(order))
    for piece in np.argsort(-np.prod(high - low, axis=1), kind="stable").tolist():
        yield np.unique(corners[starts[piece] : ends[piece]].reshape(-1, 3), axis=0)
