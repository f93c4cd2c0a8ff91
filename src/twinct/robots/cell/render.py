"""Pictures of the cell."""

from __future__ import annotations

import copy
import os
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import DrawingError, InputError, StorageError
from twinct.core.files.writing import complete, storage_errors
from twinct.core.memory import if_little
from twinct.core.progress import Progress
from twinct.core.system_libraries import EGL, apt_line, egl_is_there
from twinct.geometry import MM_PER_M, Floats, Pose
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.scene import LARGEST_PICTURE, CellModel, GantryModel
from twinct.robots.cell.solids import VISUAL_GROUP
from twinct.robots.cell.standing import OBJECT, ZONE

_ADVICE = "leave MUJOCO_GL unset to use EGL, which needs no display"
_OFF = ("disable", "disabled", "off", "false", "0")
"""Values of ``MUJOCO_GL`` with which MuJoCo does not load OpenGL."""

MOST_SHOWN = 10_000
"""Largest number of geoms and balls in one picture."""

RED = (0.90, 0.08, 0.08)
BEAM_RGBA = (0.96, 0.78, 0.31, 0.8)
LINE_RADIUS_MM = 1.5
NAME_RGBA = (0.1, 0.15, 0.2, 1.0)
SEE_THROUGH = 0.3
"""Opacity below which a body is a region, whose name is written into it."""
LONGEST_NAME = 60
"""Characters of a name in a picture; MuJoCo takes 99 bytes."""
SHOWN_GROUPS = (1, 1, 1, 0, 0, 0)
AZIMUTHS_DEG = (125, 95, 155, 65, 185, 35, 215, 5, 245)
"""Where the camera may stand, the usual place first."""
CENTRINGS = 5
"""Steps in which the camera is centred; each halves what is left, at least."""
MARGIN = 0.95
"""Share of the picture that the farthest body may reach."""
AS_CLEAR = 0.75
"""Share of the clearest view of both tools at which the camera stays at its usual place."""
GHOST_RGBA = (0.15, 0.45, 0.95, 0.35)


@dataclass(frozen=True, eq=False)
class Marks:
    """Marks that a picture shows in addition to the cell.

    Attributes:
        red: bodies drawn in red.
        ghosts: translucent copies of tools: ``source`` or ``detector``, and the target pose of its
            focal spot or panel centre.
        points: centres of small balls, (p, 3), mm.
        colours: red, green, blue and opacity of the balls in [0, 1], (p, 4).
        radius_mm: radius of the balls.
        lines: ends of thin rods, (l, 2, 3), mm.
        line_rgba: colour of the rods.
    """

    red: tuple[str, ...] = ()
    ghosts: tuple[tuple[str, Pose], ...] = ()
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    colours: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    radius_mm: float = 8.0
    lines: Floats = field(default_factory=lambda: np.zeros((0, 2, 3)))
    line_rgba: tuple[float, float, float, float] = BEAM_RGBA


def path_marks(sources: Floats) -> Marks:
    """Return marks of a path: its source positions, from dark to light, and the lines between them.

    Args:
        sources: positions of the source in their order, (views, 3), mm.
    """
    from matplotlib import colormaps

    colours = colormaps["viridis"](np.linspace(0, 1, len(sources)))
    lines = np.stack([sources[:-1], sources[1:]], axis=1)
    return Marks(points=sources, colours=colours, radius_mm=7, lines=lines)


@dataclass(frozen=True, eq=False)
class PictureContent:
    """Content of one picture in a series.

    Attributes:
        joints: joint positions, source arm first, rad; None for zeros, or without arms.
        marks: marks in addition to the cell.
        places: ``world_from_body`` by name, of bodies without joints whose pose differs from the
            model.
    """

    joints: Floats | None = None
    marks: Marks = field(default_factory=Marks)
    places: Mapping[str, Pose] = field(default_factory=dict[str, Pose])


def check_drawing() -> None:
    """Check before any work that the rendering back end can draw here.

    Raises:
        DrawingError: there is no EGL, ``MUJOCO_GL`` requires a display, and there is none, or it
            switches drawing off.
    """
    backend = os.environ.get("MUJOCO_GL", "")
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    if backend.lower() == "glfw" and not any(os.environ.get(name) for name in displays):
        raise DrawingError(f"MUJOCO_GL={backend} needs a display, and there is none: {_ADVICE}")
    if backend.lower() in _OFF and not egl_is_there():
        raise DrawingError(f"MuJoCo needs libEGL.so.1 to draw the room: {apt_line(EGL)}")
    if backend.lower() in _OFF:
        raise DrawingError(f"MUJOCO_GL={backend} switches pictures of the room off: {_ADVICE}")


def tell_if_undrawable(progress: Progress) -> list[str]:
    """Warn before any work if pictures of the room cannot be drawn here; return the warnings."""
    try:
        check_drawing()
    except DrawingError as error:
        warnings = [f"no picture of the room: {problem}" for problem in error.problems]
        for warning in warnings:
            progress.say(warning, warning=True)
        return warnings
    return []


def check_picture_size(width: int, height: int) -> None:
    """Check the size of a picture before the cell is built.

    Raises:
        InputError: a side is too small or too large; the error has one sentence for each.
    """
    sides = zip(("width", "height"), (width, height), LARGEST_PICTURE, strict=True)
    problems = [
        f"--{name} {pixels}: a picture must have 1 to {most} pixels"
        for name, pixels, most in sides
        if not 1 <= pixels <= most
    ]
    if problems:
        raise InputError(problems)


def render_cell(
    cell_model: CellModel | GantryModel,
    path_png: str | Path,
    joints: Sequence[float] | np.ndarray | None = None,
    width: int = 1600,
    height: int = 1000,
    marks: Marks | None = None,
) -> None:
    """Write a picture of the whole cell.

    Args:
        cell_model: robot cell.
        path_png: path of the picture.
        joints: joint positions, source arm first, rad; None for zeros, or without arms.
        width: pixels.
        height: pixels.
        marks: marks in addition to the cell.

    Raises:
        StorageError: the file cannot be written.
    """
    from PIL import Image

    at = None if joints is None else np.asarray(joints, dtype=np.float64)
    camera = whole_camera(cell_model, at, width / height)
    pixels = next(
        room_pictures(cell_model, [PictureContent(at, marks or Marks())], width, height, camera)
    )
    try:
        with storage_errors(Path(path_png)), complete(Path(path_png)) as draft:
            Image.fromarray(pixels).save(draft, format="PNG")
    except OSError as error:
        raise StorageError(f"{path_png}: {error.strerror or error}") from error


def room_pictures(
    cell_model: CellModel | GantryModel,
    moments: Iterable[PictureContent],
    width: int,
    height: int,
    camera: Any = None,
) -> Iterator[NDArray[np.uint8]]:
    """Yield a picture of the whole cell for each moment, (height, width, 3).

    ``camera`` is MuJoCo's; None takes the usual one.

    Raises:
        InputError: MuJoCo cannot draw here.
    """
    mujoco = mujoco_module()
    model = copy.copy(cell_model.model)
    data = mujoco.MjData(model)
    camera = camera or _camera(cell_model)
    option = mujoco.MjvOption()
    option.geomgroup[:] = SHOWN_GROUPS
    option.sitegroup[:] = 0
    red: tuple[str, ...] = ()
    renderer: Any = None
    try:
        for moment in moments:
            if renderer is None or moment.marks.red != red:
                red = moment.marks.red
                model = _reddened(cell_model.model, red)
                # Buffers of the picture's own size: those of the largest one take 0.3 s.
                model.vis.global_.offwidth, model.vis.global_.offheight = width, height
                data = mujoco.MjData(model)
                if renderer is not None:
                    renderer.close()
                renderer = _renderer(model, width, height)
            if moment.joints is not None:
                data.qpos[:] = moment.joints
            for name, pose in moment.places.items():
                position, quat = pose.to_metres()
                model.body(name).pos, model.body(name).quat = position, np.roll(quat, 1)
            mujoco.mj_forward(model, data)
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
            renderer.update_scene(data, camera, option)
            _add(renderer.scene, model, data, moment.marks)
            _add_names(renderer.scene, model, data)
            yield renderer.render()
    finally:
        if renderer is not None:
            renderer.close()


def _camera(cell_model: CellModel | GantryModel) -> Any:
    mujoco, model = mujoco_module(), cell_model.model
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    wide = isinstance(cell_model, CellModel) and cell_model.cell.room == "operating"
    camera.lookat[:], camera.distance = ((0, 0.1, -0.12), 4.6) if wide else ((0, 0, -0.30), 2.8)
    camera.azimuth, camera.elevation = AZIMUTHS_DEG[0], -16.0
    if isinstance(cell_model, GantryModel):
        camera.lookat[:], camera.distance = model.stat.center, 1.6 * model.stat.extent
    return camera


def paint_specimen(cell_model: CellModel | GantryModel, rgb: tuple[float, float, float]) -> None:
    """Give the specimen a colour in pictures."""
    model = cell_model.model
    model.mat_rgba[model.material("specimen").id, :3] = rgb


def whole_camera(cell_model: CellModel | GantryModel, joints: Floats | None, aspect: float) -> Any:
    """Return MuJoCo's camera at a place from which arms, tools, table and specimen are in sight.

    Args:
        cell_model: robot cell.
        joints: joint positions, source arm first, rad; None for zeros, or without arms.
        aspect: width of the picture over its height.
    """
    mujoco, model, camera = mujoco_module(), cell_model.model, _camera(cell_model)
    data = mujoco.MjData(model)
    if joints is not None:
        data.qpos[:] = joints
    mujoco.mj_forward(model, data)

    def seen(azimuth: float) -> float:
        """Return the share of points of the worse seen tool that nothing hides."""
        a, e = np.radians([azimuth, camera.elevation])
        forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        eye = camera.lookat - camera.distance * forward
        return min(_shown(model, data, tool, eye) for tool in ("source", "detector"))

    shares = [seen(azimuth) for azimuth in AZIMUTHS_DEG]
    best = 0 if shares[0] >= AS_CLEAR * max(shares) else int(np.argmax(shares))
    camera.azimuth = AZIMUTHS_DEG[best]
    _step_back(camera, model, data, aspect)
    return camera


def _step_back(camera: Any, model: Any, data: Any, aspect: float) -> None:
    """Centre arms, tools, table and specimen, from as far away as they need, unless they fit."""
    corners = _corners(model, data)
    a, e = np.radians([camera.azimuth, camera.elevation])
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    plane = np.stack([right, np.cross(right, forward)], axis=1)
    limits = MARGIN * np.tan(np.radians(model.vis.global_.fovy) / 2) * np.array([aspect, 1.0])

    def needed() -> float:
        """Return the least distance from the point that the camera looks at."""
        offset = corners - camera.lookat
        return float(np.max(np.max(abs(offset @ plane) / limits, axis=1) - offset @ forward))

    if needed() <= camera.distance:
        return
    for _ in range(CENTRINGS):
        offset = corners - camera.lookat
        seen = offset @ plane / (camera.distance + offset @ forward)[:, None]
        camera.lookat[:] += plane @ (seen.min(axis=0) + seen.max(axis=0)) / 2 * camera.distance
        camera.distance = needed()


def _corners(model: Any, data: Any) -> Floats:
    """Return the corners of the boxes around all visible shapes but floor, zones and objects, m."""
    corners: list[Floats] = []
    cube = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        if not SHOWN_GROUPS[model.geom_group[geom]] or name.startswith(("floor", ZONE, OBJECT)):
            continue
        middle, half = np.split(model.geom_aabb[geom], 2)
        rotation = data.geom_xmat[geom].reshape(3, 3)
        corners.append(data.geom_xpos[geom] + (middle + cube * half) @ rotation.T)
    return np.concatenate(corners)


def _shown(model: Any, data: Any, tool: str, eye: Floats) -> float:
    """Return the share of points of a tool's largest shape that no other body hides from an eye."""
    seen = np.flatnonzero(
        (model.geom_bodyid == model.body(tool).id) & np.array(SHOWN_GROUPS)[model.geom_group]
    )
    geom, hit = int(seen[model.geom_rbound[seen].argmax()]), np.zeros(1, np.int32)
    middle, half = np.split(model.geom_aabb[geom], 2)
    grid = middle + np.array(np.meshgrid(*[[-0.8, 0.0, 0.8]] * 3)).reshape(3, -1).T * half
    points = data.geom_xpos[geom] + grid @ data.geom_xmat[geom].reshape(3, 3).T
    own = 0
    for point in points:
        mujoco_module().mj_ray(
            model, data, eye, point - eye, np.array(SHOWN_GROUPS, np.uint8), 1, -1, hit
        )
        own += hit[0] >= 0 and model.geom_bodyid[hit[0]] == model.geom_bodyid[geom]
    return own / len(points)


def _renderer(model: Any, width: int, height: int) -> Any:
    check_drawing()
    try:
        return mujoco_module().Renderer(model, height, width, max_geom=MOST_SHOWN)
    except Exception as error:  # MuJoCo's FatalError, and errors of EGL's and OSMesa's loaders
        chosen = os.environ.get("MUJOCO_GL", "")
        raise DrawingError(
            f"MuJoCo cannot draw with MUJOCO_GL={chosen} ({str(error).strip() or 'no context'}): "
            f"{_ADVICE}{if_little()}"
        ) from error


def _reddened(model: Any, bodies: tuple[str, ...]) -> Any:
    """Return a copy of the model in which some bodies are red."""
    model = copy.copy(model)
    for geom in range(model.ngeom):
        if model.body(model.geom_bodyid[geom]).name in bodies:
            opacity = (
                1.0 if model.geom_matid[geom] >= 0 else 0.5
            )  # forbidden zones stay translucent
            model.geom_matid[geom] = -1
            model.geom_rgba[geom] = (*RED, opacity)
    return model


def _add_names(scene: Any, model: Any, data: Any) -> None:
    """Write the name of each translucent region: forbidden zones, and places of staff."""
    mujoco, rgba = mujoco_module(), np.array(NAME_RGBA, np.float32)
    for geom in np.flatnonzero((0 < model.geom_rgba[:, 3]) & (model.geom_rgba[:, 3] < SEE_THROUGH)):
        name = model.body(model.geom_bodyid[geom]).name
        prefix = next((prefix for prefix in (ZONE, OBJECT) if name.startswith(prefix)), None)
        if prefix is None or model.geom_group[geom] != VISUAL_GROUP or scene.ngeom >= scene.maxgeom:
            continue
        label, place, turned = scene.geoms[scene.ngeom], data.geom_xpos[geom], np.eye(3).ravel()
        mujoco.mjv_initGeom(label, mujoco.mjtGeom.mjGEOM_LABEL, np.zeros(3), place, turned, rgba)
        plain = unicodedata.normalize("NFKD", name.removeprefix(prefix)).encode("ascii", "ignore")
        label.label = plain.decode()[:LONGEST_NAME]  # MuJoCo's font has no other letters
        scene.ngeom += 1


def _add(scene: Any, model: Any, data: Any, marks: Marks) -> None:
    """Add ghosts, rods and balls to a scene."""
    mujoco = mujoco_module()

    def add(kind: Any, size: Any, position: Any, rotation: Any, rgba: Any) -> None:
        if scene.ngeom < scene.maxgeom:
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(geom, kind, size, position, rotation, np.float32(rgba))
            scene.ngeom += 1

    for side, pose in marks.ghosts:
        site, tool = model.site(side).id, model.body(side).id
        here = Pose.from_matrix(data.site_xpos[site] * MM_PER_M, data.site_xmat[site].reshape(3, 3))
        moved = pose @ here.inverse()
        for geom in np.flatnonzero(model.geom_bodyid == tool):
            position = moved.apply(data.geom_xpos[geom] * MM_PER_M) / MM_PER_M
            turned = moved.rotation @ data.geom_xmat[geom].reshape(3, 3)
            add(model.geom_type[geom], model.geom_size[geom], position, turned.ravel(), GHOST_RGBA)
    for start, end in marks.lines / MM_PER_M:
        if scene.ngeom < scene.maxgeom:
            geom, capsule = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CAPSULE
            add(capsule, np.zeros(3), np.zeros(3), np.eye(3).ravel(), marks.line_rgba)
            mujoco.mjv_connector(geom, capsule, LINE_RADIUS_MM / MM_PER_M, start, end)
    size = np.full(3, marks.radius_mm / MM_PER_M)
    for position, rgba in zip(marks.points / MM_PER_M, marks.colours, strict=True):
        add(mujoco.mjtGeom.mjGEOM_SPHERE, size, position, np.eye(3).ravel(), rgba)
