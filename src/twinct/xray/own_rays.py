"""Line integrals of all that no X-ray engine renders: parts with rays of their own, and the room.

Objects of the room stand still in the world while the specimen may move, and they are larger than a
scan: a table may reach behind the panel, or behind the source.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.geometry import Panel, ScanGeometry
from twinct.specimen import Part
from twinct.specimen.materials import Material
from twinct.xray._placement import mesh_fault


class OwnRays:
    """Rays of a panel through parts, beside any engine.

    Attributes:
        parts: the parts.
        casters: caster of each.
    """

    def __init__(self, parts: Sequence[Part], panel: Panel) -> None:
        """Take the parts; for those of a room, see ``room_rays``."""
        self.parts, self._panel = tuple(parts), panel
        self.casters = [part.caster(panel) for part in parts]

    def add(
        self,
        views: Sequence[ScanGeometry],
        materials: Sequence[Material],
        paths: NDArray[np.float32],
    ) -> None:
        """Add the line integrals of one view.

        Args:
            views: exactly one view, in the frame of each part.
            materials: material of each image.
            paths: receives the integrals, mm, (images, rows, columns).
        """
        for part, caster, view in zip(self.parts, self.casters, views, strict=True):
            caster.add(view, [materials.index(one) for one in part.materials], paths)

    def depths(self, view: ScanGeometry, energy_kev: float) -> Iterator[NDArray[np.float32]]:
        """Yield the attenuation of each part along each ray of one view, in the parts' frame."""
        for part, caster in zip(self.parts, self.casters, strict=True):
            paths = np.zeros((len(part.materials), *self._panel.shape), np.float32)
            caster.add(view, range(len(paths)), paths)
            depth = np.zeros(self._panel.shape, np.float32)
            for substance, lengths in zip(part.materials, paths, strict=True):
                depth += np.float32(substance.mu_per_mm(energy_kev)) * lengths
            yield depth


def room_rays(objects: Sequence[Part], panel: Panel) -> OwnRays:
    """Return the rays through disjoint objects of the room, in the world, mm.

    Raises:
        SpecimenError: a mesh is open or inside out.
    """
    faults = [
        f"cell.objects: {quoted(body.name)} {why}"
        for body in objects
        if (why := mesh_fault(body.mesh))
    ]
    if faults:
        raise SpecimenError(faults)
    return OwnRays(objects, panel)
