"""Path lengths of all rays in each material: the only input from the engine for any spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError, TwinctError
from twinct.core.foreign_text import quoted
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.specimen import BuiltPart, GreyPart
from twinct.specimen.materials import Material
from twinct.xray._owner import SceneOwner
from twinct.xray._placement import Placement, corners, mesh_fault, misses, split
from twinct.xray.engine import SceneBody
from twinct.xray.engines import DEFAULT_ENGINE, engine_named
from twinct.xray.grey import GreyCaster
from twinct.xray.room_rays import RoomRays

if TYPE_CHECKING:
    from trimesh import Trimesh

LARGEST_TILE = 2048
"""Maximum pixels along an edge for gVXR with software OpenGL; larger panels are tiled."""


class Body(NamedTuple):
    """A closed mesh in its own frame, mm, counter-clockwise seen from outside, and its material."""

    mesh: Trimesh
    material: Material
    name: str = ""

    @property
    def label(self) -> str:
        """Name for messages."""
        return self.name or self.material.name


class PathRenderer(SceneOwner):
    """Renderer for path lengths of bodies that may each move on their own from view to view.

    The meshes are uploaded once. Each body is rendered separately, in its own frame, which takes as
    long as one pass over all bodies. Bodies must not overlap: an overlap counts in both. Only one
    renderer or imager of meshes can be open in a process. Grey parts need no engine.

    Attributes:
        materials: distinct materials, in the order of their first body, then of the grey parts'
            basis materials, then of the room's objects. The images have this order.
        panel: panel of every view.
        samples: samples along each pixel edge.
        casters: caster of each grey part, and the images of its materials.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        panel: Panel,
        samples: int = 1,
        longest_edge_mm: float | None = None,
        engine: str = DEFAULT_ENGINE,
        greys: Sequence[GreyPart] = (),
        objects: Sequence[BuiltPart] = (),
    ) -> None:
        """Upload the bodies.

        Args:
            bodies: bodies to image.
            panel: panel of every view.
            samples: samples along each pixel edge; the cost grows with their square.
            longest_edge_mm: maximum edge of the meshes, longer ones are split; see
                ``longest_edge``.
            engine: name of the X-ray engine.
            greys: grey parts to image, at least one if there are no bodies.
            objects: objects of the room, in the world, mm; by our own rays, with any engine.

        Raises:
            SpecimenError: there is no body, or a mesh is open or inside out.
            InputError: the engine, or something that it needs, is missing.
            TwinctError: another imager is open in this process, or the engine failed.
        """
        if not (bodies or greys):
            raise SpecimenError("the specimen has no parts: there is nothing to image")
        if samples < 1:
            raise ValueError(f"{samples} samples along a pixel edge: at least 1 is needed")
        named = [*((body.label, body.mesh) for body in bodies), *((g.name, g.mesh) for g in greys)]
        _require_closed(named)
        basis = (m for part in greys for m in part.field.materials)
        self.materials: tuple[Material, ...] = tuple(
            dict.fromkeys([*(b.material for b in bodies), *basis, *(o.material for o in objects)])
        )
        self._material = [self.materials.index(body.material) for body in bodies]
        self._placements = [Placement([part]) for part in named]
        self._corners = [corners(body.mesh) for body in bodies]
        self.panel, self.samples = panel, samples
        fine = self._fine = panel.divided(samples)
        self.casters = [
            (GreyCaster(part.field, fine), [self.materials.index(m) for m in part.field.materials])
            for part in greys
        ]
        self._room = RoomRays(objects, fine)
        self._room_into = [self.materials.index(m) for m in self._room.materials]
        tile = Panel(_even(fine.rows), _even(fine.columns), fine.pitch_u, fine.pitch_v)
        self._tile_panel = tile
        self._tile = np.empty(tile.shape if bodies else (0, 0), dtype=np.float32)
        meshes = [split(body.mesh, longest_edge_mm) for body in bodies]
        uploads = [SceneBody(np.asarray(m.vertices), np.asarray(m.faces)) for m in meshes]
        if bodies:
            self._acquire(engine_named(engine).engine, uploads, tile)
        self._open = True

    def render(
        self, view: ScanGeometry, world_from_bodies: Pose | Sequence[Pose]
    ) -> NDArray[np.float32]:
        """Return the path lengths of one view.

        Args:
            view: exactly one view, in the world, with the panel of this renderer.
            world_from_bodies: pose of the frame of each body, then of each grey part, at exposure;
                or one pose for all.

        Returns:
            Path lengths, mm, (materials, rows * samples, columns * samples). The samples of a pixel
            are the centres of its samples x samples equal parts.

        Raises:
            ValueError: ``view`` is not one view or has another panel, or the poses do not match the
                bodies.
            TwinctError: the renderer is closed, a body reaches through the panel, the source is
                inside a body, or the engine failed.
        """
        if not self._open:
            raise TwinctError("the X-ray renderer was closed")
        if len(view) != 1:
            raise ValueError(f"render takes one view at a time, not {len(view)}")
        if view.panel != self.panel:
            raise ValueError(f"the view has {view.panel}; the renderer was made for {self.panel}")
        views = self._from_bodies(view, world_from_bodies)
        paths = np.zeros((len(self.materials), *self._fine.shape), dtype=np.float32)
        filled = [False] * len(self.materials)
        for body, material in enumerate(self._material):
            if misses(views[body], self._corners[body]):
                continue
            for row in range(0, self._fine.rows, self._tile.shape[0]):
                for column in range(0, self._fine.columns, self._tile.shape[1]):
                    self._add(body, views[body], (row, column), paths[material], filled[material])
            filled[material] = True
        for seen, (caster, into) in zip(views[len(self._material) :], self.casters, strict=True):
            caster.add(seen, into, paths)
        self._room.add(view, self._room_into, paths)
        return paths

    def _from_bodies(self, view: ScanGeometry, poses: Pose | Sequence[Pose]) -> list[ScanGeometry]:
        """Return the view in the frame of each body and grey part, where it can be rendered."""
        count = len(self._placements)
        poses = [poses] * count if isinstance(poses, Pose) else poses
        if len(poses) != count:
            raise ValueError(f"{len(poses)} poses for {count} bodies")
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


def _require_closed(parts: Sequence[tuple[str, Trimesh]]) -> None:
    faults = [f"part {quoted(name)} {why}" for name, mesh in parts if (why := mesh_fault(mesh))]
    if faults:
        raise SpecimenError(faults)


def _even(count: int) -> int:
    """Return the size of equal tiles that cover an edge."""
    return -(-count // -(-count // LARGEST_TILE))
