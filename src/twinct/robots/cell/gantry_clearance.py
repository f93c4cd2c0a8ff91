"""Distances between a gantry and the bodies of its room, on its whole way from view to view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Protocol

import numpy as np

from twinct.core.errors import TrajectoryError
from twinct.geometry import MM_PER_M, Floats, Panel, Pose
from twinct.robots.c_arm import CARRIERS, CArmKinematics, named_views
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.c_arm_bodies import COLUMN
from twinct.robots.cell.clearance import Gap
from twinct.robots.cell.scene import OVERLAP_MM, build_gantry
from twinct.robots.cell.standing import OBJECT
from twinct.robots.sections import GantryCell

if TYPE_CHECKING:
    import trimesh

Poses = tuple[Pose, Pose]
"""World poses of source and panel."""

TOOLS = ("source", "detector")


class _Machine(Protocol):
    """Motion of the bodies of a gantry; a state is a row of numbers."""

    def states(self, views: Sequence[Poses]) -> Floats:
        """Return the state at each view, (views, n)."""
        ...

    def places(self, state: Floats) -> dict[str, Pose]:
        """Return the poses of the moving parts, source and panel by the frames of their tips."""
        ...

    def halfway(self, start: Floats, end: Floats) -> Floats:
        """Return the state in the middle of the way from one state to another."""
        ...

    def travel_mm(self, start: Floats, end: Floats, radii_mm: Mapping[str, float]) -> float:
        """Return a bound on the way of any point of the parts, whose radii are given by name."""
        ...


class _Floating:
    """Source and panel float in the air, and move on screws; a state is their poses."""

    def states(self, views: Sequence[Poses]) -> Floats:
        return np.array([[*source.seven, *panel.seven] for source, panel in views])

    def places(self, state: Floats) -> dict[str, Pose]:
        both = state[:7].tolist(), state[7:].tolist()
        return {name: Pose.from_seven(seven) for name, seven in zip(TOOLS, both, strict=True)}

    def halfway(self, start: Floats, end: Floats) -> Floats:
        one, other = self.places(start), self.places(end)
        middle = (one[name] @ Pose.exp(0.5 * _twist(one[name], other[name])) for name in TOOLS)
        return self.states([(next(middle), next(middle))])[0]

    def travel_mm(self, start: Floats, end: Floats, radii_mm: Mapping[str, float]) -> float:
        one, other = self.places(start), self.places(end)
        twists = {name: _twist(one[name], other[name]) for name in TOOLS}
        return max(
            float(np.linalg.norm(twist[:3]) + np.linalg.norm(twist[3:]) * radii_mm[name])
            for name, twist in twists.items()
        )


class _CArm:
    """A C-arm moves all of its joints at once; a state is their positions."""

    def __init__(self, kinematics: CArmKinematics) -> None:
        self._kinematics = kinematics
        section = kinematics.section
        self._arm_mm = max(section.sod_mm, section.sdd_mm - section.sod_mm)

    def states(self, views: Sequence[Poses]) -> Floats:
        return self._kinematics.joints(views)

    def places(self, state: Floats) -> dict[str, Pose]:
        tools = self._kinematics.tools(state)
        return self._kinematics.carriers(state) | dict(zip(TOOLS, tools, strict=True))

    def halfway(self, start: Floats, end: Floats) -> Floats:
        return (start + end) / 2

    def travel_mm(self, start: Floats, end: Floats, radii_mm: Mapping[str, float]) -> float:
        rotation, orbit, lift, *turns = np.abs(end - start).tolist()
        tool = max(radii_mm[name] for name in TOOLS)
        # Radii of the carriers are about the isocentre.
        far = max(self._arm_mm + tool, *(radii_mm[name] for name in CARRIERS))
        return lift + (rotation + orbit) * far + max(turns) * tool


@dataclass(frozen=True)
class _Part:
    """A body that moves.

    Attributes:
        body: its id.
        place_from_body: pose of the body in the frame whose pose the machine states.
        radius_mm: largest distance of a point of its shapes from this frame's origin.
        geoms: ids of its solid shapes.
    """

    body: int
    place_from_body: Pose
    radius_mm: float
    geoms: tuple[int, ...]


class GantryClearance:
    """Gaps between the parts of a gantry that pictures show and the bodies that collide.

    Source and panel that float keep away from objects. A C-arm also keeps away from floor and
    specimen, and its source and panel from its sleeve and column.
    """

    def __init__(
        self,
        cell: GantryCell,
        panel: Panel,
        first: Poses,
        world_from_specimen: Pose | None = None,
        solids: Sequence[trimesh.Trimesh] = (),
    ) -> None:
        """Build the room.

        Args:
            cell: section of the gantry.
            panel: pixel lattice, which determines the size of the housing.
            first: poses at any view.
            world_from_specimen: pose of the specimen.
            solids: convex bodies of the specimen, in its own frame, mm.

        Raises:
            MissingExtraError: MuJoCo is not installed.
            SpecimenError: the mesh file of an object is unusable.
        """
        self._mujoco = mujoco_module()
        place = world_from_specimen or Pose.identity()
        look = solids[0] if solids else None
        self._model = build_gantry(cell, look, place, panel, *first, solids=solids).model
        self._data = self._mujoco.MjData(self._model)
        self._mujoco.mj_kinematics(self._model, self._data)
        self._names = [self._model.body(body).name for body in range(self._model.nbody)]
        self._line = np.zeros(6)
        at_first = dict(zip(TOOLS, first, strict=True))
        self._machine: _Machine = _Floating()
        beside = (OBJECT,)
        if cell.c_arm is not None:
            kinematics = CArmKinematics(cell.c_arm)
            self._machine, beside = _CArm(kinematics), (OBJECT, "floor", "specimen")
            at_first |= kinematics.carriers(kinematics.nearest(*first))
        self._parts = {name: self._part(name, pose) for name, pose in at_first.items()}
        self._radii = {name: part.radius_mm for name, part in self._parts.items()}
        self._pairs = [
            (geom, other)
            for part in self._parts.values()
            for geom in part.geoms
            for other in self._geoms_of(beside)
        ]
        still = self._geoms_of((COLUMN,))
        self._pairs += [(geom, other) for geom in still for other in self._geoms_of((OBJECT,))]
        carried = self._geoms_of((CARRIERS[1], CARRIERS[2], COLUMN))
        tools = (geom for name in TOOLS for geom in self._parts[name].geoms)
        self._pairs += [(geom, other) for geom in tools for other in carried]

    def at(self, poses: Poses) -> Gap:
        """Return the smallest gap where source and panel have these poses.

        Raises:
            TrajectoryError: a C-arm cannot hold them.
        """
        return self._at(self._machine.states([poses])[0])

    def over(self, views: Sequence[Poses], least_mm: float) -> list[Gap]:
        """Return the gap at each view, or one below ``least_mm`` on the way from the view before.

        On the way, source and panel move on screws at constant speed, or the C-arm by all of its
        joints. An interval is bisected until the gaps at both ends prove that none on it is below
        ``least_mm``, or until nothing moves farther than ``OVERLAP_MM`` on it.

        Raises:
            TrajectoryError: a C-arm cannot hold some views.
        """
        states = self._machine.states(views)
        found = [self._at(state) for state in states]
        return [
            self._between(states[k - 1], states[k], found[k - 1], gap, least_mm) if k else gap
            for k, gap in enumerate(found)
        ]

    def _at(self, state: Floats) -> Gap:
        model, data, names = self._model, self._data, self._names
        for name, place in self._machine.places(state).items():
            part = self._parts[name]
            position, quat = (place @ part.place_from_body).to_metres()
            model.body_pos[part.body], model.body_quat[part.body] = position, np.roll(quat, 1)
        self._mujoco.mj_kinematics(model, data)
        smallest, nearest = np.inf, ("", "")
        for geom, other in self._pairs:
            # Nothing farther than the smallest gap so far is of interest, but for the first.
            limit = 1e3 if smallest == np.inf else max(smallest, 0) / MM_PER_M + 1e-6
            gap = MM_PER_M * self._mujoco.mj_geomDistance(
                model, data, geom, other, limit, self._line
            )
            if gap < smallest:
                bodies = model.geom_bodyid[geom], model.geom_bodyid[other]
                smallest, nearest = gap, (names[bodies[0]], names[bodies[1]])
        return Gap(smallest, nearest)

    def _between(self, start: Floats, end: Floats, first: Gap, last: Gap, least_mm: float) -> Gap:
        """Return a gap below ``least_mm`` on the way, or else that of the end."""
        travel = self._machine.travel_mm(start, end, self._radii)
        closest = (first.distance_mm + last.distance_mm - self._both_ways(travel)) / 2
        if last.distance_mm < least_mm or closest >= least_mm or travel <= OVERLAP_MM:
            return last
        middle = self._machine.halfway(start, end)
        here = self._at(middle)
        if here.distance_mm < least_mm:
            return here
        before = self._between(start, middle, first, here, least_mm)
        if before.distance_mm < least_mm:
            return before
        return self._between(middle, end, here, last, least_mm)

    def _both_ways(self, travel_mm: float) -> float:
        """Return a bound on the change of a distance: of a C-arm, both bodies may move."""
        return travel_mm if isinstance(self._machine, _Floating) else 2 * travel_mm

    def _geoms_of(self, prefixes: tuple[str, ...]) -> list[int]:
        model = self._model
        solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()
        return [g for g in solid if self._names[model.geom_bodyid[g]].startswith(prefixes)]

    def _part(self, name: str, place: Pose) -> _Part:
        model, body = self._model, self._model.body(name).id
        here = Pose.from_metres(self._data.xpos[body], np.roll(self._data.xquat[body], -1))
        solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()
        geoms = tuple(g for g in solid if model.geom_bodyid[g] == body)
        centres = self._data.geom_xpos[list(geoms)] * MM_PER_M - place.position
        reach = np.linalg.norm(centres, axis=1) + model.geom_rbound[list(geoms)] * MM_PER_M
        return _Part(body, place.inverse() @ here, float(reach.max()), geoms)


def require_free_way(
    cell: GantryCell,
    panel: Panel,
    views: Sequence[Poses],
    least_mm: float,
    world_from_specimen: Pose | None = None,
    solids: Sequence[trimesh.Trimesh] = (),
) -> Gap | None:
    """Return the smallest gap of a gantry's way; None if nothing can collide.

    Raises:
        TrajectoryError: the gantry comes too near to a body, or a C-arm cannot hold a view; names
            all views.
        MissingExtraError: MuJoCo is not installed.
        SpecimenError: the mesh file of an object is unusable.
    """
    if cell.c_arm is None and not any(one.collides for _, one in cell.keyed_objects):
        return None
    room = GantryClearance(cell, panel, views[0], world_from_specimen, solids)
    gaps = room.over(views, least_mm)
    close: dict[tuple[str, str], list[int]] = {}
    for view, gap in enumerate(gaps):
        if gap.distance_mm < least_mm:
            close.setdefault(gap.bodies, []).append(view)
    if close:
        problems = [_problem(bodies, on, gaps, least_mm) for bodies, on in close.items()]
        raise TrajectoryError(problems, sorted(set(chain(*close.values()))))
    return min(gaps, key=lambda gap: gap.distance_mm)


def _problem(
    bodies: tuple[str, str], views: Sequence[int], gaps: Sequence[Gap], least_mm: float
) -> str:
    worst = min(views, key=lambda view: gaps[view].distance_mm)
    gap = gaps[worst].distance_mm
    how = f"stands {-gap:.1f} mm deep in" if gap < 0 else f"comes within {gap:.1f} mm of"
    cure = "; move cell.objects, or set collides: false" if bodies[1].startswith(OBJECT) else ""
    return (
        f"the gantry's {bodies[0].replace('_', ' ')} {how} {bodies[1].replace('_', ' ')} at view "
        f"{worst} or on the way to it, and motion.clearance_mm = {least_mm:g} mm must stay free "
        f"({named_views(views)}){cure}"
    )


def _twist(start: Pose, end: Pose) -> Floats:
    return (start.inverse() @ end).log()
