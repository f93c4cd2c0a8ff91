"""Path lengths of all rays in each material: the only input from the engine for any spectrum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError, TwinctError
from twinct.core.foreign_text import quoted
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.specimen import Part
from twinct.specimen.materials import Material
from twinct.specimen.mesh_caster import misses
from twinct.specimen.part import rendered
from twinct.specimen.surface import corners
from twinct.xray._owner import SceneOwner
from twinct.xray._placement import SpecimenObstacle, mesh_fault, split
from twinct.xray.engine import SceneBody
from twinct.xray.engines import DEFAULT_ENGINE, engine_named
from twinct.xray.own_rays import OwnRays, room_rays

LARGEST_TILE = 2048
"""Maximum pixels along an edge for gVXR with software OpenGL; larger panels are tiled."""


def materials_of(parts: Sequence[Part], objects: Sequence[Part] = ()) -> tuple[Material, ...]:
    """Return the materials of which an image has path lengths, each once, in their order."""
    own = (part for part in parts if part.own_rays)
    all_of = (*rendered(parts), *own, *objects)
    return tuple(dict.fromkeys(one for part in all_of for one in part.materials))


class PathRenderer(SceneOwner):
    """Renderer for path lengths of parts that may each move on their own from view to view.

    An engine renders the parts whose meshes are exactly the body; they are uploaded once. All
    others, and the objects of the room, are cast by rays of their own. Each part is rendered
    separately, in its own frame, which takes as long as one pass over all of them. Parts must not
    overlap: an overlap counts in both. Only one renderer or imager of meshes can be open in a
    process.

    Attributes:
        materials: distinct materials, see ``materials_of``. The images have this order.
        panel: panel of every view.
        samples: samples along each pixel edge.
        own: rays of the parts that no engine renders.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        panel: Panel,
        samples: int = 1,
        longest_edge_mm: float | None = None,
        engine: str = DEFAULT_ENGINE,
        objects: Sequence[Part] = (),
    ) -> None:
        """Upload the parts.

        Args:
            parts: parts to image, each in its own frame, mm.
            panel: panel of every view.
            samples: samples along each pixel edge; the cost grows with their square.
            longest_edge_mm: maximum edge of the meshes, longer ones are split; see
                ``longest_edge``.
            engine: name of the X-ray engine.
            objects: objects of the room, in the world, mm; by rays of their own, with any engine.

        Raises:
            SpecimenError: there is no part, or a mesh is open or inside out.
            InputError: the engine, or something that it needs, is missing.
            TwinctError: another imager is open in this process, or the engine failed.
        """
        if not parts:
            raise SpecimenError("the specimen has no parts: there is nothing to image")
        if samples < 1:
            raise ValueError(f"{samples} samples along a pixel edge: at least 1 is needed")
        _require_closed(parts)
        self.materials = materials_of(parts, objects)
        self._own_rays = [part.own_rays for part in parts]
        bodies = rendered(parts)
        self._material = [self.materials.index(body.material) for body in bodies]
        self._placements = [SpecimenObstacle([(part.name, part.mesh)]) for part in parts]
        self._corners = [corners(body.mesh) for body in bodies]
        self.panel, self.samples = panel, samples
        fine = self._fine = panel.divided(samples)
        self.own = OwnRays([part for part in parts if part.own_rays], fine)
        self._room = room_rays(objects, fine)
        tile = Panel(_even(fine.rows), _even(fine.columns), fine.pitch_u, fine.pitch_v)
        self._tile_panel = tile
        self._tile = np.empty(tile.shape if bodies else (0, 0), dtype=np.float32)
        meshes = [split(body.mesh, longest_edge_mm) for body in bodies]
        uploads = [SceneBody(np.asarray(m.vertices), np.asarray(m.faces)) for m in meshes]
        if bodies:
            self._acquire(engine_named(engine).engine, uploads, tile)
        self._open = True

    def render(
        self, view: ScanGeometry, world_from_parts: Pose | Sequence[Pose]
    ) -> NDArray[np.float32]:
        """Return the path lengths of one view.

        Args:
            view: exactly one view, in the world, with the panel of this renderer.
            world_from_parts: pose of the frame of each part at exposure; or one pose for all.

        Returns:
            Path lengths, mm, (materials, rows * samples, columns * samples). The samples of a pixel
            are the centres of its samples x samples equal parts.

        Raises:
            ValueError: ``view`` is not one view or has another panel, or the poses do not match the
                parts.
            TwinctError: the renderer is closed, a body reaches through the panel, the source is
                inside a body, or the engine failed.
        """
        if not self._open:
            raise TwinctError("the X-ray renderer was closed")
        if len(view) != 1:
            raise ValueError(f"render takes one view at a time, not {len(view)}")
        if view.panel != self.panel:
            raise ValueError(f"the view has {view.panel}; the renderer was made for {self.panel}")
        seen = self._from_parts(view, world_from_parts)
        views = [one for one, own in zip(seen, self._own_rays, strict=True) if not own]
        paths = np.zeros((len(self.materials), *self._fine.shape), dtype=np.float32)
        filled = [False] * len(self.materials)
        for body, material in enumerate(self._material):
            if misses(views[body], self._corners[body]):
                continue
            for row in range(0, self._fine.rows, self._tile.shape[0]):
                for column in range(0, self._fine.columns, self._tile.shape[1]):
                    self._add(body, views[body], (row, column), paths[material], filled[material])
            filled[material] = True
        cast = [one for one, own in zip(seen, self._own_rays, strict=True) if own]
        self.own.add(cast, self.materials, paths)
        self._room.add([view] * len(self._room.parts), self.materials, paths)
        return paths

    def _from_parts(self, view: ScanGeometry, poses: Pose | Sequence[Pose]) -> list[ScanGeometry]:
        """Return the view in the frame of each part, where it can be rendered."""
        count = len(self._placements)
        poses = [poses] * count if isinstance(poses, Pose) else poses
        if len(poses) != count:
            raise ValueError(f"{len(poses)} poses for {count} parts")
        views = [pose.inverse() @ view for pose in poses]
        for placement, seen in zip(self._placements, views, strict=True):
            placement.check(seen)
        return views

    def _add(
        self,
        body: int,
        view: ScanGeometry,
        start: tuple[int, int],
        out: NDArray[np.float32],
        filled: bool,
    ) -> None:
        """Render one tile, which may extend beyond the panel."""
        tile, fine, (row, column) = self._tile, self._fine, start
        down = (row + (tile.shape[0] - fine.rows) / 2) * fine.pitch_v
        right = (column + (tile.shape[1] - fine.columns) / 2) * fine.pitch_u
        centre = view.detector[0] + right * view.u[0] + down * view.v[0]
        seen = ScanGeometry(view.source, centre[None], view.u, view.v, self._tile_panel)
        self._scene.path_lengths(seen, body, tile)
        part = out[row : row + tile.shape[0], column : column + tile.shape[1]]
        lengths = tile[: part.shape[0], : part.shape[1]]
        part[:] = part + lengths if filled else lengths


def _require_closed(parts: Sequence[Part]) -> None:
    faults = [f"part {quoted(p.name)} {why}" for p in parts if (why := mesh_fault(p.mesh))]
    if faults:
        raise SpecimenError(faults)


def _even(count: int) -> int:
    """Return the size of equal tiles that cover an edge."""
    return -(-count // -(-count // LARGEST_TILE))
