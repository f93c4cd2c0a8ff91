"""Surface files of the samples, turned into solids that can be imaged together.

The origin of a sample is the centre of its mesh's bounding box. Where two samples overlap, the
later one counts: it is cut out of the earlier one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from trimesh import Trimesh, transform_points

from twinct.core.errors import SpecimenError
from twinct.core.files.meshes import open_edges, read_triangles
from twinct.ctsimu.scene import Sample
from twinct.geometry import Floats, Pose
from twinct.specimen.surface import corners, subtract, surface
from twinct.xray._placement import longest_edge, split

OVERLAP = 1e-9
"""Shares of a volume below this are rounding errors of two touching faces."""

KEPT = 16
"""Number of cached relative positions: samples that pass each other have a new one each frame."""

LADDER = 1.4
"""Ratio of the distances for which meshes are refined; frames within one step share a mesh."""

MAX_SAMPLE_TRIANGLES = 5_000_000
"""Limit of one sample; gVXR takes 0.1 kB per triangle."""

SAMPLE_DEPTH_MM = 0.001
"""Maximum error of a path length due to a triangle's size.

The suite's edges and steps need a finer value than the default of ``twinct.xray``.
"""


@dataclass
class Solids:
    """Meshes by file and scale, read once, and cut once for every new relative position."""

    _meshes: dict[tuple[Path, tuple[float, float, float]], Trimesh] = field(default_factory=dict)
    _cut: dict[object, Trimesh] = field(default_factory=dict)
    _fine: dict[tuple[int, int], tuple[Trimesh, Trimesh]] = field(default_factory=dict)

    def of(self, samples: Sequence[Sample], source: Floats) -> list[tuple[Sample, Trimesh]]:
        """Return the samples that are not vacuum, each with its solid in its own frame.

        The focal spot is in the world, (3,), mm.

        Raises:
            SpecimenError: a file holds no closed surface, or a sample is too near to the source for
                its size; names it.
        """
        solids = [(sample, self._mesh(sample)) for sample in samples]
        meshes = []
        for index, (sample, mesh) in enumerate(solids):
            if sample.material is None:
                continue
            later = [
                (other, sample.world_from_sample.inverse() @ other.world_from_sample, shape)
                for other, shape in solids[index + 1 :]
            ]
            left = self._without(sample, mesh, later)
            if len(left.faces):
                meshes.append((sample, self._refined(sample, left, source)))
        return meshes

    def _refined(self, sample: Sample, mesh: Trimesh, source: Floats) -> Trimesh:
        """Return a mesh fine enough for the sample's distance, independent of earlier frames."""
        seen = sample.world_from_sample.inverse().apply(source)
        nearest = np.clip(seen, *np.asarray(mesh.bounds))
        distance = max(float(np.linalg.norm(seen - nearest)), SAMPLE_DEPTH_MM)
        rung = int(np.floor(np.log(distance) / np.log(LADDER)))
        key = id(mesh), rung
        if key not in self._fine:
            edge = longest_edge(LADDER**rung, SAMPLE_DEPTH_MM)
            # Area per triangle: equilateral, with two thirds of that edge.
            if mesh.area / (0.43 / 1.5**2 * edge**2) > MAX_SAMPLE_TRIANGLES:
                raise SpecimenError(
                    f"sample '{sample.name}' comes within {distance:.3g} mm of the source: its "
                    f"{mesh.area:.3g} mm^2 would need more than {MAX_SAMPLE_TRIANGLES} triangles "
                    "for gVXR to compute its depth correctly"
                )
            self._fine[key] = mesh, split(mesh, edge)  # keeps the mesh's id unique
        return self._fine[key][1]

    def _without(
        self, sample: Sample, mesh: Trimesh, later: list[tuple[Sample, Pose, Trimesh]]
    ) -> Trimesh:
        near = [(b, pose, shape) for b, pose, shape in later if _near(mesh, pose, shape)]
        if not near:
            return mesh
        key = (sample.file, sample.scale) + tuple(
            (b.file, b.scale, tuple(np.round(pose.matrix, 9).ravel())) for b, pose, _ in near
        )
        if key not in self._cut:
            if len(self._cut) >= KEPT:
                self._cut.clear()
                self._fine.clear()
            # Rounded like the key: the result must not depend on the first frame.
            tools = [
                surface(transform_points(shape.vertices, np.round(pose.matrix, 9)), shape.faces)
                for _, pose, shape in near
            ]
            left = subtract(mesh, tools, sample.name)
            changed = not len(left.faces) or left.volume < (1 - OVERLAP) * mesh.volume
            self._cut[key] = left if changed else mesh
        return self._cut[key]

    def _mesh(self, sample: Sample) -> Trimesh:
        key, where = (sample.file, sample.scale), f"sample '{sample.name}': {sample.file}"
        if key in self._meshes:
            return self._meshes[key]
        loaded = read_triangles(sample.file, where)
        loaded.merge_vertices()
        vertices = np.asarray(loaded.vertices, dtype=np.float64)
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        mesh = surface((vertices - middle) * sample.scale, loaded.faces)
        if gaps := open_edges(mesh):
            what = f"{gaps} of its edges do not join exactly two triangles"
            raise SpecimenError(f"{where} is not a closed surface: {what}")
        inside_out = mesh.volume < 0
        self._meshes[key] = surface(mesh.vertices, mesh.faces[:, ::-1]) if inside_out else mesh
        return self._meshes[key]


def _near(mesh: Trimesh, pose: Pose, other: Trimesh) -> bool:
    low, high = mesh.bounds
    seen = pose.apply(corners(other))
    return bool((seen.min(axis=0) <= high).all() and (seen.max(axis=0) >= low).all())
