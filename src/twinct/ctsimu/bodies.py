"""From the surface files of the samples to solids that can be imaged together.

The centre of a mesh's bounding box is the origin of the sample. Where two samples overlap the later
one counts: it is cut out of the earlier one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from trimesh import Trimesh

from twinct.ctsimu.scene import Body
from twinct.errors import SpecimenError
from twinct.geometry import Floats, Pose
from twinct.specimen.surface import open_edges, refined, subtract, surface

OVERLAP = 1e-9
"""A smaller share of a volume than this is rounding of two faces that touch."""

KEPT = 16
"""Relative positions remembered: samples that pass each other have a new one each frame."""

LADDER = 1.4
"""Distances for which a mesh is refined are powers of this: each frame finds the same mesh."""

MAX_TRIANGLES = 5_000_000
"""Of one sample; gVXR takes 0.1 kB for each."""

DEPTH_MM = 0.001
"""How far a path may be off because gVXR takes the distance to the source as linear in a triangle.

Over an edge e at distance d it is off by up to e^2 / (8 d) at each surface.
"""


@dataclass
class Solids:
    """Meshes by file and scale, read once; cut once for every new relative position."""

    _meshes: dict[tuple[Path, tuple[float, float, float]], Trimesh] = field(default_factory=dict)
    _cut: dict[object, Trimesh] = field(default_factory=dict)
    _fine: dict[tuple[int, int], tuple[Trimesh, Trimesh]] = field(default_factory=dict)

    def of(self, bodies: Sequence[Body], source: Floats) -> list[tuple[Body, Trimesh]]:
        """The bodies that are not vacuum, and what each of them is in its own frame.

        Args:
            bodies: of one frame.
            source: the focal spot in the world, (3,), mm.

        Raises:
            SpecimenError: a file that is no closed surface, or a sample that is too near to the
                source for its size; names it.
        """
        solids = [(body, self._mesh(body)) for body in bodies]
        found = []
        for index, (body, mesh) in enumerate(solids):
            if body.material is None:
                continue
            later = [
                (other, body.world_from_body.inverse() @ other.world_from_body, shape)
                for other, shape in solids[index + 1 :]
            ]
            left = self._without(body, mesh, later)
            if len(left.faces):
                found.append((body, self._refined(body, left, source)))
        return found

    def _refined(self, body: Body, mesh: Trimesh, source: Floats) -> Trimesh:
        """Fine enough for the body's distance, whatever the frames before."""
        seen = body.world_from_body.inverse().apply(source)
        nearest = np.clip(seen, *np.asarray(mesh.bounds))
        distance = max(float(np.linalg.norm(seen - nearest)), DEPTH_MM)
        rung = int(np.floor(np.log(distance) / np.log(LADDER)))
        key = id(mesh), rung
        if key not in self._fine:
            edge = np.sqrt(8 * LADDER**rung * DEPTH_MM) / 1.5
            # An equilateral triangle of that edge has 0.43 of its square.
            if mesh.area / (0.43 * edge**2) > MAX_TRIANGLES:
                raise SpecimenError(
                    f"sample '{body.name}' comes within {distance:.3g} mm of the source: its "
                    f"{mesh.area:.3g} mm^2 would need more than {MAX_TRIANGLES} triangles "
                    "for gVXR to get its depth right"
                )
            self._fine[key] = mesh, refined(mesh, edge)  # the mesh too: its id must stay its own
        return self._fine[key][1]

    def _without(
        self, body: Body, mesh: Trimesh, later: list[tuple[Body, Pose, Trimesh]]
    ) -> Trimesh:
        near = [(b, pose, shape) for b, pose, shape in later if _near(mesh, pose, shape)]
        if not near:
            return mesh
        key = (body.file, body.scale) + tuple(
            (b.file, b.scale, tuple(np.round(pose.matrix, 9).ravel())) for b, pose, _ in near
        )
        if key not in self._cut:
            if len(self._cut) >= KEPT:
                self._cut.clear()
                self._fine.clear()
            # Rounded as in the key: the frame that comes first must not matter.
            tools = [
                surface(
                    trimesh.transform_points(shape.vertices, np.round(pose.matrix, 9)),
                    np.asarray(shape.faces),
                )
                for _, pose, shape in near
            ]
            left = subtract(mesh, tools, body.name)
            changed = not len(left.faces) or left.volume < (1 - OVERLAP) * mesh.volume
            self._cut[key] = left if changed else mesh
        return self._cut[key]

    def _mesh(self, body: Body) -> Trimesh:
        key = body.file, body.scale
        if key not in self._meshes:
            self._meshes[key] = _read(body)
        return self._meshes[key]


def _read(body: Body) -> Trimesh:
    try:
        loaded = trimesh.load(body.file, force="mesh")
    except Exception as error:  # each reader of trimesh has its own errors
        raise SpecimenError(f"sample '{body.name}': {body.file} cannot be read: {error}") from None
    if not isinstance(loaded, Trimesh) or not len(loaded.faces):
        raise SpecimenError(f"sample '{body.name}': {body.file} holds no triangles")
    loaded.merge_vertices()
    vertices = np.asarray(loaded.vertices, dtype=np.float64)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    mesh = surface((vertices - middle) * body.scale, np.asarray(loaded.faces))
    gaps = open_edges(mesh)
    if gaps:
        raise SpecimenError(
            f"sample '{body.name}': {body.file} is no closed surface: {gaps} of its edges do not "
            "join exactly two triangles"
        )
    return surface(mesh.vertices, mesh.faces[:, ::-1]) if mesh.volume < 0 else mesh


def _near(mesh: Trimesh, pose: Pose, other: Trimesh) -> bool:
    low, high = mesh.bounds
    corners = np.array(np.meshgrid(*np.asarray(other.bounds).T)).reshape(3, -1).T
    seen = pose.apply(corners)
    return bool((seen.min(axis=0) <= high).all() and (seen.max(axis=0) >= low).all())
