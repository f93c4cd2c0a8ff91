"""Views that a plan may choose from: all over the sphere, and those that the arms can have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.errors import InputError
from twinct.geometry import Floats, ScanGeometry
from twinct.pool import Pool
from twinct.progress import Progress
from twinct.runs.view_work import spread
from twinct.scan import Workshop
from twinct.scenario import Cell, Scenario
from twinct.trajectory import OrbitSettings, UniformTrajectory, commanded_views

TOGETHER = 40
"""Candidates whose reach is looked at as one piece of work."""

if TYPE_CHECKING:
    from twinct.motion.branches import Configurations
    from twinct.reach import Holder


def orbit_of(scenario: Scenario) -> OrbitSettings:
    """The scenario's path.

    Raises:
        InputError: it is none about an isocentre.
    """
    section = scenario.trajectory
    if not isinstance(section, OrbitSettings):
        raise InputError(
            f"trajectory.kind: {section.kind}: candidates need an isocentre and distances: take a "
            "kind that has them, such as sinusoid"
        )
    return section


def candidates_of(scenario: Scenario) -> ScanGeometry:
    """Views all over the sphere, at the distances of the scenario's path."""
    orbit, task = orbit_of(scenario), scenario.task
    assert task is not None
    section = UniformTrajectory(
        kind="uniform",
        views=task.candidates,
        isocentre_mm=orbit.isocentre_mm,
        sod_mm=float(orbit.sod_at(0.5)),
        sdd_mm=float(orbit.sdd_at(0.5)),
        latitude_range_deg=(-90.0, 90.0),
    )
    return commanded_views(section, scenario.detector.panel)


def own_path(scenario: Scenario, views: int) -> ScanGeometry:
    """The scenario's path with another number of views."""
    section = orbit_of(scenario).model_copy(update={"views": views})
    return commanded_views(section, scenario.detector.panel)


def reachable(
    workshop: Workshop, geometry: ScanGeometry, progress: Progress, pool: Pool | None = None
) -> NDArray[np.intp]:
    """Candidates that both arms can hold at a time, with the clearance that a way keeps.

    Args:
        workshop: of the scenario.
        geometry: the candidates.
        progress: hears how far it is.
        pool: other processes that look; this one, if there is none.
    """
    if not isinstance(workshop.scenario.cell, Cell):
        return np.arange(len(geometry))
    starts = range(0, len(geometry), TOGETHER)
    pieces = (geometry[start : start + TOGETHER] for start in starts)
    found: list[NDArray[np.intp]] = []
    with progress.stage("views within reach", len(starts)) as step:
        for start, held in zip(starts, spread(_held, workshop, pieces, pool), strict=True):
            found.append(start + held)
            step()
    return np.concatenate(found)


def _held(workshop: Workshop, geometry: ScanGeometry) -> NDArray[np.intp]:
    holder, of_arms = _holding(workshop, geometry)
    alone = set(of_arms[0].pose.tolist()) & set(of_arms[1].pose.tolist())
    held = [view for view in sorted(alone) if len(holder.pairs(of_arms[0], of_arms[1], view))]
    return np.array(held, np.intp)


def seconds_between(workshop: Workshop, geometry: ScanGeometry) -> Floats:
    """How long both arms take from view to view at least, s, (views, views).

    Not a number from and to views that one of the arms cannot hold.
    """
    from twinct.motion import moving_seconds, speeds_of

    _, of_arms = _holding(workshop, geometry)
    held = np.intersect1d(of_arms[0].pose, of_arms[1].pose)
    joints = [[of.joints[of.pose == view] for view in held] for of in of_arms]
    seconds = np.full((len(geometry), len(geometry)), np.nan)
    if len(held):
        seconds[np.ix_(held, held)] = moving_seconds(joints, speeds_of(workshop.cell))
    return seconds


def _holding(
    workshop: Workshop, geometry: ScanGeometry
) -> tuple[Holder, tuple[Configurations, Configurations]]:
    """What of each arm alone holds views."""
    from twinct.reach import Holder, Poses

    holder = Holder(workshop.cell, workshop.scenario.motion, roll_free=workshop.roll_free)
    poses = Poses.of(geometry.source_poses(), geometry.detector_poses())
    return holder, (holder.alone(poses.source, 0), holder.alone(poses.detector, 1))


def spread_evenly(sources: Floats, number: int) -> list[int]:
    """Views spread evenly: each the farthest from those before (Gonzalez 1985)."""
    chosen = [0]
    far = np.linalg.norm(sources - sources[0], axis=1)
    while len(chosen) < number:
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(sources - sources[chosen[-1]], axis=1))
    return chosen
