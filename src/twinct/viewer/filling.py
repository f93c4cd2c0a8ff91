"""Content of the page: first the parts that are ready, then those that take seconds to build."""

from __future__ import annotations

import logging
from threading import Thread

import numpy as np
import trimesh

from twinct.core.errors import TwinctError
from twinct.robots.cell import GantryModel, build_cell, build_gantry
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, GantryCell
from twinct.specimen import BuiltSpecimen
from twinct.viewer.live_page import Page
from twinct.viewer.planned import field_of_view
from twinct.viewer.room import Room
from twinct.viewer.scenery import see_whole_room
from twinct.viewer.show import Show
from twinct.viewer.surface import MOST_TRIANGLES

log = logging.getLogger(__name__)


HOUSING_MM = 25.0
"""Length of a tube's housing in front of the focal spot, with a margin."""


def builder_of(show: Show) -> SimulationBuilder | None:
    """Return the builder of a scenario's bodies; None of a scan that has no scenario."""
    return None if show.scenario is None else SimulationBuilder(show.scenario, show.plan)


def bare_room(show: Show) -> Room | None:
    """Return the room with an empty holder, which is built at once; None without arms."""
    if not isinstance(show.cell, Cell):
        return None
    return Room(build_cell(show.cell, None, show.place, show.settings.detector.panel))


def whole_room(show: Show, builder: SimulationBuilder | None) -> Room | None:
    """Return the room with the specimen's holder.

    Without a scenario it has a tube and a panel; None if the tube would reach into the volume.
    """
    if builder is not None and isinstance(show.cell, Cell):
        return Room(builder.cell)
    grid = show.settings.reconstruction.volume_grid
    far = float(np.linalg.norm(grid.size_mm)) / 2 + HOUSING_MM
    middle = grid.world_from_grid.position
    if builder is None and any(
        np.linalg.norm(pose.position - middle) < far for pose in show.first.source
    ):
        return None
    return Room(gantry_of(show, None if builder is None else builder.hull))


def gantry_of(show: Show, mesh: trimesh.Trimesh | None) -> GantryModel:
    """Return source and panel at the first view, with a surface of the specimen, if any."""
    cell = show.cell if isinstance(show.cell, GantryCell) else _floating(show)
    return build_gantry(cell, mesh, show.place, show.settings.detector.panel, *show.first[0])


def _floating(show: Show) -> GantryCell:
    """Return a gantry for poses of an unknown machine, with the floor below all of them."""
    return GantryCell(kind="gantry", floor_z_mm=-max(1200.0, 1.5 * show.reach_mm))


def specimen_as_it_looks(specimen: BuiltSpecimen) -> trimesh.Trimesh:
    """Return the specimen's surface in its own frame, mm, simplified for browsers."""
    mesh = specimen.surface()
    if len(mesh.faces) > MOST_TRIANGLES:
        mesh = mesh.simplify_quadric_decimation(face_count=MOST_TRIANGLES)
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)


def fill(page: Page, run: int, show: Show, builder: SimulationBuilder | None = None) -> Thread:
    """Put a run on the page; return a thread that ends when the page is complete."""
    room = bare_room(show)
    if len(page.stages) == 1:
        see_whole_room(page.server, show)
    page.put(run, show)
    if room is not None:
        page.put_room(run, room)
    thread = Thread(target=_fill_up, args=(page, run, show, builder), name="fill", daemon=True)
    thread.start()
    return thread


def _fill_up(page: Page, run: int, show: Show, builder: SimulationBuilder | None) -> None:
    page.let_draw()
    builder = builder or builder_of(show)
    try:
        if (room := whole_room(show, builder)) is not None:
            page.put_room(run, room)
        if builder is not None:
            page.put_specimen(run, specimen_as_it_looks(builder.specimen))
        if not show.poses:
            page.put_field(run, field_of_view(show))
    except TwinctError as error:  # such as a mesh file that has moved since the run
        log.warning("%s", error)
        page.say(f"**the specimen is not shown: {error}**")
