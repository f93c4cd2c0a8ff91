"""Remedies for views that the arms cannot take, and pictures of such views."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import NoPathError, TimeUpError, TrajectoryError
from twinct.core.files.writing import check_picture, storage_errors
from twinct.core.progress import SILENT, Effort, Progress, WorkSpentError, counted
from twinct.robots.cell import Marks, overlaps, render_cell
from twinct.robots.motion.feasible import Indices
from twinct.robots.reach import (
    CureSearch,
    HeldView,
    Holder,
    Remedy,
    TargetPoses,
    reasons,
    shown,
)
from twinct.robots.reach.cures import MORE
from twinct.runs.longest_arc import PATH_VIEWS, longest_arc
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Scenario

PICTURE_PX = (1000, 625)
"""Width and height of the picture of an infeasible view."""

SHARE = 0.75
"""Work of a search for a remedy as a share of the planning's, whose units are a little cheaper."""

LEAST_WORK = 12_000
"""Work of a search for a remedy, less than the room takes to build, where planning took less."""


@contextmanager
def explained(
    builder: SimulationBuilder,
    picture: Path | None = None,
    *,
    all_cures: bool = False,
    progress: Progress = SILENT,
) -> Generator[None, None, None]:
    """Add a remedy, and a picture of one view, to an error about infeasible views.

    The problem is reported before the search for a remedy, which may be interrupted. It does no
    more work than the planning did, or LEAST_WORK, unless all changes should be tried.

    Args:
        builder: simulations of the scenario that is planned in the block.
        picture: file for the picture; None: none is drawn.
        all_cures: try all changes that may help.
        progress: receives the problem, and the progress of the search.

    Raises:
        TrajectoryError: the error of the block, with more sentences.
    """
    planning = Effort()
    try:
        with counted() as planning:
            yield
    except TrajectoryError as error:
        scenario = builder.scenario
        if not isinstance(scenario.cell, Cell) or scenario.motion.plan is not None:
            raise  # no search was made for a plan from a file
        first, *others = list[str](error.problems)
        more = f", and {len(others)} more" if others else ""
        progress.say(f"{first}{more}; looking for a remedy (Ctrl-C skips this)", warning=True)
        try:
            most = np.inf if all_cures else max(SHARE * planning.units, LEAST_WORK)
            views, words = remedies(builder, error, most, progress)
        except KeyboardInterrupt:
            raise error from None
        except TimeUpError as over:
            raise TrajectoryError([*error.problems, str(over)]) from None
        if views and picture is not None:
            words += pictured(builder, picture, views[0])
        raise TrajectoryError([*error.problems, *words]) from error


def remedies(
    builder: SimulationBuilder,
    error: TrajectoryError,
    most: float = np.inf,
    progress: Progress = SILENT,
) -> tuple[list[int], list[str]]:
    """Search for remedies of an error about infeasible views.

    Args:
        builder: simulations of the refused scenario.
        error: the refusal of its plan.
        most: largest work of the search, in units of ``core.progress``.
        progress: progress display.

    Returns:
        the views that cannot be held, and sentences about remedies: those that name a change are
        each a ``Remedy``, of which ``keys_of`` returns the keys.
    """
    try:
        with counted(most):
            return _remedies(builder, error, most, progress)
    except WorkSpentError:
        return [], [f"no remedy was found in the time of planning; {MORE}"]


def _remedies(
    builder: SimulationBuilder, error: TrajectoryError, most: float, progress: Progress
) -> tuple[list[int], list[str]]:
    scenario, lost, words = builder.scenario, None, list[str]()
    assert isinstance(scenario.cell, Cell)
    if scenario.motion.scheme != "reactive":
        if not error.views:
            return [], []  # its message says what to change
        lost = () if isinstance(error, NoPathError) else error.views
        views = PATH_VIEWS if np.isfinite(most) else None
        if arc := longest_arc(builder, lost, views, blocked=error.views):
            words.append(arc)
    search = CureSearch(
        scenario.cell,
        builder.cell,
        (builder.rough_cell_of, builder.cell_of),
        scenario.motion,
        builder.roll_free,
        len(builder.requested),
        lambda some: requested_poses(builder, some),
    )
    remedies, more = reasons(search, lost, progress)
    return remedies, [*more, *words]


def keys_of(remedy: Remedy, scenario: Scenario) -> dict[str, Any]:
    """Return the keys of a scenario that a remedy changes, with plain values."""
    keys: dict[str, Any] = dict(remedy.keys)
    if remedy.scale != 1:
        section: Mapping[str, Any] = scenario.trajectory.model_dump(mode="json")
        for name in ("sod_mm", "sdd_mm"):
            now = section[name]
            scaled = np.round(remedy.scale * np.asarray(now, dtype=float), 6).tolist()
            keys[f"trajectory.{name}"] = scaled
    return keys


def held_as_well_as_can_be(builder: SimulationBuilder, view: int) -> HeldView:
    """Return the joints that hold a view or come nearest to it, and the problems in words."""
    return shown(_holder(builder), requested_poses(builder), view)


def draw_anyway(
    builder: SimulationBuilder, path: Path, view: int, width: int, height: int
) -> list[str]:
    """Draw a view, even if it is infeasible, and return its problems."""
    if isinstance(builder.scenario.cell, Cell) and (overlapping := overlaps(builder.room)):
        red = tuple(body.body for one in overlapping for body in (one.first, one.second))
        still = np.zeros(len(builder.room.joint_names))
        render_cell(builder.room, path, still, width, height, Marks(red=red))
        return [one.words for one in overlapping]
    try:
        builder.draw(path, view, width, height)
        return []
    except TrajectoryError as error:
        if not isinstance(builder.scenario.cell, Cell):
            raise
        one = shown(_holder(builder), requested_poses(builder), view)
        render_cell(builder.room, path, one.joints, width, height, one.marks)
        return list(one.words or error.problems)


def pictured(builder: SimulationBuilder, picture: Path, view: int) -> list[str]:
    """Draw a view, and return a sentence with the path of the picture."""
    check_picture(picture)
    one = shown(_holder(builder), requested_poses(builder), view)
    with storage_errors(picture):
        picture.parent.mkdir(parents=True, exist_ok=True)
        width, height = PICTURE_PX
        render_cell(builder.sketched_room, picture, one.joints, width, height, one.marks)
    return [f"picture of view {view}: {picture}"]


def requested_poses(
    builder: SimulationBuilder, views: Indices | slice = slice(None)
) -> TargetPoses:
    """Return the requested poses of source and panel in some views."""
    return TargetPoses.of(builder.requested[views])


def _holder(builder: SimulationBuilder) -> Holder:
    return Holder(builder.cell, builder.scenario.motion, roll_free=builder.roll_free)
