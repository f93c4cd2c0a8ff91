"""One run on the page: its room, beam, paths and volume as nodes of viser's scene, in metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from twinct.geometry import MM_PER_M, Floats, Pose, ScanGeometry
from twinct.viewer.magnified import corners, magnified
from twinct.viewer.projection import Projections
from twinct.viewer.room import GantryPlaces, Room
from twinct.viewer.show import RECONSTRUCTION, TRUTH, Show
from twinct.viewer.slices import AXES, Plane, differences, greys, values_of

MM = 1 / MM_PER_M

COLOURS: dict[str, tuple[int, int, int]] = {
    "commanded": (120, 128, 138),
    "executed": (31, 96, 145),
    "stated": (31, 96, 145),
    "believed": (224, 122, 31),
}
OTHERS = ((46, 139, 87), (148, 82, 175), (190, 60, 90), (140, 110, 60))
REFUSED = (214, 40, 40)
REFUSED_SIZE = 3.0
"""Size of the dot of a view that the arms cannot take, relative to that of others."""

BEAM = (246, 200, 80)
IVORY = (232, 220, 190)

IN_FRONT_MM = 6.0
"""Distance of the drawn projection from the pixel plane, so that the housing does not hide it."""

DOT_MM = 2.5
_OCTAHEDRON = (
    DOT_MM * MM * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]),
    np.array(
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    ),
)
"""Corners, m, and triangles of the marker of a view on a path."""

DIFFERENCE, NOTHING = "difference", "nothing"

FLOOR_M = 4.0

LABEL_M = 0.55
"""Height of a run's name above the isocentre."""


@dataclass(frozen=True)
class Look:
    """Display settings of a run.

    Attributes:
        view: index of the view, from 0.
        geometry: geometry of the drawn beam and panel.
        factor: magnification of differences between geometries.
        beam: draw the beam.
        paths: draw the paths of the source.
        specimen: draw the true specimen.
        shown: volume of the slices, or ``difference`` or ``nothing``.
        slices: indices of the planes normal to x, y and z.
        window: grey window of the slices, 1/mm.
        surface: volume of the drawn surface, or ``nothing``.
        level: level of the surface, 1/mm.
    """

    view: int = 0
    geometry: str = "executed"
    factor: float = 1.0
    beam: bool = True
    paths: bool = True
    specimen: bool = True
    shown: str = RECONSTRUCTION
    slices: tuple[int, int, int] = (0, 0, 0)
    window: tuple[float, float] = (0.0, 1.0)
    surface: str = NOTHING
    level: float = 0.0


class Stage:
    """One run in the scene."""

    def __init__(self, server: viser.ViserServer, name: str, offset_m: Floats) -> None:
        """Add an empty stage; ``name`` of its node, ``offset_m`` of its isocentre."""
        self._scene = server.scene
        self._root = f"/{name}"
        self.offset_m = np.asarray(offset_m, dtype=float)
        self._scene.add_frame(self._root, show_axes=False, position=self.offset_m)
        self._bodies: list[Any] = []
        self._places: list[tuple[bytes, bytes]] = []
        self._room: Room | None = None
        self._gantry: GantryPlaces | None = None
        self._nodes: dict[str, Any] = {}
        self._projections: Projections | None = None
        self._named = 0
        self.clicked: Any = None
        """Callback for clicks, with the object's kind and details, and the ray of the click."""

    def set_room(self, show: Show, room: Room) -> None:
        """Replace all bodies by a room's bodies."""
        kept = self._room is not None and _same_bodies(self._room, room)
        self._room, self._places = room, [(b"", b"")] * len(room.bodies)
        has_arms = show.cell is not None and show.cell.kind == "arms"
        self._gantry = None if has_arms else GantryPlaces(room, *show.first[0], show.c_arm)
        for node in () if kept else self._bodies:
            node.remove()
        self._bodies = self._bodies if kept else []
        for body in () if kept else room.bodies:
            node = self._scene.add_mesh_trimesh(self._fresh(f"room/{body.name}"), body.mesh)
            self._clickable(node, "body", body.name)
            self._bodies.append(node)
        if "floor" not in self._nodes and show.cell is not None:
            height = show.cell.floor_z_mm * MM
            self._nodes["floor"] = self._scene.add_grid(
                f"{self._root}/floor", FLOOR_M, FLOOR_M, cell_size=0.25, section_size=1.0,
                plane="xy", position=(0.0, 0.0, height - 0.002), cell_color=(222, 226, 230),
                section_color=(196, 202, 208), shadow_opacity=0.0,
            )  # fmt: skip

    def set_specimen(self, mesh: trimesh.Trimesh) -> None:
        """Set the surface of the specimen, in its own frame, mm."""
        self._mesh("specimen", mesh, IVORY, None)

    def set_field_of_view(self, mesh: trimesh.Trimesh | None) -> None:
        """Set the surface of the region that every view sees, mm."""
        if mesh is not None:
            self._mesh("field of view", mesh, (70, 150, 220), 0.25)

    def move(self, joints: Floats) -> None:
        """Move only the arms, during a move."""
        if self._room is not None:
            self._put_bodies(*self._room.at(joints))

    def draw(self, show: Show, look: Look, before: Look | None) -> None:
        """Draw a look; only the changes from ``before``, or everything if ``before`` is None."""

        def changed(*names: str) -> bool:
            return before is None or any(getattr(look, n) != getattr(before, n) for n in names)

        view = min(look.view, len(show) - 1)
        if changed("view"):
            self._draw_arms(show, view)
        node = self._nodes.get("specimen")
        if node is not None and node.visible != look.specimen:
            node.visible = look.specimen
        if changed("view", "geometry", "factor", "beam"):
            self._draw_beam(show, look, view)
        if changed("geometry", "factor", "paths", "view"):
            self._draw_marks(show, look, view)
        if changed("factor", "paths"):
            self._draw_paths(show, look)
        for axis in range(3):
            moved = before is None or look.slices[axis] != before.slices[axis]
            if moved or changed("shown", "window"):
                self._draw_slice(show, look, axis)

    def set_surface(self, mesh: trimesh.Trimesh | None, opacity: float | None = None) -> None:
        """Set the surface of a volume, world mm; None removes it."""
        if mesh is None:
            self._remove("surface")
            return
        self._mesh("surface", mesh, IVORY, opacity)

    def _draw_arms(self, show: Show, view: int) -> None:
        if self._room is not None:
            if self._gantry is not None:
                self._put_bodies(*self._gantry.at(*show.poses_at(view)))
            else:
                self._put_bodies(*self._room.at(show.joints_at(view)))
        if (node := self._nodes.get("specimen")) is not None:
            known = show.objects[view] if view < len(show.objects) else None
            _place(node, known or show.place)
        text = f"{show.name}: view {view} of {len(show)}"
        if "label" not in self._nodes:
            at = np.array([0.0, 0.0, LABEL_M if show.cell else 1.2 * show.reach_mm * MM])
            self._nodes["label"] = self._scene.add_label(
                f"{self._root}/label", text, position=at, anchor="bottom-center"
            )
        else:
            self._nodes["label"].text = text

    def _put_bodies(self, positions: Floats, quats: Floats) -> None:
        for index, node in enumerate(self._bodies):
            place = positions[index].tobytes(), quats[index].tobytes()
            if place != self._places[index]:
                node.position, node.wxyz = positions[index], quats[index]
                self._places[index] = place

    def shown_geometry(self, show: Show, look: Look, view: int) -> tuple[str, ScanGeometry, int]:
        """Return name, magnified geometry as drawn, and index of the view in it."""
        name, geometry = show.geometry(look.geometry, view)
        taken, one = show.taken, geometry[view]
        if taken is not None and view < len(taken):
            one = _as_far_as_can_be(taken[view], one, look.factor)
        return name, one, 0

    def _draw_beam(self, show: Show, look: Look, view: int) -> None:
        _, one, _ = self.shown_geometry(show, look, view)
        source, walk = one.source[0] * MM, corners(one, 0) * MM
        rim = np.roll(walk, -1, axis=0)
        lines = np.stack([np.repeat(source[None], 4, axis=0), walk], axis=1)
        lines = np.concatenate([lines, np.stack([walk, rim], axis=1)])
        cone = np.concatenate([source[None], walk])
        if "beam" not in self._nodes:
            faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]])
            self._nodes["beam"] = self._scene.add_mesh_simple(
                f"{self._root}/beam/cone", cone, faces, color=BEAM, opacity=0.13, side="double",
                flat_shading=True, cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            self._nodes["edges"] = self._scene.add_line_segments(
                f"{self._root}/beam/edges", lines, BEAM, thickness=0.002
            )
        else:
            self._nodes["beam"].vertices = cone.astype(np.float32)
            self._nodes["edges"].points = lines.astype(np.float32)
        for name in ("beam", "edges"):
            if self._nodes[name].visible != look.beam:
                self._nodes[name].visible = look.beam
        self._draw_projection(show, one, view)

    def _draw_projection(self, show: Show, one: ScanGeometry, view: int) -> None:
        if self._projections is None:
            self._projections = Projections(show)
        self._projections.show = show
        picture = self._projections.at(view)
        pose = one.detector_poses()[0]
        front = pose.position + IN_FRONT_MM * one.normal[0]
        placed = Pose(front, pose.quat)
        width, height = (edge * MM for edge in one.panel.size_mm)
        if "projection" not in self._nodes:
            node = self._scene.add_image(
                f"{self._root}/projection", picture, width, height, format="jpeg", jpeg_quality=85
            )
            self._nodes["projection"] = node
            self._clickable(node, "projection", "")
        else:
            self._nodes["projection"].image = picture
        _place(self._nodes["projection"], placed)

    def _draw_paths(self, show: Show, look: Look) -> None:
        taken = show.taken
        for name, geometry in show.geometries.items():
            key = f"path {name}"
            if taken is not None and len(geometry) == len(taken):
                geometry = _as_far_as_can_be(taken, geometry, look.factor)
            elif taken is not None and name == show.first_name:
                near = _as_far_as_can_be(taken, geometry[: len(taken)], look.factor)
                geometry = ScanGeometry.joined([near, geometry[len(taken) :]])
            points = geometry.source * MM
            if len(points) < 2:
                continue
            lines = np.stack([points[:-1], points[1:]], axis=1)
            if key not in self._nodes:
                self._nodes[key] = self._scene.add_line_segments(
                    f"{self._root}/paths/{name}/line", lines, colour_of(name, show), thickness=0.002
                )
            self._nodes[key].points = lines.astype(np.float32)
            self._draw_dots(show, name, points)
            for kind in ("path", "dots"):
                if self._nodes[f"{kind} {name}"].visible != look.paths:
                    self._nodes[f"{kind} {name}"].visible = look.paths
        gone = {name for kind, _, name in (key.partition(" ") for key in self._nodes)
                if kind in ("path", "dots", "ball") and name not in show.geometries}  # fmt: skip
        for key in [f"{kind} {name}" for name in gone for kind in ("path", "dots", "ball")]:
            self._remove(key)
        self._remove("refused")
        if show.refused:
            points = show.geometries[show.first_name].source[list(show.refused)] * MM
            self._nodes["refused"] = self._add_dots("refused", points, REFUSED, REFUSED_SIZE)
            self._clickable(self._nodes["refused"], "path", show.first_name)

    def _draw_dots(self, show: Show, name: str, points: Floats) -> None:
        """Draw a dot at each view of a path, because lines cannot be clicked."""
        key = f"dots {name}"
        if key in self._nodes and len(self._nodes[key].batched_positions) == len(points):
            self._nodes[key].batched_positions = points.astype(np.float32)
            return
        self._remove(key)
        self._nodes[key] = self._add_dots(f"paths/{name}/views", points, colour_of(name, show))
        self._clickable(self._nodes[key], "path", name)

    def _add_dots(
        self, name: str, points: Floats, colour: tuple[int, int, int], size: float = 1.0
    ) -> Any:
        corners_m, triangles = _OCTAHEDRON
        return self._scene.add_batched_meshes_simple(
            self._fresh(name), size * corners_m, triangles,
            batched_wxyzs=np.tile((1.0, 0.0, 0.0, 0.0), (len(points), 1)),
            batched_positions=points, batched_colors=colour,
            flat_shading=True, lod="off", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _draw_marks(self, show: Show, look: Look, view: int) -> None:
        """Draw a ball at the focal spot of each geometry."""
        for name in show.geometries:
            key = f"ball {name}"
            if show.geometry(name, view)[0] != name:
                self._remove(key)
                continue
            _, one, _ = self.shown_geometry(show, Look(view, name, look.factor), view)
            if key not in self._nodes:
                self._nodes[key] = self._scene.add_icosphere(
                    self._fresh(f"balls/{name}"),
                    radius=0.006,
                    color=colour_of(name, show),
                    subdivisions=2,
                )
            self._nodes[key].position = one.source[0] * MM
            if self._nodes[key].visible != look.paths:
                self._nodes[key].visible = look.paths

    def _draw_slice(self, show: Show, look: Look, axis: int) -> None:
        key = f"slice {AXES[axis]}"
        name = RECONSTRUCTION if look.shown == DIFFERENCE else look.shown
        volume = show.volumes.get(name)
        if volume is None or (look.shown == DIFFERENCE and TRUTH not in show.volumes):
            self._remove(key)
            return
        plane = Plane.of(volume.grid, axis, look.slices[axis])
        picture = slice_picture(show, look.shown, plane, look.window)
        width, height = (edge * MM for edge in plane.size_mm)
        if key not in self._nodes:
            self._nodes[key] = self._scene.add_image(
                self._fresh(f"slices/{AXES[axis]}"), picture, width, height,
                format="jpeg", jpeg_quality=85,
            )  # fmt: skip
            self._clickable(self._nodes[key], "slice", AXES[axis])
        else:
            self._nodes[key].image = picture
        _place(self._nodes[key], plane.world_from_plane)

    def _mesh(self, key: str, mesh: trimesh.Trimesh, colour: Any, opacity: float | None) -> None:
        self._remove(key)
        node = self._scene.add_mesh_simple(
            self._fresh(key),
            np.asarray(mesh.vertices, np.float32) * np.float32(MM),
            np.asarray(mesh.faces, np.uint32),
            color=colour, opacity=opacity, side="double",
        )  # fmt: skip
        self._nodes[key] = node
        if opacity is None:
            self._clickable(node, key, "")

    def _fresh(self, name: str) -> str:
        """Return a new scene name, because browsers confuse names that are reused too soon."""
        self._named += 1
        return f"{self._root}/{name.replace(' ', '_')}/{self._named}"

    def _clickable(self, node: Any, kind: str, detail: str) -> None:
        @node.on_click
        def _(event: Any) -> None:
            if self.clicked is not None:
                origin = (np.array(event.ray_origin) - self.offset_m) * MM_PER_M
                self.clicked(kind, detail, origin, np.array(event.ray_direction))

    def _remove(self, key: str) -> None:
        if (node := self._nodes.pop(key, None)) is not None:
            node.remove()


def colour_of(name: str, show: Show) -> tuple[int, int, int]:
    """Return the fixed colour of a geometry."""
    if name in COLOURS:
        return COLOURS[name]
    others = [known for known in show.geometries if known not in COLOURS]
    return OTHERS[others.index(name) % len(OTHERS)] if name in others else OTHERS[0]


def slice_picture(
    show: Show, shown: str, plane: Plane, window: tuple[float, float]
) -> NDArray[np.uint8]:
    """Return a picture of a volume's plane, or of its difference from the truth."""
    if shown != DIFFERENCE:
        return greys(values_of(show.volumes[shown], plane), window)
    volume, truth = show.volumes[RECONSTRUCTION], show.volumes[TRUTH]
    values = values_of(volume, plane) - values_of(truth, plane)
    return differences(values, (window[1] - window[0]) / 2)


def _as_far_as_can_be(reference: ScanGeometry, other: ScanGeometry, factor: float) -> ScanGeometry:
    """Magnify differences unless that would turn a panel round."""
    try:
        return magnified(reference, other, factor)
    except ValueError:
        return other


def _same_bodies(one: Room, other: Room) -> bool:
    """Return True if two rooms differ in the places of their bodies only, which are sent soon."""
    return [body.name for body in one.bodies] == [body.name for body in other.bodies] and all(
        np.array_equal(mine.mesh.vertices, its.mesh.vertices)
        and np.array_equal(_colour(mine.mesh), _colour(its.mesh))
        for mine, its in zip(one.bodies, other.bodies, strict=True)
    )


def _colour(mesh: trimesh.Trimesh) -> Any:
    """Return the colour of a body's material; of a picture on it, None."""
    return getattr(getattr(mesh.visual, "material", None), "baseColorFactor", None)


def _place(node: Any, pose: Pose) -> None:
    position, quat = pose.to_metres()
    node.position, node.wxyz = position, quat[[3, 0, 1, 2]]
