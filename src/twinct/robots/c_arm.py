"""Kinematics of a C-arm: which angles and lift give a view, and where its parts are then.

The C's frame has its origin at the isocentre, z along the beam and x towards the C's open side.
With Q, its axes at both angles zero, the axes are Q Rx(rotation) Ry(orbit), so that the beam is
Q (sin o, -cos o sin r, cos o cos r).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy

from twinct.core.errors import TrajectoryError
from twinct.core.foreign_text import counted
from twinct.geometry import Floats, Pose
from twinct.robots.sections import CArm

SAME_MM, SAME_DEG = 0.1, 0.05
"""Deviations of a view that the C counts as held: the defaults of ``motion.ik``."""

POLE_DEG = 1e-3
"""Angle between beam and axis below which the rotation is arbitrary."""

TIE = 1e-9
"""Weight of the first view's turns against those from view to view."""

NAMED_VIEWS = 8
"""Views that a message names."""

Views = Sequence[tuple[Pose, Pose]]
"""World poses of source and panel in each view."""

CARRIERS = ("c_arm", "c_arm_sleeve", "c_arm_lift")
"""Bodies that move: the C, the sleeve in which it slides, and the lifting part of the column."""


@dataclass(frozen=True)
class _Found:
    """One view: what the C would need for it.

    Attributes:
        ways: rotation and orbit, rad, (ways, 2).
        lift_mm: the lift.
        turns: turns of source and panel about the beam, for each way, rad, (ways, 2).
        apart_mm: SDD of the view.
        off_mm: distance of the isocentre from the line of the lift.
        lean_deg: angle between the panel's normal, or the source's axis, and the beam.
    """

    ways: Floats
    lift_mm: float
    turns: Floats
    apart_mm: float
    off_mm: float
    lean_deg: float


class CArmKinematics:
    """Views as joint positions of a C-arm, and back.

    Joints are rotation and orbit, rad, lift, mm, and the turns of source and panel in their mounts
    about the beam, rad.

    Attributes:
        section: the machine.
    """

    def __init__(self, section: CArm) -> None:
        """Store the machine."""
        self.section = section
        axis, beam = section.directions
        self._at_zero = np.stack([axis, np.cross(beam, axis), beam], axis=1)
        self._source = Pose(np.array([0, 0, -section.sod_mm]), Pose.identity().quat)
        self._panel = Pose.from_euler((0, 0, section.sdd_mm - section.sod_mm), (180, 0, 0))

    def joints(self, views: Views) -> Floats:
        """Return the joints of all views, (views, 5), with little motion from view to view.

        Raises:
            TrajectoryError: the C cannot hold some views; names them.
        """
        found = [self._found(*view) for view in views]
        ways = [self._allowed(one) for one in found]
        problems, refused = self._problems(found, ways)
        if problems:
            raise TrajectoryError(problems, refused)
        return self._smooth(ways)

    def nearest(self, source: Pose, panel: Pose) -> Floats:
        """Return the joints, (5,), that come nearest to a view, for pictures."""
        found = self._found(source, panel)
        allowed = self._allowed(found)
        ways = allowed if len(allowed) else self._as_joints(found)
        return ways[np.abs(ways[:, :2]).sum(axis=1).argmin()]

    def tools(self, joints: Floats) -> tuple[Pose, Pose]:
        """Return the poses of source and panel."""
        c, turned = self._c(joints), np.degrees(joints[3:])
        source, panel = (Pose.from_euler((0, 0, 0), (0, 0, turn)) for turn in turned)
        return c @ self._source @ source, c @ self._panel @ panel

    def carriers(self, joints: Floats) -> dict[str, Pose]:
        """Return the poses of the C, its sleeve and the lifting part, by ``CARRIERS``."""
        rotation, _, lift, *_ = joints
        upright = np.array([0.0, 0.0, lift, 0.0, 0.0])
        poses = self._c(joints), self._c(np.array([rotation, 0.0, lift, 0, 0])), self._c(upright)
        return dict(zip(CARRIERS, poses, strict=True))

    def _c(self, joints: Floats) -> Pose:
        """Return the pose of the C's frame."""
        rotation, orbit, lift, *_ = joints.tolist()
        turn = scipy.spatial.transform.Rotation.from_euler("XY", [rotation, orbit]).as_matrix()
        return Pose.from_matrix(
            np.array(self.section.isocentre_mm) + (0, 0, lift), self._at_zero @ turn
        )

    def _found(self, source: Pose, panel: Pose) -> _Found:
        section, way = self.section, panel.position - source.position
        apart = float(np.linalg.norm(way))
        beam = way / apart
        shift = source.position + section.sod_mm * beam - np.array(section.isocentre_mm)
        lean = max(_angle(source.rotation[:, 2], beam), _angle(-panel.rotation[:, 2], beam))
        x, y, z = self._at_zero.T @ beam
        orbit = float(np.arcsin(np.clip(x, -1, 1)))
        pole = np.pi / 2 - abs(orbit) < np.radians(POLE_DEG)
        rotation = 0.0 if pole else float(np.arctan2(-y, z))
        ways = np.array([(rotation, orbit), (rotation + np.pi, np.pi - orbit)])
        ways[:, 1] = (ways[:, 1] + np.pi) % (2 * np.pi) - np.pi
        turns = np.array([self._turns(way, source, panel) for way in ways])
        lift, off = float(shift[2]), float(np.hypot(*shift[:2]))
        return _Found(ways, lift, turns, apart, off, lean)

    def _turns(self, way: Floats, source: Pose, panel: Pose) -> Floats:
        """Return the turns of source and panel about the beam, rad."""
        c = self._c(np.array([*way, 0, 0, 0]))
        turns = []
        for mounted, pose in ((self._source, source), (self._panel, panel)):
            turn = (c @ mounted).rotation.T @ pose.rotation
            turns.append(np.arctan2(turn[1, 0], turn[0, 0]))
        return np.array(turns)

    def _as_joints(self, found: _Found) -> Floats:
        lift = np.full((len(found.ways), 1), found.lift_mm)
        return np.hstack([found.ways, lift, found.turns])

    def _allowed(self, found: _Found) -> Floats:
        """Return the joints within the limits of both angles, (ways, 5)."""
        some: list[Floats] = []
        low, high = np.radians(self.section.rotation_deg)
        least, most = np.radians(self.section.orbit_deg)
        slack = np.radians(SAME_DEG)
        for joints, turn in product(self._as_joints(found), range(-3, 4)):
            rotation = joints[0] + 2 * np.pi * turn
            inside = low - slack <= rotation <= high + slack
            if inside and least - slack <= joints[1] <= most + slack:
                some.append(np.array([rotation, *joints[1:]]))
        return np.array(some).reshape(-1, 5)

    def _problems(
        self, found: Sequence[_Found], ways: Sequence[Floats]
    ) -> tuple[list[str], list[int]]:
        section, (low, high) = self.section, self.section.lift_mm
        apart = np.array([abs(one.apart_mm - section.sdd_mm) for one in found])
        off = np.array([one.off_mm for one in found])
        lean = np.array([one.lean_deg for one in found])
        lift = np.array([one.lift_mm for one in found])
        beyond = np.maximum(lift - high, low - lift)
        none = np.array([float(not len(allowed)) for allowed in ways])
        worst = int(apart.argmax())
        angles = "; ".join(
            f"rotation {r:.1f}, orbit {o:.1f}"
            for r, o in np.degrees(found[int(none.argmax())].ways)
        )
        limits = [
            f"{key.partition('_')[0]} {getattr(section, key)[0]:g} to {getattr(section, key)[1]:g}"
            for key in ("rotation_deg", "orbit_deg")
        ]
        tests = (
            (
                apart > SAME_MM,
                f"a C-arm has one SDD, cell.c_arm.sdd_mm = {section.sdd_mm:g} mm, but view {worst} "
                f"asks for {found[worst].apart_mm:.1f} mm",
            ),
            (
                off > SAME_MM,
                f"the isocentre of view {int(off.argmax())} lies {off.max():.1f} mm beside that of "
                "the C-arm (cell.c_arm.isocentre_mm, sod_mm), which only lifts",
            ),
            (
                lean > SAME_DEG,
                f"source or panel of view {int(lean.argmax())} lean by {lean.max():.2f} deg from "
                "the line that joins them, and a C-arm holds them face to face",
            ),
            (
                beyond > SAME_MM,
                f"view {int(beyond.argmax())} needs a lift of {lift[int(beyond.argmax())]:.1f} mm, "
                f"and cell.c_arm.lift_mm is {low:g} to {high:g}",
            ),
            (
                none > 0,
                f"view {int(none.argmax())} needs angles ({angles} deg) beyond cell.c_arm's "
                f"({', '.join(limits)} deg)",
            ),
        )
        problems, refused = list[str](), set[int]()
        for bad, what in tests:
            if views := np.flatnonzero(bad).tolist():
                refused |= set(views)
                problems.append(f"{what} ({named_views(views)})")
        return problems, sorted(refused)

    def _smooth(self, ways: Sequence[Floats]) -> Floats:
        """Return one way for each view, with the least sum of squared turns in all.

        Of equal ones, the first view decides, by its turn from zero.
        """
        costs, before = [TIE * (ways[0][:, :2] ** 2).sum(axis=1)], list[Floats]()
        for last, here in zip(ways[:-1], ways[1:], strict=True):
            steps = ((here[:, None, :2] - last[None, :, :2]) ** 2).sum(axis=2) + costs[-1]
            before.append(steps.argmin(axis=1))
            costs.append(steps.min(axis=1))
        choice = int(costs[-1].argmin())
        chosen = [choice]
        for back in reversed(before):
            chosen.append(choice := int(back[choice]))
        joints = np.array([ways[view][k] for view, k in enumerate(reversed(chosen))])
        joints[:, 3:] = np.unwrap(joints[:, 3:], axis=0)
        return joints


def named_views(views: Sequence[int]) -> str:
    """Return some views in words."""
    few = ", ".join(map(str, views[:NAMED_VIEWS])) + (", ..." * (len(views) > NAMED_VIEWS))
    return f"{counted(len(views), 'view')}: {few}"


def _angle(one: Floats, other: Floats) -> float:
    """Return the angle between two unit vectors, deg."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))
