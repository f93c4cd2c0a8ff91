"""Content of the page: first the parts that are ready, then those that take seconds to build."""

from __future__ import annotations

import logging
from threading import Thread

import numpy as np
import trimesh

from twinct.core.errors import TwinctError
from twinct.robots.cell import build_cell, build_gantry
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell
from twinct.specimen import BuiltSpecimen
from twinct.viewer.live_page import Page
from twinct.viewer.planned import field_of_view
from twinct.viewer.room import Room
from twinct.viewer.scenery import see_whole_room
from twinct.viewer.show import Show
from twinct.viewer.surface import MOST_TRIANGLES

log = logging.getLogger(__name__)


def bare_room(show: Show) -> Room | None:
    """Return the room with an empty holder, which is built at once; None for a gantry."""
    scenario = show.scenario
    if not isinstance(scenario.cell, Cell):
        return None
    place, panel = scenario.specimen.world_from_specimen, scenario.detector.panel
    return Room(build_cell(scenario.cell, None, place, panel))


def whole_room(show: Show, builder: SimulationBuilder) -> Room:
    """Return the room with the specimen's holder."""
    section = show.scenario.cell
    if isinstance(section, Cell):
        return Room(builder.cell)
    specimen, panel = builder.specimen, show.scenario.detector.panel
    place = specimen.world_from_specimen
    return Room(build_gantry(section, builder.hull, place, panel, *show.commanded[0]))


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
        see_whole_room(page.server, show.scenario.cell)
    page.put(run, show)
    if room is not None:
        page.put_room(run, room)
    thread = Thread(target=_fill_up, args=(page, run, show, builder), name="fill", daemon=True)
    thread.start()
    return thread


def _fill_up(page: Page, run: int, show: Show, builder: SimulationBuilder | None) -> None:
    page.let_draw()
    builder = builder or SimulationBuilder(show.scenario, show.plan)
    try:
        page.put_room(run, whole_room(show, builder))
        page.put_specimen(run, specimen_as_it_looks(builder.specimen))
        if not show.poses:
            page.put_field(run, field_of_view(show))
    except TwinctError as error:  # such as a mesh file that has moved since the run
        log.warning("%s", error)
        page.say(f"**the specimen is not shown: {error}**")
