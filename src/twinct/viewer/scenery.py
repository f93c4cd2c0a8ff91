"""Lights and initial camera of a scene, for the live page and exported pages."""

from __future__ import annotations

import viser

from twinct.geometry import MM_PER_M
from twinct.viewer.show import Show


def set_lights(server: viser.ViserServer, runs: int = 1) -> None:
    """Set lights that need no download, and a camera that sees all runs."""
    scene, camera = server.scene, server.initial_camera
    scene.configure_default_lights(False)
    scene.configure_environment_map(None)
    scene.add_light_ambient("/light/room", intensity=0.9)
    scene.add_light_hemisphere(
        "/light/sky", sky_color=(255, 255, 255), ground_color=(190, 190, 195), intensity=1.2
    )
    scene.add_light_directional(
        "/light/sun", color=(255, 250, 240), intensity=1.2, position=(1.5, -3.0, 4.0),
        cast_shadow=False,
    )  # fmt: skip
    span = 1.0 + 0.9 * (runs - 1)
    camera.position = (0.42 if runs == 1 else 0.0, -1.5 * span, 0.42 * span)
    camera.look_at = (0.0, 0.0, -0.1)


def see_whole_room(server: viser.ViserServer, show: Show) -> None:
    """Move the camera so far back that it sees the walls of an operating room, or all poses."""
    cell, camera = show.cell, server.initial_camera
    if cell is None:
        x, y, z = (2.2 * show.reach_mm / MM_PER_M * away for away in (0.27, -0.93, 0.26))
        camera.position, camera.look_at = (x, y, z), (0.0, 0.0, 0.0)
    elif cell.kind == "arms" and cell.room == "operating":
        camera.position, camera.look_at = (2.1, -2.9, 0.9), (0.0, 0.1, -0.2)
