"""Bodies, beams and panels that the tests of photon transport share."""

import numpy as np

from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.specimen.materials import material
from twinct.transport import Beam, VoxelBody


def box(voxels: tuple[int, int, int], edges_mm, name: str = "water") -> VoxelBody:
    """Return a homogeneous box about the origin; voxels along (z, y, x), edges along (x, y, z)."""
    grid = VolumeGrid(voxels, edges_mm)
    return VoxelBody.of_labels(grid, np.zeros(voxels, np.uint8), {0: material(name)})


def view(
    source, detector, u=(1.0, 0.0, 0.0), v=(0.0, 1.0, 0.0), panel: Panel | None = None
) -> ScanGeometry:
    """Return one view."""
    vectors = (np.array([value], np.float64) for value in (source, detector, u, v))
    return ScanGeometry(*vectors, panel or Panel(4, 4, 50.0, 50.0))


def beam_down(half_mm: float, energies_kev=60.0, photons=1.0, height_mm: float = 500.0) -> Beam:
    """Return a beam along -z onto a square of the plane z = 0."""
    u, v = (half_mm, 0, 0), (0, half_mm, 0)
    return Beam((0, 0, height_mm), (0, 0, 0), u, v, energies_kev, photons)
