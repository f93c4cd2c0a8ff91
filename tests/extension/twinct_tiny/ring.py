"""A ring about the part's z axis."""

from typing import Literal

import numpy as np
from pydantic import Field

from twinct.specimen.part_kinds import PartKind, PartSettings


class Ring(PartSettings):
    """A ring about the part's z axis."""

    kind: Literal["ring"]
    radius_mm: float = Field(gt=0, le=1000, description="From the axis to the tube's centre.")
    tube_mm: float = Field(gt=0, le=1000, description="Radius of the tube.")
    closed: bool = Field(default=True, description="False leaves a gap.")


def _surface(section: Ring) -> tuple[np.ndarray, np.ndarray]:
    along, around = np.meshgrid(*(np.arange(n) * 2 * np.pi / n for n in (96, 48)), indexing="ij")
    reach = section.radius_mm + section.tube_mm * np.cos(around)
    corners = [reach * np.cos(along), reach * np.sin(along), section.tube_mm * np.sin(around)]
    number = np.arange(along.size).reshape(along.shape)
    right, up = np.roll(number, -1, axis=0), np.roll(number, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    faces = np.concatenate(
        [np.stack([number, right, both], axis=-1), np.stack([number, both, up], axis=-1)]
    )
    if not section.closed:
        faces = faces[1:]
    return np.stack(corners, axis=-1).reshape(-1, 3), faces.reshape(-1, 3)


RING = PartKind(Ring, _surface)
