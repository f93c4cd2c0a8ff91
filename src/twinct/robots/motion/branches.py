"""All joint configurations with which one arm reaches a pose, for many poses at once.

A UR10e has up to eight, in closed form. For any other arm, a search runs from seeded random starts
and from the results of the previous pose, so that neighbouring poses get neighbouring
configurations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import MM_PER_M, Floats, Pose
from twinct.robots.cell import CellModel, mujoco
from twinct.robots.motion.arm_search import SerialArm
from twinct.robots.motion.carriers import Carrier
from twinct.robots.sections import InverseKinematics

SIDES = ("source", "detector")

D1, A2, A3, D4, D5, D6 = 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655
"""UR10e, m: Universal Robots, "DH parameters for calculations of kinematics and dynamics"."""

ROUNDING = 1e-9
"""Amount by which a sine or cosine may exceed 1, for an arm that is just stretched out."""

SEARCH_STARTS = 48
"""Random starts of the search for a pose of an arm without closed form."""

KEPT = 16
"""Largest number of configurations of such a pose that are starts for the next pose."""

SWEEPS = 2
"""Number of times that neighbouring poses try each other's configurations."""

NEAR_STEPS = 12
"""Largest number of steps from a configuration of a neighbouring pose."""

SAME_RAD = 0.05
"""Configurations closer than this in every joint count as one."""


@dataclass(frozen=True, eq=False)
class Configurations:
    """Joint configurations of one arm that reach given poses.

    Attributes:
        joints: rad, (m, k), inside the joints' ranges, without full turns.
        pose: index of the pose of each configuration, in ascending order, (m,).
    """

    joints: Floats
    pose: NDArray[np.intp]


class Branches:
    """Solver for all configurations of one arm of a cell."""

    def __init__(self, cell: CellModel, arm: int, ik: InverseKinematics, seed: int = 0) -> None:
        """Read the arm's mounting from the compiled model.

        Args:
            cell: robot cell.
            arm: 0 source, 1 detector.
            ik: tolerances of the search; the closed form is exact.
            seed: seed of the search; the closed form needs none.
        """
        self._seed = seed
        self._arm = SerialArm(cell, arm)
        self._off = np.array(
            [ik.position_tolerance_mm / MM_PER_M, np.radians(ik.rotation_tolerance_deg)]
        )
        self._ranges = self._arm.ranges
        section = (cell.cell.source_arm, cell.cell.detector_arm)[arm]
        self.closed_form = section.model == "ur10e"
        self._carrier = None
        if section.rail is not None or section.turntable is not None:
            base_m = np.array(section.base_position_mm) / MM_PER_M
            self._carrier = Carrier(section, base_m, self._ranges[0])
        self.redundant = not self.closed_form and len(self._ranges) > 6
        if self.closed_form:
            data, site = mujoco.MjData(cell.model), cell.site_ids[arm]
            mujoco.mj_kinematics(cell.model, data)
            base = data.body(f"{SIDES[arm]}_base")
            self._world_from_base = _matrix(base.xpos, base.xmat)
            at_zero = _matrix(data.site_xpos[site], data.site_xmat[site])
            # With all joints at zero, the flange points along -y.
            flange = _matrix((A2 + A3, -D4 - D6, D1 - D5), ((1, 0, 0), (0, 0, -1), (0, 1, 0)))
            self._tool_from_flange = np.linalg.inv(at_zero) @ self._world_from_base @ flange

    @property
    def roll_sign(self) -> int:
        """Sign of the turn about the tool's z that the last joint makes; 0 if it does more."""
        return self._arm.roll_sign

    def of(self, poses: Floats, starts: int = SEARCH_STARTS, abreast: int = 1) -> Configurations:
        """Compute all configurations for some poses; a search may miss some.

        Args:
            poses: ``world_from_tool``, (poses, 4, 4), mm.
            starts: random starts for each pose; the closed form needs none.
            abreast: distance, in poses, of the pose from whose configurations a search continues.
        """
        poses = poses.copy()
        poses[:, :3, 3] /= MM_PER_M
        if not self.closed_form:
            return self._searched(poses, starts, abreast)
        if self._carrier is None:
            return self._closed(poses, self._ranges)
        places = self._carrier.places(poses)
        per_arm = []
        for place in places.T:
            there = self._closed(self._carrier.back(poses, place), self._ranges[1:])
            joints = np.column_stack([place[there.pose], there.joints])
            per_arm.append(Configurations(joints, there.pose))
        pose = np.concatenate([of.pose for of in per_arm])
        order = np.argsort(pose, kind="stable")
        return Configurations(np.vstack([of.joints for of in per_arm])[order], pose[order])

    def _closed(self, poses: Floats, ranges: Floats) -> Configurations:
        """Return the closed form's results for poses in m, NaN for no pose."""
        base_from_flange = np.linalg.inv(self._world_from_base) @ poses @ self._tool_from_flange
        joints = ur10e(base_from_flange)
        with np.errstate(invalid="ignore"):
            inside = (joints >= ranges[:, 0]) & (joints <= ranges[:, 1])
        pose, way = np.nonzero(inside.all(axis=2))
        return Configurations(joints[pose, way], pose)

    def rolled(self, poses: Floats, rolls: Floats, starts: int = SEARCH_STARTS) -> Configurations:
        """Compute the configurations for poses that are rolled about their own z.

        Where the last joint of a searched arm rolls the tool and does no more, one search serves
        all rolls of a pose.

        Args:
            poses: ``world_from_tool``, (poses, 4, 4), mm.
            rolls: rad, (r,).
            starts: random starts for each pose; the closed form needs none.

        Returns:
            configurations; ``pose`` counts the rolls of the first pose first.
        """
        if self.closed_form or not self._arm.roll_sign or len(rolls) == 1:
            turned = np.tile(np.eye(4), (len(rolls), 1, 1))
            about_z = scipy.spatial.transform.Rotation.from_euler("z", rolls[:, None])
            turned[:, :3, :3] = about_z.as_matrix()
            wanted = (poses[:, None] @ turned).reshape(-1, 4, 4)
            return self.of(wanted, starts, abreast=len(rolls))
        metres = poses.copy()
        metres[:, :3, 3] /= MM_PER_M
        low, high = self._ranges[-1]
        free = np.vstack([self._ranges[:-1], [-np.inf, np.inf]])
        result = self._searched(metres, starts, 1, free)
        joints = np.repeat(result.joints[:, None], len(rolls), axis=1)
        joints[..., -1] += self._arm.roll_sign * rolls
        joints = joints.reshape(-1, joints.shape[-1])
        joints[:, -1] = _turned_into(joints[:, -1], low, high)
        pose = (result.pose[:, None] * len(rolls) + np.arange(len(rolls))).ravel()
        inside = np.flatnonzero(np.isfinite(joints[:, -1]))
        order = inside[np.argsort(pose[inside], kind="stable")]
        return Configurations(joints[order], pose[order])

    def _searched(
        self, poses: Floats, starts: int, abreast: int, ranges: Floats | None = None
    ) -> Configurations:
        """Search from random starts for all poses at once, then from the poses before.

        Args:
            poses: ``world_from_tool``, m, (poses, 4, 4).
            starts: random starts for each pose.
            abreast: number of poses that are continued at once.
            ranges: rad and m, (n, 2); None stands for the joints' own.
        """
        ranges = self._ranges if ranges is None else ranges
        low, high = np.maximum(ranges[:, 0], -np.pi), np.minimum(ranges[:, 1], np.pi)
        draws = [
            np.random.default_rng([self._seed, index]).uniform(low, high, (starts, len(low)))
            for index in range(len(poses))
        ]
        if not draws:
            return Configurations(np.zeros((0, len(low))), np.zeros(0, np.intp))
        which = np.repeat(np.arange(len(poses)), starts)
        joints, solved = self._arm.solve(poses, which, np.vstack(draws), self._off, ranges)
        results: list[Floats] = [
            _distinct(own[good], ranges)
            for own, good in zip(
                joints.reshape(len(poses), starts, -1),
                solved.reshape(len(poses), starts),
                strict=True,
            )
        ]
        if len(low) > 6:
            self._continue(poses, results, abreast, ranges)
        else:
            for _ in range(SWEEPS):
                self._share(poses, results, abreast, ranges)
        pose = np.repeat(np.arange(len(poses)), [len(f) for f in results])
        return Configurations(np.vstack(results), pose)

    def _continue(self, poses: Floats, results: list[Floats], abreast: int, ranges: Floats) -> None:
        """Continue the configurations of each pose to the next, which get to the front there.

        A redundant arm has infinitely many, so that neighbours need to continue each other.
        """
        for begin in range(abreast, len(poses), abreast):
            here = np.arange(begin, min(begin + abreast, len(poses)))
            before = [results[k - abreast][:KEPT] for k in here]
            self._add(poses, results, here, before, ranges)

    def _share(self, poses: Floats, results: list[Floats], abreast: int, ranges: Floats) -> None:
        """Try the configurations of each pose at the poses before and after it."""
        count = len(poses)
        here = np.tile(np.arange(count), 2)
        there = np.concatenate([np.arange(count) - abreast, np.arange(count) + abreast])
        inside = (there >= 0) & (there < count)
        self._add(poses, results, here[inside], [results[k] for k in there[inside]], ranges)

    def _add(
        self,
        poses: Floats,
        results: list[Floats],
        here: NDArray[np.intp],
        starts: list[Floats],
        ranges: Floats,
    ) -> None:
        """Search for poses from near starts, and put what is found before the known ones."""
        which = np.repeat(here, [len(of) for of in starts])
        if not len(which):
            return
        joints, solved = self._arm.solve(
            poses, which, np.vstack(starts), self._off, ranges, NEAR_STEPS
        )
        for k in np.unique(which[solved]):
            own = joints[solved & (which == k)]
            results[k] = _distinct(np.vstack([own, results[k]]), ranges)


def matrices(poses: list[Pose]) -> Floats:
    """Return the homogeneous matrices of poses, (poses, 4, 4), mm."""
    return np.array([pose.matrix for pose in poses]).reshape(-1, 4, 4)


def _matrix(position: object, rotation: object) -> Floats:
    matrix = np.eye(4)
    matrix[:3, 3] = np.asarray(position)
    matrix[:3, :3] = np.asarray(rotation).reshape(3, 3)
    return matrix


def _distinct(joints: Floats, ranges: Floats) -> Floats:
    """Return the configurations that differ from all before them, (k, n)."""
    joints = _without_turns(joints, ranges)
    apart = np.abs(joints[:, None] - joints).max(axis=2) >= SAME_RAD
    distinct: list[int] = []
    for k in range(len(joints)):
        if apart[k, distinct].all():
            distinct.append(k)
    return joints[distinct]


def _turned_into(angles: Floats, low: float, high: float) -> Floats:
    """Return angles by full turns nearest to zero within a range, NaN where none is."""
    wrapped = (angles + np.pi) % (2 * np.pi) - np.pi
    for turns in (0, 1, -1):
        moved = wrapped + 2 * np.pi * turns
        inside = (moved >= low) & (moved <= high)
        wrapped = np.where(inside, moved, wrapped)
    return np.where((wrapped >= low) & (wrapped <= high), wrapped, np.nan)


def _without_turns(joints: Floats, ranges: Floats) -> Floats:
    """Remove full turns from joints where the result lies within their ranges."""
    wrapped = (joints + np.pi) % (2 * np.pi) - np.pi
    return np.where((wrapped >= ranges[:, 0]) & (wrapped <= ranges[:, 1]), wrapped, joints)


def ur10e(base_from_flange: Floats) -> Floats:
    """Compute the eight solutions of a UR10e: shoulder left/right, wrist up/down, elbow up/down.

    The axes of joints 2, 3 and 4 are parallel, which decouples the equations (Hawkins, "Analytic
    inverse kinematics for the Universal Robots UR-5/UR-10 arms", 2013; derived independently here).

    Args:
        base_from_flange: (poses, 4, 4), m.

    Returns:
        joint angles in (-pi, pi], (poses, 8, 6); NaN where no solution exists.
    """
    shoulder = np.array([1, 1, 1, 1, -1, -1, -1, -1])
    wrist = np.array([1, 1, -1, -1, 1, 1, -1, -1])
    elbow = np.array([1, -1, 1, -1, 1, -1, 1, -1])
    x6, y6, z6, tip = (base_from_flange[:, None, :3, k] for k in range(4))
    centre = tip - D6 * z6  # of wrist 3, at distance d4 from the plane of the arm
    reach = np.hypot(centre[..., 0], centre[..., 1])
    side = _arcsin(D4 / reach)
    q1 = np.arctan2(centre[..., 1], centre[..., 0])
    q1 = np.where(shoulder > 0, q1 + side, q1 + np.pi - side)
    sine, cosine = np.sin(q1), np.cos(q1)
    normal = np.stack([sine, -cosine, np.zeros_like(q1)], axis=-1)
    q5 = wrist * _arccos((z6 * normal).sum(axis=-1))
    s5, c5 = np.sin(q5), np.cos(q5)
    # With axes 4 and 6 in line, one of their angles is free: joint 6 stays at zero.
    sign = np.where(np.abs(s5) < ROUNDING, 0.0, np.sign(s5))
    q6 = np.arctan2(-sign * (y6 * normal).sum(axis=-1), sign * (x6 * normal).sum(axis=-1))
    s6, c6 = np.sin(q6)[..., None], np.cos(q6)[..., None]
    # Axes of frame 4 (before joint 5), then its origin, all in the plane of the arm.
    z4 = -(s6 * x6 + c6 * y6)
    x4 = c5[..., None] * (c6 * x6 - s6 * y6) - s5[..., None] * z6
    origin = centre - D5 * z4
    across = origin[..., 0] * cosine + origin[..., 1] * sine
    up = origin[..., 2] - D1
    q3 = elbow * _arccos((across**2 + up**2 - A2**2 - A3**2) / (2 * A2 * A3))
    q2 = np.arctan2(up, across) - np.arctan2(A3 * np.sin(q3), A2 + A3 * np.cos(q3))
    sum234 = np.arctan2(x4[..., 2], x4[..., 0] * cosine + x4[..., 1] * sine)
    joints = np.stack([q1, q2, q3, sum234 - q2 - q3, q5, q6], axis=-1)
    joints = np.pi - (np.pi - joints) % (2 * np.pi)
    return np.where(np.isfinite(joints).all(axis=-1, keepdims=True), joints, np.nan)


def _arccos(x: Floats) -> Floats:
    """Return the arccosine, NaN for values beyond 1 by more than rounding."""
    return np.arccos(np.where(np.abs(x) <= 1 + ROUNDING, np.clip(x, -1, 1), np.nan))


def _arcsin(x: Floats) -> Floats:
    return np.pi / 2 - _arccos(x)
