"""A reconstructed volume as a specimen: voxels of one material whose density varies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.geometry import Pose, VolumeGrid
from twinct.specimen.build import BuiltSpecimen
from twinct.specimen.grey import GreyField
from twinct.specimen.grey_part import GreyPart
from twinct.specimen.materials import Material


def grey_specimen(
    mu_per_mm: NDArray[np.float32],
    grid: VolumeGrid,
    material: Material,
    energy_kev: float,
    name: str,
) -> BuiltSpecimen:
    """Return a specimen with the attenuation of a volume at one photon energy.

    Its skin is the box of the voxels, for checks of source and panel only. Negative attenuation,
    which noise and streaks of a volume have, stays: without it, the rest of the noise would add up
    along each ray.

    Args:
        mu_per_mm: attenuation, (z, y, x), 1/mm.
        grid: grid of the voxels in the world.
        material: material of all voxels, which states how attenuation changes with energy.
        energy_kev: photon energy of the attenuation.
        name: name of the part.

    Raises:
        SpecimenError: no voxel attenuates.
    """
    import trimesh

    amounts = mu_per_mm / np.float32(material.mu_per_mm(energy_kev))
    if not amounts.any():
        raise SpecimenError(f"{name}: no voxel attenuates")
    # The outermost layer of a grey part is empty.
    amounts = np.pad(amounts.astype(np.float32, copy=False), 1)[..., None]
    wider = VolumeGrid(amounts.shape[:3], grid.voxel, grid.world_from_grid)
    box = trimesh.creation.box(grid.size_mm, grid.world_from_grid.matrix)
    part = GreyPart(
        name, material, box, GreyField((material,), np.ascontiguousarray(amounts), wider)
    )
    return BuiltSpecimen((part,), Pose.identity())
