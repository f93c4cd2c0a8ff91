"""Fills the page: first what is there at once, then what takes seconds to build."""

from __future__ import annotations

import logging
from threading import Thread

import numpy as np
import trimesh

from twinct.cell import build_cell, build_gantry
from twinct.errors import TwinctError
from twinct.scan import Workshop
from twinct.scenario import Cell
from twinct.view.page import Page
from twinct.view.planned import field_of_view
from twinct.view.room import Room
from twinct.view.show import Show
from twinct.view.surface import MOST_TRIANGLES

log = logging.getLogger(__name__)


def bare_room(show: Show) -> Room | None:
    """The room with an empty holder, which takes no time; None of a gantry's."""
    scenario = show.scenario
    if not isinstance(scenario.cell, Cell):
        return None
    place, panel = scenario.specimen.world_from_specimen, scenario.detector.panel
    return Room(build_cell(scenario.cell, None, place, panel))


def whole_room(show: Show, workshop: Workshop) -> Room:
    """The room with what holds the specimen."""
    section = show.scenario.cell
    if isinstance(section, Cell):
        return Room(workshop.cell)
    specimen, panel = workshop.specimen, show.scenario.detector.panel
    place = specimen.world_from_specimen
    return Room(build_gantry(section, workshop.hull, place, panel, *show.commanded[0]))


def specimen_as_it_looks(workshop: Workshop) -> trimesh.Trimesh:
    """Its surface in its own frame, mm, with so few triangles that a browser turns it."""
    mesh = workshop.specimen.surface()
    if len(mesh.faces) > MOST_TRIANGLES:
        mesh = mesh.simplify_quadric_decimation(face_count=MOST_TRIANGLES)
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)


def fill(page: Page, run: int, show: Show, workshop: Workshop | None = None) -> Thread:
    """Put a run on the page; the thread ends when everything is there."""
    room = bare_room(show)
    page.put(run, show)
    if room is not None:
        page.put_room(run, room)
    thread = Thread(target=_fill_up, args=(page, run, show, workshop), name="fill", daemon=True)
    thread.start()
    return thread


def _fill_up(page: Page, run: int, show: Show, workshop: Workshop | None) -> None:
    page.let_draw()
    workshop = workshop or Workshop(show.scenario, show.plan)
    try:
        page.put_room(run, whole_room(show, workshop))
        page.put_specimen(run, specimen_as_it_looks(workshop))
        if not show.poses:
            page.put_field(run, field_of_view(show))
    except TwinctError as error:  # such as a mesh that is no longer where the run found it
        log.warning("%s", error)
        page.say(f"**the specimen is not shown: {error}**")
