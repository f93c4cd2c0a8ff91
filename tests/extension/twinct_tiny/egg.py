"""An ellipsoid that is cast by its formulas."""

from typing import Literal

import numpy as np
from pydantic import Field

from twinct.geometry import VolumeGrid
from twinct.geometry.bodies import sampled
from twinct.specimen.part_kinds import PartKind, PartSettings


class Egg(PartSettings):
    """An ellipsoid about the part's z axis, without a mesh in its images."""

    kind: Literal["egg"]
    radius_mm: float = Field(gt=0, le=1000, description="Semi-axis along x and y.")
    height_mm: float = Field(gt=0, le=1000, description="Semi-axis along z.")


class EggSolid:
    """The formulas, in the frame in which the ellipsoid is the unit ball."""

    def __init__(self, section: Egg) -> None:
        self._axes = np.array([section.radius_mm, section.radius_mm, section.height_mm])

    def path_lengths(self, source: np.ndarray, ends: np.ndarray) -> np.ndarray:
        start, way = source / self._axes, (ends - source) / self._axes
        a, b, c = (way**2).sum(-1), way @ start, start @ start - 1  # |start + t way| = 1
        half = np.sqrt(np.maximum(b**2 - a * c, 0)) / a
        t = np.clip([-b / a - half, -b / a + half], 0, 1)  # from the source to the pixel
        return (t[1] - t[0]) * np.linalg.norm(ends - source, axis=-1)

    def fractions(self, grid: VolumeGrid) -> np.ndarray:
        return sampled(lambda points: ((points / self._axes) ** 2).sum(-1) < 1, grid)

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        import trimesh  # not at the top: every command imports this file

        ball = trimesh.creation.icosphere(subdivisions=5)
        return ball.vertices * self._axes, ball.faces


EGG = PartKind(Egg, solid=EggSolid)
