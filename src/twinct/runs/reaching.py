"""Reach of a scenario's arms, and better places for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.writing import check_folder, storage_errors
from twinct.geometry import Floats, fibonacci_directions
from twinct.observers import Observers, audience_of
from twinct.robots.cell import overlaps, tell_if_undrawable
from twinct.robots.reach import (
    Bounds,
    Holder,
    Placement,
    Reach,
    SearchLimit,
    TargetPoses,
    poses_of,
)
from twinct.robots.reach import place as place_arms
from twinct.robots.reach import reach as reach_of
from twinct.robots.reach.results import draw_room, draw_sphere, write_tables
from twinct.robots.reach.sphere import check_reach_request
from twinct.runs.remedies import requested_poses
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Scenario, as_scenario
from twinct.trajectory import OrbitSettings

SEARCHED_VIEWS = 60
"""Number of views of a trajectory that a search uses, spread evenly."""

SEARCHED_DIRECTIONS = 150
"""Number of directions that a search for most of the sphere uses."""

JUDGED_DIRECTIONS = 1000
"""Number of directions by which the result of a search is evaluated."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Result of a search for places of the arms.

    Attributes:
        placement: the cell, and how it was found.
        before: share of the judged views, or directions, that both arms reach in the scenario.
        after: this share with the new places.
        judged_on: number of views, or directions, that were judged.
        searched_on: number of views, or directions, that the search used.
        moved: False if nothing better was found.
    """

    placement: Placement
    before: float
    after: float
    judged_on: int
    searched_on: int
    moved: bool

    @property
    def overrides(self) -> list[str]:
        """Changes ``KEY=VALUE`` to the scenario."""
        return self.placement.overrides


@kinds_checked
def reach(
    scenario: Scenario | str | Path,
    *,
    out: str | Path | None = None,
    radii_mm: Sequence[float] = (),
    odd_mm: float | None = None,
    directions: int = 1000,
    connected: bool = False,
    observers: Observers = (),
) -> Reach:
    """Compute which directions source and panel reach, all over the sphere.

    Source and panel may be turned about the beam.

    Args:
        scenario: the scenario, or its file.
        out: folder for reach.json, reach.csv, and pictures of the sphere and of the room.
        radii_mm: distances from the isocentre to the source; none: the scenario's.
        odd_mm: distance from the isocentre to the panel; None: the scenario's.
        directions: number of directions.
        connected: also search for collision-free paths between directions, which takes minutes.
        observers: notified of the progress.

    Raises:
        InputError: a number is out of range, or the cell is a gantry, which reaches every pose.
        MissingExtraError: the extra ``robots`` is not installed.
        StorageError: the folder cannot be written.
    """
    check_reach_request(directions, radii_mm or (1.0,), 1.0 if odd_mm is None else odd_mm)
    scenario = as_scenario(scenario)
    _arms_of(scenario)
    if out is not None:
        check_folder(out := Path(out))
    builder = SimulationBuilder(scenario)
    with audience_of(observers) as audience:
        undrawable = tell_if_undrawable(audience) if out else []
        sod, its_odd, centre = orbit_of(builder)
        result = reach_of(
            builder.cell,
            scenario.motion,
            directions=directions,
            sod_mm=radii_mm or (sod,),
            odd_mm=its_odd if odd_mm is None else odd_mm,
            isocentre_mm=centre,
            connected=connected,
            progress=audience,
        )
    if out is None:
        return result
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        write_tables(result, out)
        for k, one in enumerate(result.sod_mm.tolist()):
            draw_sphere(result, out / f"sphere_{one:g}.png", k, scenario.name)
            if not undrawable:
                draw_room(result, builder.room, out / f"room_{one:g}.png", k, scenario.name)
    return result


@kinds_checked
def place(
    scenario: Scenario | str | Path,
    *,
    sphere: bool = False,
    bounds: Bounds = Bounds(),  # noqa: B008 - frozen
    samples: int = 128,
    seed: int = 0,
    seconds: float | None = None,
    observers: Observers = (),
) -> Placed:
    """Search good places of the arms for a scenario's trajectory, or for most of the sphere.

    Args:
        scenario: the scenario, or its file.
        sphere: reach as many directions as possible; source and panel may turn about the beam.
        bounds: limits of the search.
        samples: positions of each single arm that are tried first.
        seed: seed of the search.
        seconds: time after which the search returns the best places so far; None for no limit.
        observers: notified of the progress.

    Raises:
        InputError: a number is out of range, or the cell is a gantry, which reaches every pose.
        MissingExtraError: the extra ``robots`` is not installed.
    """
    scenario = as_scenario(scenario)
    cell = _arms_of(scenario)
    builder = SimulationBuilder(scenario)
    with audience_of(observers) as audience:
        free, searched, judged = _views_to_serve(builder, sphere)
        placement = place_arms(
            cell,
            builder.cell_of,
            scenario.motion,
            searched,
            roll_free=free,
            bounds=bounds,
            samples=samples,
            seed=seed,
            limit=SearchLimit(seconds),
            progress=audience,
        )
        before, after = (_share(builder, one, judged, free) for one in (cell, placement.cell))
    moved = placement.cell != cell or not np.array_equal(placement.before, placement.after)
    return Placed(placement, before, after, len(judged), len(searched), moved)


def _arms_of(scenario: Scenario) -> Cell:
    """Return the section with two arms.

    Raises:
        InputError: the cell is a gantry, which can go anywhere.
        MissingExtraError: a package that arms need is not installed.
    """
    if not isinstance(scenario.cell, Cell):
        raise InputError(f"cell.kind: {scenario.cell.kind}: reaches every pose; reach needs arms")
    require("robots")
    return scenario.cell


def orbit_of(builder: SimulationBuilder) -> tuple[float, float, Floats]:
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
        sod, odd, centre = orbit_of(builder)
        panel = builder.scenario.detector.panel
        searched, judged = (
            poses_of(fibonacci_directions(count), sod, odd, centre, panel)
            for count in (SEARCHED_DIRECTIONS, JUDGED_DIRECTIONS)
        )
        return (True, True), searched, judged
    poses = requested_poses(builder)
    some = np.unique(np.linspace(0, len(poses) - 1, SEARCHED_VIEWS).astype(int))
    return builder.roll_free, poses[some], poses
