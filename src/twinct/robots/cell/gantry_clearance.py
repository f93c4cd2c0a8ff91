"""Distances between source and panel of a gantry and the objects of its room, on its whole way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.core.errors import TrajectoryError
from twinct.geometry import MM_PER_M, Panel, Pose
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.clearance import Gap
from twinct.robots.cell.scene import OVERLAP_MM, build_gantry
from twinct.robots.cell.standing import OBJECT
from twinct.robots.sections import GantryCell

NAMED_VIEWS = 8
"""Views that a message names."""

Poses = tuple[Pose, Pose]
"""World poses of source and panel."""


@dataclass(frozen=True)
class _Tool:
    """Source or panel.

    Attributes:
        body: id of its body.
        tip_from_mount: pose of the body in the frame of focal spot or pixels.
        radius_mm: largest distance of a point of the housing from this frame's origin.
        geoms: ids of its solid shapes.
    """

    body: int
    tip_from_mount: Pose
    radius_mm: float
    geoms: tuple[int, ...]


class GantryClearance:
    """Gaps between the housings that pictures show and the objects that collide."""

    def __init__(self, cell: GantryCell, panel: Panel, first: Poses) -> None:
        """Build the room.

        Args:
            cell: section of the gantry.
            panel: pixel lattice, which determines the size of the housing.
            first: poses at any view.

        Raises:
            MissingExtraError: MuJoCo is not installed.
            SpecimenError: the mesh file of an object is unusable.
        """
        self._mujoco = mujoco_module()
        self._model = build_gantry(cell, None, Pose.identity(), panel, *first).model
        self._data = self._mujoco.MjData(self._model)
        self._mujoco.mj_kinematics(self._model, self._data)
        self._tools = tuple(
            self._tool(name, pose) for name, pose in zip(("source", "detector"), first, strict=True)
        )
        names = [self._model.body(body).name for body in self._model.geom_bodyid]
        self._objects = [g for g in self._solid() if names[g].startswith(OBJECT)]
        self._line = np.zeros(6)

    def at(self, poses: Poses) -> Gap:
        """Return the smallest gap where source and panel have these poses."""
        model, data = self._model, self._data
        for tool, pose in zip(self._tools, poses, strict=True):
            position, quat = (pose @ tool.tip_from_mount).to_metres()
            model.body_pos[tool.body], model.body_quat[tool.body] = position, np.roll(quat, 1)
        self._mujoco.mj_kinematics(model, data)
        gaps = (
            Gap(
                self._mujoco.mj_geomDistance(model, data, geom, other, 1e3, self._line) * MM_PER_M,
                (model.body(tool.body).name, model.body(model.geom_bodyid[other]).name),
            )
            for tool in self._tools
            for geom in tool.geoms
            for other in self._objects
        )
        return min(gaps, key=lambda gap: gap.distance_mm, default=Gap(np.inf, ("", "")))

    def over(self, views: Sequence[Poses], least_mm: float) -> list[Gap]:
        """Return the gap at each view, or one below ``least_mm`` on the way from the view before.

        On the way, source and panel move on screws at constant speed. An interval is bisected until
        the gaps at both ends prove that none on it is below ``least_mm``, or until nothing moves
        farther than ``OVERLAP_MM`` on it.
        """
        found = [self.at(poses) for poses in views]
        return [
            self._between(views[k - 1], views[k], found[k - 1], gap, least_mm) if k else gap
            for k, gap in enumerate(found)
        ]

    def _between(self, start: Poses, end: Poses, first: Gap, last: Gap, least_mm: float) -> Gap:
        """Return a gap below ``least_mm`` on the way, or else that of the end."""
        travel = 0.0
        for tool, one, other in zip(self._tools, start, end, strict=True):
            twist = (one.inverse() @ other).log()
            turn = float(np.linalg.norm(twist[3:]))
            travel = max(travel, float(np.linalg.norm(twist[:3])) + turn * tool.radius_mm)
        closest = (first.distance_mm + last.distance_mm - travel) / 2
        if last.distance_mm < least_mm or closest >= least_mm or travel <= OVERLAP_MM:
            return last
        middle = _halfway(start[0], end[0]), _halfway(start[1], end[1])
        here = self.at(middle)
        if here.distance_mm < least_mm:
            return here
        before = self._between(start, middle, first, here, least_mm)
        if before.distance_mm < least_mm:
            return before
        return self._between(middle, end, here, last, least_mm)

    def _solid(self) -> list[int]:
        model = self._model
        return np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()

    def _tool(self, name: str, tip: Pose) -> _Tool:
        model, body = self._model, self._model.body(name).id
        mount = Pose.from_metres(self._data.xpos[body], np.roll(self._data.xquat[body], -1))
        geoms = tuple(g for g in self._solid() if model.geom_bodyid[g] == body)
        centres = self._data.geom_xpos[list(geoms)] * MM_PER_M - tip.position
        reach = np.linalg.norm(centres, axis=1) + model.geom_rbound[list(geoms)] * MM_PER_M
        return _Tool(body, tip.inverse() @ mount, float(reach.max()), geoms)


def require_free_way(
    cell: GantryCell, panel: Panel, views: Sequence[Poses], least_mm: float
) -> Gap | None:
    """Return the smallest gap of a gantry's way; None if no object collides.

    Raises:
        TrajectoryError: source or panel comes too near to an object; names all views.
        MissingExtraError: MuJoCo is not installed.
        SpecimenError: the mesh file of an object is unusable.
    """
    if not any(one.collides for _, one in cell.keyed_objects):
        return None
    gaps = GantryClearance(cell, panel, views[0]).over(views, least_mm)
    close: dict[tuple[str, str], list[int]] = {}
    for view, gap in enumerate(gaps):
        if gap.distance_mm < least_mm:
            close.setdefault(gap.bodies, []).append(view)
    if close:
        problems = [_problem(bodies, on, gaps, least_mm) for bodies, on in close.items()]
        raise TrajectoryError(problems, sorted({view for on in close.values() for view in on}))
    return min(gaps, key=lambda gap: gap.distance_mm)


def _problem(
    bodies: tuple[str, str], views: Sequence[int], gaps: Sequence[Gap], least_mm: float
) -> str:
    worst = min(views, key=lambda view: gaps[view].distance_mm)
    gap = gaps[worst].distance_mm
    how = f"stands {-gap:.1f} mm deep in" if gap < 0 else f"comes within {gap:.1f} mm of"
    named = ", ".join(map(str, views[:NAMED_VIEWS])) + (", ..." * (len(views) > NAMED_VIEWS))
    return (
        f"the gantry's {bodies[0]} {how} {bodies[1]} at view {worst} or on the way to it, and "
        f"motion.clearance_mm = {least_mm:g} mm must stay free ({len(views)} views: {named}); move "
        "cell.objects, or set collides: false"
    )


def _halfway(start: Pose, end: Pose) -> Pose:
    return start @ Pose.exp(0.5 * (start.inverse() @ end).log())
