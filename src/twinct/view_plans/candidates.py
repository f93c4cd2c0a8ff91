"""Candidate views of a plan: views all over the sphere, and the reachable ones among them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.progress import Progress
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.robots.motion import moving_seconds, speeds_of
from twinct.robots.reach import Holder, TargetPoses
from twinct.scan import SimulationBuilder
from twinct.scenario import AnyTrajectory, Cell
from twinct.trajectory import OrbitSettings, UniformTrajectory, commanded_views
from twinct.view_plans.search_work import spread
from twinct.workers import Pool

TOGETHER = 40
"""Number of candidates whose reach is checked as one piece of work."""

if TYPE_CHECKING:
    from twinct.robots.motion.branches import Configurations
    from twinct.robots.reach import Holder


def orbit_of(trajectory: AnyTrajectory) -> OrbitSettings:
    """Return a trajectory about an isocentre.

    Raises:
        InputError: the trajectory has no isocentre.
    """
    if not isinstance(trajectory, OrbitSettings):
        raise InputError(
            f"trajectory.kind: {trajectory.kind}: candidates need an isocentre and distances; "
            "choose a kind that has them, such as sinusoid"
        )
    return trajectory


def candidates_of(orbit: OrbitSettings, views: int, panel: Panel) -> ScanGeometry:
    """Return views all over the sphere, with SOD and SDD of an orbit."""
    section = UniformTrajectory(
        kind="uniform",
        views=views,
        isocentre_mm=orbit.isocentre_mm,
        sod_mm=float(orbit.sod_at(0.5)),
        sdd_mm=float(orbit.sdd_at(0.5)),
        latitude_range_deg=(-90.0, 90.0),
    )
    return commanded_views(section, panel)


def own_path(orbit: OrbitSettings, views: int, panel: Panel) -> ScanGeometry:
    """Return an orbit with another number of views."""
    return commanded_views(orbit.model_copy(update={"views": views}), panel)


def reachable(
    builder: SimulationBuilder, geometry: ScanGeometry, progress: Progress, pool: Pool | None = None
) -> NDArray[np.intp]:
    """Return the indices of candidates that both arms can reach together, with clearance.

    Args:
        builder: builder of the scenario.
        geometry: the candidates.
        progress: receives the progress.
        pool: processes that do the work; None: this process.
    """
    if not isinstance(builder.scenario.cell, Cell):
        return np.arange(len(geometry))
    starts = range(0, len(geometry), TOGETHER)
    pieces = (geometry[start : start + TOGETHER] for start in starts)
    within_reach: list[NDArray[np.intp]] = []
    with progress.stage("views within reach", len(starts)) as step:
        for start, held in zip(starts, spread(_held, builder, pieces, pool), strict=True):
            within_reach.append(start + held)
            step()
    return np.concatenate(within_reach)


def _held(builder: SimulationBuilder, geometry: ScanGeometry) -> NDArray[np.intp]:
    holder, of_arms = _holding(builder, geometry)
    alone = set(of_arms[0].pose.tolist()) & set(of_arms[1].pose.tolist())
    held = [view for view in sorted(alone) if len(holder.pairs(of_arms[0], of_arms[1], view))]
    return np.array(held, np.intp)


def seconds_between(builder: SimulationBuilder, geometry: ScanGeometry) -> Floats:
    """Return the minimum time of both arms between all pairs of views, s, (views, views).

    NaN from and to views that one of the arms cannot reach.
    """
    _, of_arms = _holding(builder, geometry)
    held = np.intersect1d(of_arms[0].pose, of_arms[1].pose)
    joints = [[of.joints[of.pose == view] for view in held] for of in of_arms]
    seconds = np.full((len(geometry), len(geometry)), np.nan)
    if len(held):
        seconds[np.ix_(held, held)] = moving_seconds(joints, speeds_of(builder.cell))
    return seconds


def _holding(
    builder: SimulationBuilder, geometry: ScanGeometry
) -> tuple[Holder, tuple[Configurations, Configurations]]:
    """Return the solver of joint configurations, and the configurations of each arm alone."""
    holder = Holder(builder.cell, builder.scenario.motion, roll_free=builder.roll_free)
    poses = TargetPoses.of(geometry)
    return holder, (holder.alone(poses.source, 0), holder.alone(poses.detector, 1))
