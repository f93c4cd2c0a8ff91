"""Comparison of a specimen's size with the field of view, which reveals a wrong unit of length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.core.foreign_text import quoted
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.specimen import sections
from twinct.specimen.build import BuiltSpecimen

FEW_VOXELS = 4
"""Minimum number of voxels along a part's longest edge; smaller parts are invisible in a volume."""

MANY_FIELDS = 3
"""Maximum size of a file's part in fields of view; a head exceeds the paper's.

Shapes that state their edges in mm may be larger, such as a table under a patient.
"""

UNITS_MM: dict[str, float] = {
    "micrometres": 1e-3,
    "millimetres": 1,
    "centimetres": 10,
    "inches": 25.4,
    "metres": 1e3,
}


@dataclass(frozen=True)
class SpecimenSize:
    """Sizes of specimen, field of view and grid.

    Attributes:
        specimen_mm: edges of the specimen's bounding box in its own frame, (x, y, z).
        field_mm: width and height of the smallest field of view at the specimen's middle.
        grid_mm: edges of the reconstructed box, (x, y, z).
        warnings: parts whose size suggests a wrong unit.
    """

    specimen_mm: tuple[float, ...]
    field_mm: tuple[float, ...]
    grid_mm: tuple[float, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        size, field, grid = map(_edges, (self.specimen_mm, self.field_mm, self.grid_mm))
        return f"{size}; field of view {field}, grid {grid}"


def specimen_size(
    section: sections.Specimen, built: BuiltSpecimen, geometry: ScanGeometry, grid: VolumeGrid
) -> SpecimenSize:
    """Compare a specimen, built from ``section``, with field of view and voxels."""
    low, high = built.bounds
    field = _field_mm(geometry, built.world_from_specimen.apply((low + high) / 2))
    warnings = []
    for i, (part, body) in enumerate(zip(section.parts, built.parts, strict=True)):
        edges = np.ptp(body.mesh.bounds, axis=0)
        largest, voxel = float(edges.max()), float(grid.voxel.max())
        if largest < FEW_VOXELS * voxel:
            beside = f"less than {FEW_VOXELS} voxels of {voxel:.3g} mm"
        elif getattr(part.shape, "path", None) and largest > MANY_FIELDS * field.max():
            beside = f"more than {MANY_FIELDS} times the field of view, {_edges(field)}"
        else:
            continue
        advice = "is that its size in mm?"
        if isinstance(part.shape, sections.MeshFile):
            key, unit_mm = f"specimen.parts.{i}.shape.unit_mm", part.shape.unit_mm
            name = _fitting_unit(largest / unit_mm, float(field.min()))
            size = largest / unit_mm * UNITS_MM[name]
            advice = (
                f"{key} is {unit_mm:g}; {UNITS_MM[name]:g} ({name}) would make it {size:.3g} mm"
            )
        warnings.append(f"part {quoted(body.name)} measures {_edges(edges)}, {beside}: {advice}")
    size, seen, box = (tuple(lengths.tolist()) for lengths in (high - low, field, grid.size_mm))
    return SpecimenSize(size, seen, box, tuple(warnings))


def _field_mm(geometry: ScanGeometry, middle: Floats) -> Floats:
    """Return width and height of the smallest field of view at a point, over all views, (2,)."""
    to_point, to_panel = geometry.depth(middle), geometry.sdd
    return np.array(geometry.panel.size_mm) * max(float((to_point / to_panel).min()), 0.0)


def _fitting_unit(length: float, field_mm: float) -> str:
    """Return the unit in which a length is closest to half the field of view."""
    return min(UNITS_MM, key=lambda name: abs(np.log(2 * length * UNITS_MM[name] / field_mm)))


def _edges(lengths: tuple[float, ...] | Floats) -> str:
    return f"{' x '.join(f'{length:.3g}' for length in lengths)} mm"
