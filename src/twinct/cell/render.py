"""A picture of the room."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinct.cell._mujoco import mujoco_module
from twinct.cell.scene import LARGEST_PICTURE, CellModel, GantryModel
from twinct.errors import InputError, StorageError

_ADVICE = "leave MUJOCO_GL unset, which takes EGL and needs no display"


def check_drawing() -> None:
    """Refuse, before any work, a back end that cannot draw here.

    Raises:
        InputError: ``MUJOCO_GL`` asks for a window where there is no display.
    """
    asked = os.environ.get("MUJOCO_GL", "")
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    if asked.lower() == "glfw" and not any(os.environ.get(name) for name in displays):
        raise InputError(f"MUJOCO_GL={asked} needs a display, and there is none: {_ADVICE}")


def check_picture_size(width: int, height: int) -> None:
    """Refuse what MuJoCo cannot draw, before the room is built.

    Raises:
        InputError: with one sentence for each side that is too small or too large.
    """
    sides = zip(("width", "height"), (width, height), LARGEST_PICTURE, strict=True)
    problems = [
        f"--{name} {pixels}: a picture has 1 to {most} pixels here"
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
) -> None:
    """Write a picture of the whole cell.

    Args:
        cell_model: the room.
        path_png: where to write.
        joints: joint positions, source arm first, rad; zeros, or no arms, where None.
        width: pixels.
        height: pixels.

    Raises:
        StorageError: the file cannot be written.
    """
    mujoco = mujoco_module()
    from PIL import Image

    model = cell_model.model
    data = mujoco.MjData(model)
    if joints is not None:
        data.qpos[:] = np.asarray(joints, dtype=np.float64)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = (0.0, 0.0, -0.30)
    camera.distance, camera.azimuth, camera.elevation = 2.8, 125.0, -16.0
    if isinstance(cell_model, GantryModel):
        camera.lookat[:], camera.distance = model.stat.center, 1.6 * model.stat.extent
    option = mujoco.MjvOption()
    option.geomgroup[:] = (1, 1, 1, 0, 0, 0)
    option.sitegroup[:] = 0
    try:
        drawing = mujoco.Renderer(model, height, width)
    except Exception as error:  # MuJoCo's FatalError, and what EGL's and OSMesa's loaders raise
        chosen = os.environ.get("MUJOCO_GL", "")
        raise InputError(
            f"MuJoCo cannot draw with MUJOCO_GL={chosen} ({str(error).strip() or 'no context'}): "
            f"{_ADVICE}"
        ) from error
    with drawing as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        renderer.update_scene(data, camera, option)
        pixels = renderer.render()
    try:
        Image.fromarray(pixels).save(path_png, format="PNG")
    except OSError as error:
        raise StorageError(f"{path_png}: {error.strerror or error}") from error
