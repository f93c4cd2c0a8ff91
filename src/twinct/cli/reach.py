"""Commands about reach: reachable directions, positions of the arms, and infeasible views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from twinct.cli.progress import on_terminal, say
from twinct.cli.time_limit import TimeUpError
from twinct.core.errors import InputError, NoPathError, TrajectoryError
from twinct.core.extras import require
from twinct.core.files.writing import check_folder, check_picture, storage_errors
from twinct.core.progress import SILENT, Effort, Progress, WorkSpentError, counted
from twinct.geometry import fibonacci_directions
from twinct.robots.cell import overlaps, tell_if_undrawable
from twinct.robots.motion.feasible import Indices
from twinct.robots.reach import (
    Bounds,
    CureSearch,
    Holder,
    TargetPoses,
    place,
    poses_of,
    reach,
    reasons,
    shown,
)
from twinct.robots.reach.cures import MORE
from twinct.robots.reach.results import draw_room, draw_sphere, shares, write_tables
from twinct.robots.reach.sphere import check_reach_request
from twinct.runs.longest_arc import PATH_VIEWS, longest_arc
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Scenario, load_scenario, named_places, write_scenario
from twinct.trajectory import OrbitSettings

PICTURE_PX = (1000, 625)
"""Width and height of the picture of an infeasible view."""

SEARCHED_VIEWS = 60
"""Number of views of a trajectory that a search uses, spread evenly."""

SEARCHED_DIRECTIONS = 150
"""Number of directions that a search for most of the sphere uses."""

SHARE = 0.75
"""Work of a search for a remedy as a share of the planning's, whose units are a little cheaper."""

LEAST_WORK = 12_000
"""Work of a search for a remedy, less than the room takes to build, where planning took less."""

JUDGED_DIRECTIONS = 1000
"""Number of directions by which the result of a search is evaluated."""


def arms_of(scenario: Scenario) -> Cell:
    """Return the section with two arms.

    Raises:
        InputError: the cell is a gantry, which can go anywhere.
        MissingExtraError: a package that arms need is not installed.
    """
    if not isinstance(scenario.cell, Cell):
        raise InputError(f"cell.kind: {scenario.cell.kind}: reaches every pose; reach needs arms")
    require("robots")
    return scenario.cell


def _orbit(builder: SimulationBuilder) -> tuple[float, float, np.ndarray]:
    """Return SOD, ODD and isocentre, mm; for views from a file, their means about the specimen.

    If distances change along the path, its middle counts.
    """
    section = builder.scenario.trajectory
    if isinstance(section, OrbitSettings):
        sod, sdd = float(section.sod_at(0.5)), float(section.sdd_at(0.5))
        return sod, sdd - sod, np.array(section.isocentre_mm)
    centre = builder.scenario.specimen.world_from_specimen.position
    views = builder.requested
    far = [
        np.linalg.norm(points - centre, axis=1).mean() for points in (views.source, views.detector)
    ]
    return float(far[0]), float(far[1]), centre


def reach_command(
    scenario: Path,
    set_: Sequence[str],
    out: Path | None,
    radii: Sequence[float],
    odd: float | None,
    directions: int,
    connected: bool,
) -> list[dict[str, Any]]:
    """Compute the reach, print and return the shares, and write tables and pictures if asked."""
    check_reach_request(directions, radii or (1.0,), 1.0 if odd is None else odd)
    loaded = load_scenario(scenario, set_)
    arms_of(loaded)
    if out is not None:
        check_folder(out)
    builder = SimulationBuilder(loaded)
    with named_places(scenario, set_), on_terminal() as audience:
        undrawable = tell_if_undrawable(audience) if out else []
        sod, its_odd, centre = _orbit(builder)
        result = reach(
            builder.cell,
            loaded.motion,
            directions=directions,
            sod_mm=radii or (sod,),
            odd_mm=its_odd if odd is None else odd,
            isocentre_mm=centre,
            connected=connected,
            progress=audience,
        )
        rows = shares(result)
    table = Table(title=f"{loaded.name}: share of {directions} directions")
    table.add_column("SOD, mm")
    names = [n for n in ("source", "detector", "both", "connected") if f"{n}_share" in rows[0]]
    for name in (*names, "median clearance", "median joint margin"):
        table.add_column(name)
    for row in rows:
        figures = [f"{100 * row[f'{name}_share']:.1f} %" for name in names]
        gap, margin = row.get("median_clearance_mm"), row.get("median_margin_deg")
        figures += ["-" if gap is None else f"{gap:.1f} mm"]
        figures += ["-" if margin is None else f"{margin:.0f} deg"]
        table.add_row(f"{row['sod_mm']:g}", *figures)
    Console().print(table)
    if out is None:
        return rows
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        write_tables(result, out)
        for k, one in enumerate(result.sod_mm.tolist()):
            draw_sphere(result, out / f"sphere_{one:g}.png", k, loaded.name)
            if not undrawable:
                draw_room(result, builder.room, out / f"room_{one:g}.png", k, loaded.name)
    Console().print(f"wrote {out}", highlight=False)
    return rows


def place_command(
    scenario: Path,
    set_: Sequence[str],
    sphere: bool,
    save: Path | None,
    bounds: Bounds,
    samples: int,
    seed: int,
) -> dict[str, Any]:
    """Search positions, print and return the keys, and write such a scenario if requested."""
    loaded = load_scenario(scenario, set_)
    cell = arms_of(loaded)
    builder = SimulationBuilder(loaded)
    with named_places(scenario, set_), on_terminal() as audience:
        free, searched, judged = _views_to_serve(builder, sphere)
        placement = place(
            cell,
            builder.cell_of,
            loaded.motion,
            searched,
            roll_free=free,
            bounds=bounds,
            samples=samples,
            seed=seed,
            progress=audience,
        )
        before, after = (_share(builder, one, judged, free) for one in (cell, placement.cell))
    what = "directions" if sphere else "views"
    say(
        f"both arms reach {100 * before:.1f} % of {len(judged)} {what} before, {100 * after:.1f} % "
        f"after; {placement.judged} cells were judged on {len(searched)} {what}, seed {seed}"
    )
    if np.array_equal(placement.before, placement.after) and placement.cell == cell:
        say("nothing better was found: the arms stay where they are")
    for override in placement.overrides:
        say(override)
    if save is not None:
        with storage_errors(save):
            write_scenario(save, scenario, [*set_, *placement.overrides])
        say(f"wrote {save}")
    return {
        "share_before": before,
        "share_after": after,
        "judged_on": len(judged),
        "cells": placement.judged,
        "seed": seed,
        "set": list(placement.overrides),
    }


def _share(
    builder: SimulationBuilder, cell: Cell, poses: TargetPoses, free: tuple[bool, bool]
) -> float:
    """Return the share of poses that both arms hold; 0 if fixed bodies overlap."""
    model = builder.cell_of(cell)
    if overlaps(model):
        return 0.0
    return float(Holder(model, builder.scenario.motion, roll_free=free).held(poses).mean())


def _views_to_serve(
    builder: SimulationBuilder, sphere: bool
) -> tuple[tuple[bool, bool], TargetPoses, TargetPoses]:
    """Return the free rolls, the views for the search, and the views that evaluate its result."""
    if sphere:
        sod, odd, centre = _orbit(builder)
        panel = builder.scenario.detector.panel
        searched, judged = (
            poses_of(fibonacci_directions(count), sod, odd, centre, panel)
            for count in (SEARCHED_DIRECTIONS, JUDGED_DIRECTIONS)
        )
        return (True, True), searched, judged
    poses = _requested(builder)
    some = np.unique(np.linspace(0, len(poses) - 1, SEARCHED_VIEWS).astype(int))
    return builder.roll_free, poses[some], poses


def _requested(builder: SimulationBuilder, views: Indices | slice = slice(None)) -> TargetPoses:
    geometry = builder.requested[views]
    return TargetPoses.of(geometry.source_poses(), geometry.detector_poses())


@contextmanager
def explained(
    builder: SimulationBuilder, picture: Path, *, all_cures: bool = False
) -> Iterator[None]:
    """Add a remedy, and a picture of one view, to an error about infeasible views.

    The problem is reported before the search for a remedy, which may be interrupted. It does no
    more work than the planning did, or LEAST_WORK, unless all changes should be tried.

    Raises:
        TrajectoryError: the same error, with more sentences.
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
        say(f"{first}{more}; looking for a remedy (Ctrl-C skips this)", warning=True)
        try:
            most = np.inf if all_cures else max(SHARE * planning.units, LEAST_WORK)
            with on_terminal() as audience:
                views, words = remedies(builder, error, most, audience)
        except KeyboardInterrupt:
            raise error from None
        except TimeUpError as over:
            raise TrajectoryError([*error.problems, str(over)]) from None
        if views:
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
        the views that cannot be held, and sentences about remedies.
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
        lambda some: _requested(builder, some),
    )
    remedies, more = reasons(search, lost, progress)
    return remedies, [*more, *words]


def draw_anyway(
    builder: SimulationBuilder, path: Path, view: int, width: int, height: int
) -> list[str]:
    """Draw a view, even if it is infeasible, and return its problems."""
    from twinct.robots.cell import Marks, render_cell

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
        one = shown(_holder(builder), _requested(builder), view)
        render_cell(builder.room, path, one.joints, width, height, one.marks)
        return list(one.words or error.problems)


def pictured(builder: SimulationBuilder, picture: Path, view: int) -> list[str]:
    """Draw a view, and return a sentence with the path of the picture."""
    from twinct.robots.cell import render_cell

    check_picture(picture)
    one = shown(_holder(builder), _requested(builder), view)
    with storage_errors(picture):
        picture.parent.mkdir(parents=True, exist_ok=True)
        width, height = PICTURE_PX
        render_cell(builder.sketched_room, picture, one.joints, width, height, one.marks)
    return [f"picture of view {view}: {picture}"]


def _holder(builder: SimulationBuilder) -> Holder:
    return Holder(builder.cell, builder.scenario.motion, roll_free=builder.roll_free)
