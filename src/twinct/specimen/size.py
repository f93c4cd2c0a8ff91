"""How large a specimen is beside what sees it: a file in another unit shows here first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct import scenario
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.specimen.build import BuiltSpecimen

FEW_VOXELS = 4
"""What is smaller in every direction cannot be seen in a volume."""

MANY_FIELDS = 3
"""A head sticks out of the paper's field of view; what is so many times as large is a mistake."""

UNITS_MM = {"micrometres": 1e-3, "millimetres": 1, "centimetres": 10, "inches": 25.4, "metres": 1e3}


@dataclass(frozen=True)
class SpecimenSize:
    """Sizes to compare.

    Attributes:
        specimen_mm: edges of the specimen's bounding box in its own frame, (x, y, z).
        field_mm: width and height of what the narrowest view sees in the specimen's middle.
        grid_mm: edges of the reconstructed box, (x, y, z).
        warnings: parts that are so small or so large that their unit may be wrong.
    """

    specimen_mm: tuple[float, ...]
    field_mm: tuple[float, ...]
    grid_mm: tuple[float, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        size, field, grid = map(_edges, (self.specimen_mm, self.field_mm, self.grid_mm))
        return f"{size}; field of view {field}, grid {grid}"


def specimen_size(
    section: scenario.Specimen, built: BuiltSpecimen, geometry: ScanGeometry, grid: VolumeGrid
) -> SpecimenSize:
    """Compare a specimen, as built of its section, with field of view and voxels."""
    low, high = built.bounds
    field = _field_mm(geometry, built.world_from_specimen.apply((low + high) / 2))
    warnings = []
    for i, (part, body) in enumerate(zip(section.parts, built.parts, strict=True)):
        edges = np.ptp(body.mesh.bounds, axis=0)
        largest, voxel = float(edges.max()), float(grid.voxel.max())
        if largest < FEW_VOXELS * voxel:
            beside = f"less than {FEW_VOXELS} voxels of {voxel:.3g} mm"
        elif largest > MANY_FIELDS * field.max():
            beside = f"more than {MANY_FIELDS} times the field of view, {_edges(field)}"
        else:
            continue
        advice = "is that its size in mm?"
        if isinstance(part.shape, scenario.MeshFile):
            key, unit_mm = f"specimen.parts.{i}.shape.unit_mm", part.shape.unit_mm
            name = _fitting_unit(largest / unit_mm, float(field.min()))
            size = largest / unit_mm * UNITS_MM[name]
            advice = (
                f"{key} is {unit_mm:g}; {UNITS_MM[name]:g} ({name}) would make it {size:.3g} mm"
            )
        warnings.append(f"part {body.name!r} measures {_edges(edges)}, {beside}: {advice}")
    size, seen, box = (tuple(lengths.tolist()) for lengths in (high - low, field, grid.size_mm))
    return SpecimenSize(size, seen, box, tuple(warnings))


def _field_mm(geometry: ScanGeometry, middle: Floats) -> Floats:
    """Width and height of the panel's image at a point, in the view where it is smallest, (2,)."""
    to_point, to_panel = geometry.depth(middle), geometry.sdd
    return np.array(geometry.panel.size_mm) * max(float((to_point / to_panel).min()), 0.0)


def _fitting_unit(length: float, field_mm: float) -> str:
    """The unit in which a length comes nearest to half the field of view."""
    return min(UNITS_MM, key=lambda name: abs(np.log(2 * length * UNITS_MM[name] / field_mm)))


def _edges(lengths: tuple[float, ...] | Floats) -> str:
    return f"{' x '.join(f'{length:.3g}' for length in lengths)} mm"
