"""Path search: the joint configuration of each view, the order of views, and the paths in between.

All configurations of both arms for every view, rolled about the beam where that is free, are
checked for clearance. The search chooses those with the least motion over all views. Neighbours
are connected by a straight line in joint space if it is clear, and by a detour otherwise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import NoPathError, TrajectoryError
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.course import Course
from twinct.robots.motion.feasible import SHORTFALL_MM, Feasible, Flags, Indices
from twinct.robots.motion.home import home_off
from twinct.robots.motion.layers import (
    DETOUR_S,
    ROUNDS,
    LayerSearch,
    clear_pairs,
    lifted,
    promising,
    speeds_of,
)
from twinct.robots.motion.path_planner import SEARCHES, Detours
from twinct.robots.motion.refusals import (
    far_problems,
    gap_problems,
    gap_text,
    no_path_text,
    weak_text,
)
from twinct.robots.motion.strength import TORQUE_SHARE, Strength
from twinct.robots.motion.tour import moving_seconds, shortest_tour
from twinct.robots.motion.view_configurations import Candidates, ViewConfigurations
from twinct.robots.motion.view_order import order_of_views
from twinct.robots.sections import Motion

SETTLED_ROOM_MM = 0.5
"""Margin of a path above the required clearance, for arms that come to rest in every view."""

DETOURS_TRIED = 20
"""Largest number of searches for a detour from one view to the next."""

TRIED_S = 0.15
"""Cost that a failed search adds to a move, so that other moves are tried before more effort."""

JUDGED = 4
"""Orders are compared after this part of the usual checks."""

STRONG_LOOKS = 100_000
"""Largest number of configurations that searches for detours check where torques count."""

REWINDS_TRIED = 20
"""Largest number of places tried for turning joints back that reached the end of their ranges."""

REWIND_AGAIN_S = 20.0
"""Cost that a failed attempt to turn joints back adds to its place."""


@dataclass(frozen=True, eq=False)
class JointPath:
    """Path of both arms through all views.

    Attributes:
        joints: rad, (knots, n), source arm first; the straight joint path between neighbours is
            clear.
        views: index of the view exposed at each knot, -1 for none, (knots,); every view once.
        targets: commanded poses of every view, by view index, with the chosen roll.
    """

    joints: Floats
    views: NDArray[np.intp]
    targets: tuple[PosePairs, ...]

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        self.joints.setflags(write=False)
        self.views.setflags(write=False)


def required_gap_mm(motion: Motion) -> float:
    """Return the clearance of a path: the required clearance plus a margin for the servos."""
    settled = motion.trigger == "settled"
    return motion.clearance_mm + (SETTLED_ROOM_MM if settled else 2 * motion.tolerance_mm)


def find_joint_path(
    cell_model: CellModel,
    motion: Motion,
    targets: Sequence[PosePairs],
    *,
    roll_free: tuple[bool, bool] = (False, False),
    start: Floats | None = None,
    seed: int = 0,
    most_looks: float = np.inf,
) -> JointPath:
    """Find a path through all targets.

    Args:
        cell_model: robot cell.
        motion: tolerances, clearance, and the order of the views.
        targets: one for each view.
        roll_free: whether source and panel may roll about their own axes.
        start: current joint positions, rad, (n,); None starts just off the first view.
        seed: seed of searches and detours.
        most_looks: largest number of configurations that searches for detours may check.

    Raises:
        TrajectoryError: views are infeasible; every problem names views, arm, reason and missing
            distance.
        NoPathError: no path was found from one view to the next.
        MissingExtraError: mink or OMPL is not installed.
    """
    return _Finder(cell_model, motion, list(targets), roll_free, seed, most_looks).find(start)


class _Finder:
    """State of one path search."""

    def __init__(
        self,
        cell: CellModel,
        motion: Motion,
        targets: list[PosePairs],
        roll_free: tuple[bool, bool],
        seed: int,
        most_looks: float,
    ) -> None:
        self._cell, self._motion, self._targets = cell, motion, targets
        self._least_mm = required_gap_mm(motion)
        self._configurations = ViewConfigurations(
            cell, motion, targets, roll_free, self._least_mm, seed
        )
        self._kinematics = self._configurations.kinematics
        self._both, self._cross = Feasible(cell), Feasible(cell, "cross")
        self._speeds = cell.speed_limits * cell.speed_scales
        self._arms = speeds_of(cell)
        self._turns = np.concatenate([arm.turns for arm in self._arms])
        self._detours = Detours(cell, self._both, self._turns, seed, most_looks)
        self._strength, self._strong = Strength(cell), False
        self._known: dict[bytes, Floats | None] = {}
        self._clear: dict[tuple[frozenset[bytes], float, bool], bool] = {}

    def find(self, start: Floats | None) -> JointPath:
        of_arms = [self._configurations.of_arm(arm) for arm in range(2)]
        problems = [problem for _, refusals, _ in of_arms for problem in refusals]
        if problems:
            raise TrajectoryError(problems, of_arms[0][2] | of_arms[1][2])
        candidates = [of_arm for of_arm, _, _ in of_arms]
        path = self._path(candidates, start)
        loads = self._strength.along(path.joints) + self._strength.friction
        if start is not None or loads.max() < TORQUE_SHARE:
            return path
        # Another path, of configurations that the joints can hold; a given start stays as it is.
        try:
            return self._light(candidates)
        except TrajectoryError as error:
            holding = self._strength.along(path.joints).max(axis=0)
            if holding.max() < TORQUE_SHARE:
                return path
            if not isinstance(error, NoPathError):
                raise
            name = self._cell.joint_names[int(holding.argmax())]
            heavy = f"on the way that was found instead, {weak_text(name, float(holding.max()))}"
            raise NoPathError([*error.problems, heavy], error.views) from None

    def _light(self, candidates: list[list[Candidates]]) -> JointPath:
        """Return a path along which every joint can hold."""
        self._strong, self._detours.holds = True, self._strength
        self._detours.most = min(self._detours.most, self._detours.looked + STRONG_LOOKS)
        held = [
            self._configurations.held(arm, of, self._strength) for arm, of in enumerate(candidates)
        ]
        return self._path(held, None)

    def _path(self, candidates: list[list[Candidates]], start: Floats | None) -> JointPath:
        """Return a path through one candidate of each arm in every view."""
        order = list(range(len(self._targets)))
        if start is not None:
            start = self._checked(start)
        if self._motion.order == "shortest":
            joints = [[c.joints for c in arm] for arm in candidates]
            order = order_of_views(
                shortest_tour(moving_seconds(joints, self._arms)),
                lambda order: self._taken(self._course(candidates, order, start)),
                self._slower,
                lambda a, b: self._straight(a, a + self._shorter(b - a), self._least_mm),
            )
        course = self._course(candidates, order, start)
        views, layers = course.views, course.layers
        ways, chosen = self._through(course)
        targets = list(self._targets)
        for layer, view in enumerate(views):
            if view >= 0:
                source, detector = (
                    _rolled(pose, float(arm[layer].roll[pair]))
                    for pose, arm, pair in zip(
                        targets[view][0],
                        layers,
                        chosen[layer],
                        strict=True,
                    )
                )
                if any(arm[layer].roll[p] for arm, p in zip(layers, chosen[layer], strict=True)):
                    targets[view] = PosePairs.at(source, detector)
        knots, exposed = [ways[0][:1]], [views[:1]]
        for way, view in zip(ways, views[1:], strict=False):
            knots.append(way[1:])
            exposed.append(np.append(np.full(len(way) - 2, -1), view))
        joints, exposed = np.vstack(knots), np.concatenate(exposed)
        joints = self._polished(joints, exposed, targets)
        if start is None:
            home = self._home(targets[views[0]], joints[0])
            joints, exposed = np.vstack([home, joints]), np.append(-1, exposed)
        return JointPath(joints, exposed, tuple(targets))

    def _pairs(self, views: Indices, layers: list[list[Candidates]]) -> list[Indices]:
        """Return the pairs of candidates of both arms that are clear of each other, per layer."""
        ranked = [
            promising([c.joints for c in arm], speeds, [c.load_s for c in arm])
            for arm, speeds in zip(layers, self._arms, strict=True)
        ]
        pairs, gaps = [], {}
        for layer, view in enumerate(views.tolist()):
            if view < 0:
                pairs.append(np.zeros((1, 2), np.intp))
                continue
            of_source, of_detector = (arm[layer].joints for arm in layers)
            chosen = clear_pairs(
                (ranked[0][layer], ranked[1][layer]),
                lambda i, j, a=of_source, b=of_detector: self._cross.clear(
                    np.hstack([a[i], b[j]]), self._least_mm
                ),
            )
            pairs.append(chosen)
            if not len(chosen):
                best = np.hstack(
                    [of_source[ranked[0][layer][:1]], of_detector[ranked[1][layer][:1]]]
                )
                gaps[view] = self._configurations.widest(best, SIDES)
        if gaps:
            raise TrajectoryError(gap_problems(gaps, self._least_mm), gaps)
        return pairs

    def _checked(self, start: Floats) -> Floats:
        """Check the start; the first path requires no more clearance than the start has."""
        start = np.array(start, dtype=np.float64)
        ranges = self._cell.joint_ranges
        if start.shape != self._speeds.shape or not np.isfinite(start).all():
            raise TrajectoryError(
                f"start: expected {len(ranges)} finite joint positions, got {start}"
            )
        # A joint at the end of its range may exceed it by rounding.
        start = np.where(np.abs(start - start.clip(*ranges.T)) < 1e-3, start.clip(*ranges.T), start)
        if (start != start.clip(*ranges.T)).any():
            raise TrajectoryError(f"start: {start} is outside the joints' ranges")
        gap = self._configurations.widest(start[None], SIDES)
        self._first_mm = min(self._least_mm, gap.distance_mm - 2 * SHORTFALL_MM)
        if self._first_mm <= 0:
            raise TrajectoryError(f"start: {gap_text(gap, self._least_mm)}")
        return start

    def _course(
        self, candidates: list[list[Candidates]], order: list[int], start: Floats | None
    ) -> Course:
        """Return the layers of an order, the start among them, and the moves between them."""
        layers = [[arm[view] for view in order] for arm in candidates]
        views = np.array(order)
        least = np.full(len(order) - 1 + (start is not None), self._least_mm)
        if start is not None:
            # The start is a layer, too, because it decides which candidates are promising.
            for arm, part in zip(layers, self._cell.arm_joints, strict=True):
                arm.insert(0, Candidates(start[None, part], np.zeros(1), np.zeros(1)))
            views = np.concatenate([[-1], views])
            least[0] = self._first_mm
        pairs = self._pairs(views, layers)
        nodes = [
            np.hstack([arm[k].joints[p] for arm, p in zip(layers, pair.T, strict=True)])
            for k, pair in enumerate(pairs)
        ]
        costs = [np.sum(self._seconds(a, b), axis=0) for a, b in pairwise(nodes)]
        loads = [
            layer[0].load_s[pair[:, 0]] + layer[1].load_s[pair[:, 1]]
            for *layer, pair in zip(*layers, pairs, strict=True)
        ]
        return Course(views, layers, pairs, nodes, LayerSearch(costs, loads), least, self._shorter)

    def _seconds(self, a: Floats, b: Floats) -> list[Floats]:
        """Return each arm's time from each of (m, n) configurations to each of (p, n), (m, p)."""
        of_arms = zip(self._arms, self._cell.arm_joints, strict=True)
        return [speeds.seconds(a[:, part], b[:, part]) for speeds, part in of_arms]

    def _slower(self, a: Floats, b: Floats) -> Floats:
        """Return the time of the slower arm, which the plan takes, as ``_seconds``."""
        return np.maximum(*self._seconds(a, b))

    def _taken(self, course: Course) -> tuple[float, Floats]:
        """Return the time of a course, detours included, and its joints by view, (views, n)."""
        path = course.mostly_straight(self._straight, ROUNDS // JUDGED)
        knots = course.joints(path)
        legs = [np.array([a, a + self._shorter(b - a)]) for a, b in pairwise(knots)]
        detours = sum(
            not course.straight[k, int(i), int(j)] for k, (i, j) in enumerate(pairwise(path))
        )
        # Joints that reach the end of their ranges have to be turned back.
        rewinding_s, from_start = np.full(len(legs), DETOUR_S), bool(course.views[0] < 0)
        placed = lifted(knots, legs, self._cell.joint_ranges, self._speeds, rewinding_s, from_start)
        moving = float((np.abs(np.diff(placed, axis=0)) / self._speeds).max(axis=1).sum())
        of_views = course.views >= 0
        by_view = knots[of_views][np.argsort(course.views[of_views])]
        return moving + DETOUR_S * detours, by_view

    def _through(self, course: Course) -> tuple[list[Floats], list[Indices]]:
        """Return the paths between layers, knots (m, n) each, and each layer's candidate pair."""
        views, pairs, choice = course.views, course.pairs, course.choice
        straight, least, from_start = course.straight, course.least_mm, course.views[0] < 0
        tried: Counter[tuple[int, int, int]] = Counter()
        while True:
            path = course.mostly_straight(self._straight)
            knots = course.joints(path)
            edges = [(k, int(path[k]), int(path[k + 1])) for k in range(len(least))]
            legs: list[Floats] = []
            for edge, a, b in zip(edges, knots[:-1], knots[1:], strict=True):
                if straight[edge]:
                    legs.append(np.array([a, a + self._shorter(b - a)]))
                elif (leg := self._round(a, b, least[edge[0]], tried[edge])) is not None:
                    legs.append(leg)
                else:
                    break
            blocked = len(legs)
            if blocked == len(least):
                ways, blocked = self._in_range(knots, legs, least, from_start)
                if ways:
                    return ways, [pair[node] for pair, node in zip(pairs, path, strict=True)]
            # Try other pairs of configurations before spending more effort on this one.
            edge = edges[blocked]
            tried[edge] += 1
            choice.raise_cost(blocked, edge[1:], TRIED_S if tried[edge] < len(SEARCHES) else np.inf)
            count = sum(n for (layer, *_), n in tried.items() if layer == blocked)
            total = choice.best()[1]
            if count == DETOURS_TRIED or not np.isfinite(total) or self._detours.over:
                before, after = (int(view) for view in views[blocked : blocked + 2])
                text = no_path_text(before, after, count, self._detours.looked)
                raise NoPathError(text, [after])

    def _straight(self, starts: Floats, ends: Floats, least_mm: float) -> Flags:
        """Return flags of the straight joint paths that are clear, (m,), and held if need be."""
        keys = [
            (frozenset((a.tobytes(), b.tobytes())), least_mm, self._strong)
            for a, b in zip(starts, ends, strict=True)
        ]
        new = [m for m, key in enumerate(keys) if key not in self._clear]
        clear = self._both.straight(starts[new], ends[new], least_mm)
        if self._strong:
            clear[clear] = self._strength.straight(starts[new][clear], ends[new][clear])
        self._clear |= {keys[m]: bool(good) for m, good in zip(new, clear, strict=True)}
        return np.array([self._clear[key] for key in keys], np.bool_)

    def _shorter(self, moves: Floats) -> Floats:
        """Take the shorter way round for joints that can make a full turn."""
        return np.where(self._turns, (moves + np.pi) % (2 * np.pi) - np.pi, moves)

    def _round(self, start: Floats, end: Floats, least_mm: float, effort: int) -> Floats | None:
        """Return the knots of a detour, which may end full turns away."""
        key = np.concatenate([start, end, [least_mm, effort, self._strong]]).tobytes()
        if key not in self._known:
            self._known[key] = self._detours.between(start, end, least_mm, effort)
        return self._known[key]

    def _in_range(
        self, knots: Floats, legs: list[Floats], least_mm: Floats, from_start: bool
    ) -> tuple[list[Floats], int]:
        """Add full turns to the legs so that all joints stay within their ranges.

        If successive legs turn a joint in one direction, it must be turned back somewhere.

        Returns:
            the legs, empty after failure, and the index of the leg that failed last.
        """
        if not legs:
            return [
                lifted(knots, legs, self._cell.joint_ranges, self._speeds, knots[:, 0], from_start)
            ], 0
        rewinding_s, blocked = np.full(len(legs), DETOUR_S), 0
        for _ in range(REWINDS_TRIED):
            placed = lifted(
                knots, legs, self._cell.joint_ranges, self._speeds, rewinding_s, from_start
            )
            ways: list[Floats] = []
            for k, (leg, a, b) in enumerate(zip(legs, placed[:-1], placed[1:], strict=True)):
                if (np.abs(b - a - (leg[-1] - leg[0])) < np.pi).all():
                    way = leg + (a - leg[0])
                    way[[0, -1]] = a, b
                elif self._straight(a[None], b[None], float(least_mm[k]))[0]:
                    way = np.array([a, b])
                else:
                    way = self._detours.between(a, b, least_mm[k], 0, turning=False)
                if way is None:
                    rewinding_s[k] += REWIND_AGAIN_S
                    blocked = k
                    break
                ways.append(way)
            else:
                # A single view has no legs.
                return ways or [placed], 0
        return [], blocked

    def _polished(
        self, joints: Floats, views: NDArray[np.intp], targets: list[PosePairs]
    ) -> Floats:
        """Return the knots, with mink's solution at each view."""
        joints = joints.copy()
        for knot in np.flatnonzero(views >= 0):
            result = self._kinematics.solve(joints[knot], targets[views[knot]])
            far = {
                side: (float(result.position_mm[arm]), float(result.rotation_deg[arm]))
                for arm, side in enumerate(SIDES)
                if not result.solved[arm]
            }
            if far:
                raise TrajectoryError(
                    [p for side, off in far.items() for p in far_problems(side, {views[knot]: off})]
                )
            joints[knot] = result.joints
        return joints

    def _home(self, first: PosePairs, joints: Floats) -> Floats:
        def clear(home: Floats) -> bool:
            return bool(self._straight(home[None], joints[None], self._least_mm)[0])

        return home_off(first, joints, self._kinematics, clear, self._least_mm)


def _rolled(pose: Pose, angle: float) -> Pose:
    """Roll a pose about its own z axis by an angle, rad."""
    if not angle:
        return pose
    about_z = scipy.spatial.transform.Rotation.from_euler("z", angle)
    turned = scipy.spatial.transform.Rotation.from_quat(pose.quat) * about_z
    return Pose(pose.position, turned.as_quat())
