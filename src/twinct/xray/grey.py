"""Line integrals of grey fields: the amount of each basis material along each ray."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, Panel, Pose, ScanGeometry, VolumeGrid
from twinct.specimen import GreyField, GreyPart
from twinct.specimen.grey_part import CutFace
from twinct.xray.engine import SceneView


class GreyCaster:
    """Rays through the voxels of a grey field, by Joseph's method as in ``recon.Projector``.

    Rays begin at the source and end at the pixel's centre. The outermost voxels extend over their
    outer half, and nothing is outside.
    """

    def __init__(self, field: GreyField, panel: Panel) -> None:
        """Take a field, which is not copied, and the panel of every view."""
        self.field, self.panel = field, panel
        self._flat = field.amounts.reshape(-1)

    def cast(self, view: SceneView) -> NDArray[np.float32]:
        """Return the integral of each amount along each ray, (materials, rows, columns), mm.

        Args:
            view: source and panel, in the specimen's frame.
        """
        out = np.zeros((len(self.field.materials), *self.panel.shape), np.float32)
        self.add(view, range(len(out)), out)
        return out

    def add(self, view: SceneView, into: Sequence[int], out: NDArray[np.float32]) -> None:
        """Add the integral of each amount along each ray.

        Args:
            view: source and panel, in the specimen's frame.
            into: image of each basis material.
            out: receives the integrals, (images, rows, columns), mm.
        """
        from twinct.xray._grey_rays import add_amounts

        grid, panel = self.field.grid, self.panel
        local = grid.world_from_grid.inverse()
        column, row = panel.first_pixel_mm
        first = view.centre + column * view.u + row * view.v
        points = local.apply(np.stack([view.source, first])) - grid.first_voxel_mm
        steps = local.rotate(np.stack([panel.pitch_u * view.u, panel.pitch_v * view.v]))
        rays = np.vstack([np.vstack([points, steps]) / grid.voxel, grid.voxel])
        count, images = len(self.field.materials), np.array(into, np.int64)
        add_amounts(self._flat, grid.shape, count, rays, images, out)


def cut_share(part: GreyPart, view: ScanGeometry, specimen_from_world: Pose) -> float:
    """Return the share of a view's rays that leave a body where its CT volume ends.

    Args:
        part: grey part, whose ``cuts`` are the faces that cut the body.
        view: exactly one view.
        specimen_from_world: pose of the world in the specimen's frame.
    """
    if not part.cuts:
        return 0.0
    grid = part.field.grid
    local = grid.world_from_grid.inverse() @ specimen_from_world @ view
    source = (local.source[0] - grid.first_voxel_mm) / grid.voxel
    ways = (local.pixel_centres(0) - grid.first_voxel_mm) / grid.voxel - source
    cut = np.zeros(view.panel.shape, dtype=np.bool_)
    for face in part.cuts:
        cut |= _passes(face, grid, source, ways)
    return float(cut.mean())


def _passes(face: CutFace, grid: VolumeGrid, source: Floats, ways: Floats) -> NDArray[np.bool_]:
    """Return the rays between source and pixel that pass a face where it holds tissue."""
    # An empty layer of voxels lies beyond the face.
    plane = grid.shape_xyz[face.axis] - 1.5 if face.high else 0.5
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (plane - source[face.axis]) / ways[..., face.axis]
    passes = (t > 0) & (t < 1)
    places = source + np.where(passes, t, 0.0)[..., None] * ways
    others = [axis for axis in (2, 1, 0) if axis != face.axis]  # in the order of the array
    first, second = (np.rint(places[..., axis]).astype(np.int64) for axis in others)
    rows, columns = face.tissue.shape
    passes &= (first >= 0) & (first < rows) & (second >= 0) & (second < columns)
    return passes & face.tissue[np.where(passes, first, 0), np.where(passes, second, 0)]
