"""Finding a way: which configurations for which views, in which order, and how to the next.

All configurations of both arms for every view, turned about the beam where that is free, are judged
for clearance; those are chosen that move least over all views; between neighbours the way is
straight in joint space where that is clear, and a detour where not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.cell import CellModel, Clearance, Gap, mujoco_module
from twinct.errors import NoWayError, TrajectoryError
from twinct.geometry import Floats, Pose
from twinct.motion.branches import SIDES, Branches, matrices
from twinct.motion.detour import SEARCHES, Detours
from twinct.motion.feasible import SHORTFALL_MM, Feasible, Indices
from twinct.motion.home import home_off
from twinct.motion.kinematics import Kinematics
from twinct.motion.layers import (
    DETOUR_S,
    ROUNDS,
    Choice,
    clear_pairs,
    lifted,
    promising,
    speeds_of,
)
from twinct.motion.refusals import far_problems, gap_problems, gap_text
from twinct.motion.tour import moving_seconds, shortest_tour
from twinct.scenario import Motion
from twinct.views import Target

if TYPE_CHECKING:
    import mujoco
else:
    mujoco = mujoco_module()

ROLL_STEP_DEG = 5.0
"""Turns about the beam that are tried where they are free."""

SETTLED_ROOM_MM = 0.5
"""What a way keeps beside the clearance asked for, for arms that come to rest in every view."""

MANY_STARTS = 500
"""Starts of the search for a pose of which no configuration found at first is clear."""

NEAREST_STARTS = 8
"""Starts from which it is found how far off an arm remains."""

WIDEST_OF = 64
"""Configurations of which the largest clearance is told, at most."""

DETOURS_TRIED = 20
"""Searches for a way round from one view to the next, at most."""

TRIED_S = 0.15
"""What a search in vain adds to what a move costs: others have their turn before more effort."""

REWINDS_TRIED = 20
"""Places tried for turning joints back that came to the end of their ranges, at most."""

REWIND_AGAIN_S = 20.0
"""What a place where that was sought in vain costs more the next time."""


@dataclass(frozen=True, eq=False)
class Way:
    """A way of both arms through all views.

    Attributes:
        joints: rad, (knots, n), source arm first; the straight joint path between neighbours is
            clear.
        views: index of the view exposed at each knot, -1 where none is, (knots,); every view once.
        targets: commanded poses of every view, by view index, with the roll that was chosen.
    """

    joints: Floats
    views: NDArray[np.intp]
    targets: tuple[Target, ...]

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        self.joints.setflags(write=False)
        self.views.setflags(write=False)


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Of one view and one arm: configurations (m, k), and the roll that each holds, rad, (m,)."""

    joints: Floats
    roll: Floats


def kept_mm(motion: Motion) -> float:
    """The clearance that a way keeps: what is asked for and room for how the arms follow."""
    settled = motion.trigger == "settled"
    return motion.clearance_mm + (SETTLED_ROOM_MM if settled else 2 * motion.tolerance_mm)


def find_way(
    cell_model: CellModel,
    motion: Motion,
    targets: Sequence[Target],
    *,
    roll_free: tuple[bool, bool] = (False, False),
    start: Floats | None = None,
    seed: int = 0,
    most_looks: float = np.inf,
) -> Way:
    """Find a way through all targets.

    Args:
        cell_model: the room.
        motion: tolerances, clearance, and the order of the views.
        targets: one for each view.
        roll_free: whether source and panel may be turned about their own axis.
        start: where the arms are, rad, (n,); without it the way starts just off its first view.
        seed: of searches and detours.
        most_looks: configurations that searches for detours may look at.

    Raises:
        TrajectoryError: views that cannot be had; every problem names views, arm, reason and how
            far off.
        NoWayError: no way was found from one to the next.
        MissingExtraError: mink or OMPL is not installed.
    """
    return _Finder(cell_model, motion, list(targets), roll_free, seed, most_looks).find(start)


class _Finder:
    """One search; what it holds lives as long."""

    def __init__(
        self,
        cell: CellModel,
        motion: Motion,
        targets: list[Target],
        roll_free: tuple[bool, bool],
        seed: int,
        most_looks: float,
    ) -> None:
        self._cell, self._motion, self._targets, self._seed = cell, motion, targets, seed
        self._least_mm = kept_mm(motion)
        self._kinematics = Kinematics(cell, motion.ik)
        self._both, self._cross = Feasible(cell), Feasible(cell, "cross")
        self._speeds = cell.speed_limits * cell.speed_scales
        self._arms = speeds_of(cell)
        self._turns = np.concatenate([arm.turns for arm in self._arms])
        self._detours = Detours(cell, self._both, self._turns, seed, most_looks)
        full = np.arange(0.0, 360.0, ROLL_STEP_DEG)
        self._rolls = [np.radians(full if free else full[:1]) for free in roll_free]
        self._known: dict[bytes, Floats | None] = {}

    def find(self, start: Floats | None) -> Way:
        found = [self._of_arm(arm) for arm in range(2)]
        problems = [problem for _, told in found for problem in told]
        if problems:
            raise TrajectoryError(problems)
        candidates = [of_arm for of_arm, _ in found]
        order = list(range(len(self._targets)))
        if self._motion.order == "shortest":
            joints = [[c.joints for c in arm] for arm in candidates]
            order = shortest_tour(moving_seconds(joints, self._arms))
        layers = [[arm[view] for view in order] for arm in candidates]
        views = np.array(order)
        if start is not None:
            # A layer too: what is promising depends on where the arms are.
            start = self._checked(start)
            for arm, part in zip(layers, self._cell.arm_joints, strict=True):
                arm.insert(0, _Candidates(start[None, part], np.zeros(1)))
            views = np.concatenate([[-1], views])
        pairs = self._pairs(views, layers)
        ways, chosen = self._through(views, layers, pairs, start is not None)
        targets = list(self._targets)
        for layer, view in enumerate(views):
            if view >= 0:
                source, detector = (
                    _rolled(pose, float(arm[layer].roll[pair]))
                    for pose, arm, pair in zip(
                        (targets[view].source, targets[view].detector),
                        layers,
                        chosen[layer],
                        strict=True,
                    )
                )
                if any(arm[layer].roll[p] for arm, p in zip(layers, chosen[layer], strict=True)):
                    targets[view] = Target.from_poses(source, detector)
        knots, exposed = [ways[0][:1]], [views[:1]]
        for way, view in zip(ways, views[1:], strict=False):
            knots.append(way[1:])
            exposed.append(np.append(np.full(len(way) - 2, -1), view))
        joints, exposed = np.vstack(knots), np.concatenate(exposed)
        joints = self._polished(joints, exposed, targets)
        if start is None:
            home = self._home(targets[views[0]], joints[0])
            joints, exposed = np.vstack([home, joints]), np.append(-1, exposed)
        return Way(joints, exposed, tuple(targets))

    def _of_arm(self, arm: int) -> tuple[list[_Candidates], list[str]]:
        """Clear candidates of every view, and what is to be said of views without any."""
        poses = [(t.source, t.detector)[arm] for t in self._targets]
        rolls, side = self._rolls[arm], SIDES[arm]
        turned = np.zeros((len(rolls), 4, 4))
        about_z = scipy.spatial.transform.Rotation.from_euler("z", rolls[:, None])
        turned[:, :3, :3] = about_z.as_matrix()
        turned[:, 3, 3] = 1
        asked = matrices(poses)[:, None] @ turned
        branches = Branches(self._cell, arm, self._motion.ik, self._seed)
        room = Feasible(self._cell, side)
        found = branches.of(asked.reshape(-1, 4, 4))
        clear = room.clear(self._placed(found.joints, arm), self._least_mm)
        candidates, far, gaps = [], {}, {}
        for view in range(len(poses)):
            mine = slice(*np.searchsorted(found.pose, np.array([view, view + 1]) * len(rolls)))
            joints, roll = found.joints[mine], rolls[found.pose[mine] - view * len(rolls)]
            good = clear[mine]
            if not good.any() and not branches.closed_form:
                more = branches.of(asked[view], MANY_STARTS)
                joints, roll = more.joints, rolls[more.pose]
                good = room.clear(self._placed(joints, arm), self._least_mm)
            if not len(joints):
                joints, roll, off = self._nearest(view, arm)
                if off is not None:
                    far[view] = off
                good = room.clear(self._placed(joints, arm), self._least_mm)
            if not good.any() and view not in far:
                gaps[view] = self._widest(self._placed(joints, arm), (side,))
            candidates.append(_Candidates(joints[good], roll[good]))
        return candidates, far_problems(side, far) + gap_problems(gaps, self._least_mm)

    def _nearest(self, view: int, arm: int) -> tuple[Floats, Floats, tuple[float, float] | None]:
        """An arm's best try: it and its roll where it is within tolerance, else how far off."""
        part, ranges = self._cell.arm_joints[arm], self._cell.joint_ranges
        rng = np.random.default_rng([self._seed, view])
        low, high = np.maximum(ranges[:, 0], -np.pi), np.minimum(ranges[:, 1], np.pi)
        off = (np.inf, np.inf)
        for _ in range(NEAREST_STARTS):
            result = self._kinematics.solve(rng.uniform(low, high), self._targets[view])
            if result.solved[arm]:
                return result.joints[None, part], np.zeros(1), None
            off = min(off, (float(result.position_mm[arm]), float(result.rotation_deg[arm])))
        return np.zeros((0, part.stop - part.start)), np.zeros(0), off

    def _placed(self, joints: Floats, arm: int) -> Floats:
        """Configurations of one arm among those of the cell, (m, n)."""
        placed = np.zeros((len(joints), len(self._speeds)))
        placed[:, self._cell.arm_joints[arm]] = joints
        return placed

    def _widest(self, joints: Floats, sides: tuple[str, ...]) -> Gap:
        """The largest of the clearances of some configurations."""
        clearance, data = Clearance(self._cell, sides), mujoco.MjData(self._cell.model)
        best = Gap(-np.inf, ("", ""))
        for q in joints[:WIDEST_OF]:
            data.qpos[:] = q
            mujoco.mj_kinematics(self._cell.model, data)
            best = max(best, clearance.at(data), key=lambda gap: gap.distance_mm)
        return best

    def _pairs(self, views: Indices, layers: list[list[_Candidates]]) -> list[Indices]:
        """Pairs of candidates of both arms that are clear of each other, for every layer."""
        ranked = [
            promising([c.joints for c in arm], speeds)
            for arm, speeds in zip(layers, self._arms, strict=True)
        ]
        pairs, gaps = [], {}
        for layer, view in enumerate(views.tolist()):
            if view < 0:
                pairs.append(np.zeros((1, 2), np.intp))
                continue
            of_source, of_detector = (arm[layer].joints for arm in layers)
            found = clear_pairs(
                (ranked[0][layer], ranked[1][layer]),
                lambda i, j, a=of_source, b=of_detector: self._cross.clear(
                    np.hstack([a[i], b[j]]), self._least_mm
                ),
            )
            pairs.append(found)
            if not len(found):
                best = np.hstack(
                    [of_source[ranked[0][layer][:1]], of_detector[ranked[1][layer][:1]]]
                )
                gaps[view] = self._widest(best, SIDES)
        if gaps:
            raise TrajectoryError(gap_problems(gaps, self._least_mm))
        return pairs

    def _checked(self, start: Floats) -> Floats:
        """Where the arms are; what they have of clearance there is asked for on the first way."""
        start = np.array(start, dtype=np.float64)
        ranges = self._cell.joint_ranges
        if start.shape != self._speeds.shape or not np.isfinite(start).all():
            raise TrajectoryError(f"start: {start} are no positions of {len(ranges)} joints")
        # A joint that stands at the end of its range may be beyond it by rounding.
        start = np.where(np.abs(start - start.clip(*ranges.T)) < 1e-3, start.clip(*ranges.T), start)
        if (start != start.clip(*ranges.T)).any():
            raise TrajectoryError(f"start: {start} is outside the joints' ranges")
        gap = self._widest(start[None], SIDES)
        self._first_mm = min(self._least_mm, gap.distance_mm - 2 * SHORTFALL_MM)
        if self._first_mm <= 0:
            raise TrajectoryError(f"start: {gap_text(gap, self._least_mm)}")
        return start

    def _through(
        self,
        views: NDArray[np.intp],
        layers: list[list[_Candidates]],
        pairs: list[Indices],
        from_start: bool,
    ) -> tuple[list[Floats], list[Indices]]:
        """Ways from layer to layer, knots (m, n) each, and the pair of candidates of each layer."""
        nodes = [
            np.hstack([arm[k].joints[p] for arm, p in zip(layers, pair.T, strict=True)])
            for k, pair in enumerate(pairs)
        ]
        of_arms = list(zip(self._arms, self._cell.arm_joints, strict=True))
        costs = [
            np.sum([speeds.seconds(a[:, part], b[:, part]) for speeds, part in of_arms], axis=0)
            for a, b in zip(nodes[:-1], nodes[1:], strict=True)
        ]
        choice = Choice(costs)
        least = np.full(len(costs), self._least_mm)
        if from_start:
            least[0] = self._first_mm
        straight: dict[tuple[int, int, int], bool] = {}
        tried: Counter[tuple[int, int, int]] = Counter()
        while True:
            path = self._mostly_straight(choice, nodes, straight, least)
            knots = np.array([layer[node] for layer, node in zip(nodes, path, strict=True)])
            edges = [(k, int(path[k]), int(path[k + 1])) for k in range(len(costs))]
            legs: list[Floats] = []
            for edge, a, b in zip(edges, knots[:-1], knots[1:], strict=True):
                if straight[edge]:
                    legs.append(np.array([a, a + self._shorter(b - a)]))
                elif (leg := self._round(a, b, least[edge[0]], tried[edge])) is not None:
                    legs.append(leg)
                else:
                    break
            blocked = len(legs)
            if blocked == len(costs):
                ways, blocked = self._in_range(knots, legs, least, from_start)
                if ways:
                    return ways, [pair[node] for pair, node in zip(pairs, path, strict=True)]
            # Other pairs of configurations have their turn before more effort is made.
            edge = edges[blocked]
            tried[edge] += 1
            choice.raise_cost(blocked, edge[1:], TRIED_S if tried[edge] < len(SEARCHES) else np.inf)
            count = sum(n for (layer, *_), n in tried.items() if layer == blocked)
            total = choice.best(np.zeros(len(nodes[0])))[1]
            if count == DETOURS_TRIED or not np.isfinite(total) or self._detours.over:
                told = _no_way(views[blocked], views[blocked + 1], count, self._detours.looked)
                raise NoWayError(told)

    def _mostly_straight(
        self,
        choice: Choice,
        nodes: list[Floats],
        straight: dict[tuple[int, int, int], bool],
        least_mm: Floats,
    ) -> Indices:
        """The best path of which it is known which moves are clear where straight."""
        path = np.zeros(0, np.intp)
        for _ in range(ROUNDS):
            path, _ = choice.best(np.zeros(len(nodes[0])))
            edges = [
                (k, int(i), int(j))
                for k, (i, j) in enumerate(zip(path[:-1], path[1:], strict=True))
            ]
            unknown = [edge for edge in edges if edge not in straight]
            if not unknown:
                break
            starts = np.array([nodes[k][i] for k, i, _ in unknown])
            ends = np.array([nodes[k + 1][j] for k, _, j in unknown])
            way = self._shorter(ends - starts)
            for least in np.unique(least_mm):
                mine = [m for m, edge in enumerate(unknown) if least_mm[edge[0]] == least]
                clear = self._both.straight(starts[mine], starts[mine] + way[mine], float(least))
                for m, good in zip(mine, clear.tolist(), strict=True):
                    k, i, j = unknown[m]
                    straight[k, i, j] = good
                    if not good:
                        choice.raise_cost(k, (i, j), DETOUR_S)
        return path

    def _shorter(self, moves: Floats) -> Floats:
        """Moves on the shorter side, of joints that can make a full turn."""
        return np.where(self._turns, (moves + np.pi) % (2 * np.pi) - np.pi, moves)

    def _round(self, start: Floats, end: Floats, least_mm: float, effort: int) -> Floats | None:
        """Knots of a detour, which may end full turns away."""
        key = np.concatenate([start, end, [least_mm, effort]]).tobytes()
        if key not in self._known:
            self._known[key] = self._detours.between(start, end, least_mm, effort)
        return self._known[key]

    def _in_range(
        self, knots: Floats, legs: list[Floats], least_mm: Floats, from_start: bool
    ) -> tuple[list[Floats], int]:
        """The legs with full turns added that keep all joints in their ranges.

        Where leg after leg turns a joint the same way, it has to be turned back somewhere.

        Returns:
            the legs; none where it was sought in vain, and where that was last.
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
                elif self._both.straight(a[None], b[None], least_mm[k])[0]:
                    way = np.array([a, b])
                else:
                    way = self._detours.between(a, b, least_mm[k], 0, turning=False)
                if way is None:
                    rewinding_s[k] += REWIND_AGAIN_S
                    blocked = k
                    break
                ways.append(way)
            else:
                # A single view has no way to another.
                return ways or [placed], 0
        return [], blocked

    def _polished(self, joints: Floats, views: NDArray[np.intp], targets: list[Target]) -> Floats:
        """The same knots; mink has the last word on those with a view."""
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

    def _home(self, first: Target, joints: Floats) -> Floats:
        def clear(home: Floats) -> bool:
            return bool(self._both.straight(home[None], joints[None], self._least_mm)[0])

        return home_off(first, joints, self._kinematics, clear, self._least_mm)


def _rolled(pose: Pose, angle: float) -> Pose:
    """Turned about its own z axis, rad."""
    about_z = scipy.spatial.transform.Rotation.from_euler("z", angle)
    turned = scipy.spatial.transform.Rotation.from_quat(pose.quat) * about_z
    return Pose(pose.position, turned.as_quat()) if angle else pose


def _no_way(before: int, after: int, tried: int, looked: int) -> str:
    origin = f"view {before}" if before >= 0 else "the start"
    return (
        f"from {origin} to view {after}: no way found in {tried} searches between pairs of "
        f"configurations, {looked} others looked at"
    )
