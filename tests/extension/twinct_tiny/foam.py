"""A ball of voxels, denser towards its middle."""

from typing import Literal

import numpy as np
from pydantic import Field

from twinct.geometry import VolumeGrid
from twinct.geometry.bodies import Voxels
from twinct.specimen.part_kinds import PartKind, PartSettings


class Foam(PartSettings):
    """A ball of voxels, denser towards its middle, with some bone in it."""

    kind: Literal["foam"]
    radius_mm: float = Field(gt=0, le=1000, description="Radius.")
    voxel_mm: float = Field(default=2.0, gt=0, le=100, description="Edge of the voxels.")
    bone: float = Field(default=0.1, ge=0, le=1, description="Amount of bone in each voxel.")


def _voxels(section: Foam) -> Voxels:
    count = int(2 * section.radius_mm / section.voxel_mm) + 2
    grid = VolumeGrid((count, count, count), section.voxel_mm)
    x, y, z = grid.axes()
    away = np.sqrt(x**2 + y[:, None] ** 2 + z[:, None, None] ** 2) / section.radius_mm
    inside = away < 1
    water = np.where(inside, 1 - away / 2, 0)
    return Voxels({"water": water, "bone": section.bone * inside}, grid)


FOAM = PartKind(Foam, voxels=_voxels)
