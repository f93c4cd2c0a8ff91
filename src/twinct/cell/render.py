"""A picture of the room."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinct.cell._mujoco import mujoco_module
from twinct.cell.scene import LARGEST_PICTURE, CellModel
from twinct.errors import InputError, StorageError


def check_picture_size(width: int, height: int) -> None:
    """Refuse what MuJoCo cannot draw, before the room is built.

    Raises:
        InputError: with one sentence for each side that is too small or too large.
    """
    problems = [
        f"--{name} {pixels}: a picture has 1 to {most} pixels here"
        for name, pixels, most in zip(
            ("width", "height"), (width, height), LARGEST_PICTURE, strict=True
        )
        if not 1 <= pixels <= most
    ]
    if problems:
        raise InputError(problems)


def render_cell(
    cell_model: CellModel,
    path_png: str | Path,
    joints: Sequence[float] | np.ndarray | None = None,
    width: int = 1600,
    height: int = 1000,
) -> None:
    """Write a picture of the whole cell.

    Args:
        cell_model: the room.
        path_png: where to write.
        joints: joint positions, source arm first, rad; zeros where None.
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
    option = mujoco.MjvOption()
    option.geomgroup[:] = (1, 1, 1, 0, 0, 0)
    option.sitegroup[:] = 0
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        renderer.update_scene(data, camera, option)
        pixels = renderer.render()
    try:
        Image.fromarray(pixels).save(path_png, format="PNG")
    except OSError as error:
        raise StorageError(f"{path_png}: {error.strerror or error}") from error
