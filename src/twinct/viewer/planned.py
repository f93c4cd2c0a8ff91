"""Content of the page for a scenario that was not run: plan, reachable views, field of view."""

from __future__ import annotations

import trimesh

from twinct.core.errors import TrajectoryError
from twinct.core.extras import require
from twinct.core.foreign_text import counted
from twinct.evaluation import region_of_interest
from twinct.geometry import VolumeGrid
from twinct.geometry.wire import PosePairs
from twinct.robots.reach import Holder, TargetPoses
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell
from twinct.viewer.show import Show
from twinct.viewer.surface import dense_surface

COARSE_VOXELS = 64
"""Voxels along each axis of the field of view, which is convex, so that few are enough."""


def planned(builder: SimulationBuilder) -> Show:
    """Return the plan of a scenario or, if there is none, the views that the arms cannot reach.

    Raises:
        InputError: planning fails for a reason other than unreachable views.
    """
    scenario = builder.scenario
    if isinstance(scenario.cell, Cell):
        require("robots")
    try:
        plan, problems, refused = builder.plan, (), ()
    except TrajectoryError as error:
        plan, problems = None, error.problems
        poses = TargetPoses.of(builder.requested)
        holder = Holder(builder.cell, scenario.motion, roll_free=builder.roll_free)
        refused = tuple(view for view, held in enumerate(holder.held(poses)) if not held)
    views = len(builder.requested)
    if scenario.cell.kind == "gantry":
        state = f"not run; {counted(views, 'view')}, which a gantry takes exactly as commanded"
    elif plan is None:
        state = f"not run; {views - len(refused)} of {views} views are within reach; no motion plan"
    else:
        state = f"not run; {counted(views, 'view')} planned"
    if plan is None and builder.plan_chooses:
        commanded = PosePairs.from_geometry(builder.requested)
    else:
        commanded = builder.commanded_poses
    return Show(
        scenario.name,
        scenario,
        commanded,
        plan=plan,
        refused=refused,
        state=state,
        problems=problems,
    )


def field_of_view(show: Show) -> trimesh.Trimesh | None:
    """Return the surface of the region that all commanded views see, mm; None if it is empty."""
    whole = show.settings.reconstruction.volume_grid
    shape = tuple(min(n, COARSE_VOXELS) for n in whole.shape)
    voxel = [size / n for size, n in zip(whole.size_mm, shape[::-1], strict=True)]
    grid = VolumeGrid(shape, voxel, whole.world_from_grid)
    seen = region_of_interest(show.geometries[show.first_name], grid)
    return dense_surface(seen.astype("float32"), grid, 0.5, triangles=4000)
