"""Placement of the arms: base positions and stand-offs from which they hold the most given views.

The search has two stages and is deterministic for a given seed, unless its time is limited. The
first stage treats each arm alone, independently of the other. It counts the views that the arm can
hold from its own place and from the places of a Halton sequence over the bounds, and improves the
best places on some of the views. Because the panel stands opposite the source, each arm also tries
the best places of the other, mirrored at the middle of the bounds. The second stage evaluates the
most promising pairs of places, and improves the best pairs. An improvement steps along one
coordinate, of one arm or of both, and halves the step when no step helps (pattern search; Hooke and
Jeeves, "Direct search solution of numerical and statistical problems", JACM 8, 1961). A first round
tries few places, and ends the search if both arms hold all views from one of its pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from twinct.core.errors import InputError, ScenarioError
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats
from twinct.robots.cell import CellModel, overlaps
from twinct.robots.motion.branches import SIDES
from twinct.robots.reach.holding import Flags, Holder, TargetPoses
from twinct.robots.reach.pattern_search import climbed
from twinct.robots.reach.search_limit import SearchLimit
from twinct.robots.sections import Cell, Motion

SAMPLES = 128
"""Number of places of each arm alone, in addition to its own."""

FIRST_SAMPLES = 16
"""Number of places of each arm alone in the first round."""

ROUNDS = (0.6, 1.0)
"""Shares of the time at which the two rounds end."""

STAGES = (0.4, 0.6, 0.7, 0.85, 1.0)
"""Shares of a round at which its stages end: alone, improved, on the other arm, pairs, improved."""

PAIRS = 24
"""Number of pairs of places that are evaluated."""

USES = 3
"""Largest number of these pairs that share a place of one arm."""

IMPROVED = 2
"""Number of pairs that are improved."""

IMPROVED_ALONE = 6
"""Number of places of each arm alone that are improved."""

OF_VIEWS = 3
"""Places of an arm alone are improved on every third view."""

STEPS = (80.0, 40.0, 20.0)
"""Steps of the improvement, in mm, and in deg for the tool rotation; the stand-off takes half."""

WAYS = ((1, 1), (1, -1), (1, 0), (0, 1))
"""Factors of a step for both arms: both alike, in opposite directions, or one arm only."""

UNITS = np.diag([1.0, 1.0, 1.0, 0.5, 1.0])
"""Unit steps of all coordinates: base x, y, z, stand-off, tool rotation."""

ALONE_COUNTS = 0.05
"""Weight of views that an arm holds alone, which gives a slope to plateaus of the score."""

ALL_HELD = 1.0 + 2 * ALONE_COUNTS - 1e-9
"""Score of a pair of places from which both arms hold every view."""

BASES_APART_MM = 450.0
"""Least distance between the two bases."""

NOT_FREE = -1.0
"""Score of places at which the cell cannot be built, or fixed bodies overlap."""

STARTS = 8
"""Random starts of the search for a pose, for arms without closed form."""

ROLLS = 2
"""Number of roll angles that are tried during the search: upright and across."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of the placement, each a range (lowest, highest).

    Attributes:
        x_mm: x of each base.
        y_mm: y of each base.
        z_mm: z of each base.
        standoff_mm: stand-off of source and panel.
        tool_rotation_deg: tool rotation of source and panel, unless they may roll freely.
    """

    x_mm: tuple[float, float] = (-1000.0, 1000.0)
    y_mm: tuple[float, float] = (-1000.0, 1000.0)
    z_mm: tuple[float, float] = (-800.0, 400.0)
    standoff_mm: tuple[float, float] = (100.0, 300.0)
    tool_rotation_deg: tuple[float, float] = (-180.0, 180.0)

    def __post_init__(self) -> None:
        """Raise ``InputError`` unless all bounds are ranges."""
        for name, (low, high) in vars(self).items():
            if not (np.isfinite([low, high]).all() and low <= high):
                raise InputError(f"bounds of {name}: {low:g} to {high:g} is not a range")

    @property
    def ranges(self) -> Floats:
        """Bounds as an array, (5, 2)."""
        return np.array(list(vars(self).values()))


@dataclass(frozen=True, eq=False)
class Placement:
    """Result of a search for a placement.

    Attributes:
        cell: the section with the new base poses, stand-offs and tool rotations.
        before: flags of the views that both arms held before, (p,).
        after: flags of the views that both arms hold now, (p,).
        judged: number of cells that were evaluated.
        alone: number of places at which one arm alone was evaluated.
        stopped: whether the search ended because its time was over.
    """

    cell: Cell
    before: Flags
    after: Flags
    judged: int
    alone: int = 0
    stopped: bool = False

    @property
    def overrides(self) -> list[str]:
        """Settings of the placement, each as an argument of ``--set``."""
        return [
            f"cell.{side}_arm.{key}={list(value) if isinstance(value, tuple) else value}"
            for side in SIDES
            for key in ("base_position_mm", "base_rotation_deg", "standoff_mm", "tool_rotation_deg")
            for value in (getattr(getattr(self.cell, f"{side}_arm"), key),)
        ]


def place(
    cell: Cell,
    build: Callable[[Cell], CellModel],
    motion: Motion,
    poses: TargetPoses,
    *,
    roll_free: tuple[bool, bool] = (True, True),
    bounds: Bounds | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    limit: SearchLimit | None = None,
    progress: Progress = SILENT,
) -> Placement:
    """Find the placement of the arms from which they hold the most given views.

    Base rotations change only about the vertical, so that each base faces the middle of the views.
    No base or pillar is placed inside another fixed body.

    Args:
        cell: section of the cell, with the arms in their present places.
        build: builds the model of a cell section.
        motion: tolerances, and the required clearance.
        poses: poses of the views; a few hundred are enough.
        roll_free: whether source and panel may roll about the beam.
        bounds: bounds of the placement.
        samples: initial number of places for each arm.
        seed: seed of the search.
        limit: time that it may take; a search that ends early returns the best places so far.
        progress: progress display.

    Raises:
        InputError: fixed bodies overlap at every place that was tried.
        MissingExtraError: mink is not installed.
    """
    limit = limit or SearchLimit()
    search = _Search(cell, build, motion, poses, roll_free, bounds or Bounds(), seed, limit)
    return search.run(samples, progress)


class _Search:
    def __init__(
        self,
        cell: Cell,
        build: Callable[[Cell], CellModel],
        motion: Motion,
        poses: TargetPoses,
        roll_free: tuple[bool, bool],
        bounds: Bounds,
        seed: int,
        limit: SearchLimit,
    ) -> None:
        self._cell, self._build, self._motion, self._poses = cell, build, motion, poses
        self._roll_free, self._ranges, self._seed = roll_free, bounds.ranges, seed
        self._middle = (poses.source[:, :3, 3] + poses.detector[:, :3, 3]).mean(axis=0) / 2
        self._limit = limit
        self._known: dict[bytes, tuple[float, Flags]] = {}
        self._held_alone: dict[tuple[int, int, bytes], Flags] = {}
        # With a free roll about the beam, the tool rotation is redundant.
        self._open = [slice(0, 4 if free else 5) for free in roll_free]

    def run(self, samples: int, progress: Progress) -> Placement:
        own = np.array([self._coordinates(arm) for arm in range(2)])
        places = [self._spread(own[arm], arm, samples) for arm in range(2)]
        before, best = self._judged(own), own
        counts = (FIRST_SAMPLES, samples) if samples > FIRST_SAMPLES else (samples,)
        began = 0.0
        for count, ended in zip(counts, ROUNDS[-len(counts) :], strict=True):
            shares = [began + share * (ended - began) for share in STAGES]
            some = [of_arm[: count + 1] for of_arm in places]
            best, began = self._round(own, best, some, shares, progress), ended
            self._limit.until(1.0)
            if self._judged(best)[0] >= ALL_HELD or self._limit.over():
                break
        if self._judged(best)[0] == NOT_FREE:
            raise InputError(
                "no place was found within the bounds at which bases and pillars stand outside "
                "every other fixed body; widen the bounds, or try more samples"
            )
        return Placement(
            *(self._as_cell(best), before[1], self._judged(best)[1], len(self._known)),
            *(len({key[::2] for key in self._held_alone}), self._stopped(best)),
        )

    def _stopped(self, best: Floats) -> bool:
        """Return True if the search ended because its time was over."""
        return self._limit.stopped and self._judged(best)[0] < ALL_HELD

    def _round(
        self,
        own: Floats,
        best: Floats,
        places: list[list[Floats]],
        shares: list[float],
        progress: Progress,
    ) -> Floats:
        """Return the best pair of places after all stages, each of which has its time."""
        limit, (first, *later) = self._limit, shares
        limit.until(first)
        with progress.stage("places of each arm", sum(map(len, places))) as step:
            alone = self._reached(places, step)
        limit.until(later[0])
        with progress.stage("improving each arm's best", 2 * IMPROVED_ALONE * len(STEPS)) as step:
            better = [self._improved_alone(alone[arm], arm, step) for arm in range(2)]
        across = [self._across(own[1 - arm], points, 1 - arm) for arm, points in enumerate(better)]
        tried = [better[0] + across[1], better[1] + across[0]]
        limit.until(later[1])
        with progress.stage("trying the best on the other arm", sum(map(len, tried))) as step:
            for of_arm, new in zip(alone, self._reached(tried, step), strict=True):
                of_arm += new
        limit.until(later[2])
        pairs = self._promising(alone)
        with progress.stage("pairs of places", len(pairs)) as step:
            for pair in pairs:
                self._judged(pair)
                step()
                if self._judged(pair)[0] >= ALL_HELD or limit.over():
                    break
        limit.until(later[3])
        pairs = [pair for pair in pairs if pair.tobytes() in self._known]
        best_pairs = sorted([own, best, *pairs], key=lambda pair: -self._judged(pair)[0])
        with progress.stage("improved", IMPROVED * len(STEPS)) as step:
            improved = [self._improved(pair, step) for pair in _distinct(best_pairs)[:IMPROVED]]
        return max(improved, key=lambda pair: self._judged(pair)[0])

    def _reached(
        self, places: list[list[Floats]], step: Callable[[], None]
    ) -> list[list[tuple[Floats, Flags]]]:
        """Return the views that each arm holds alone from places, in turn, while there is time."""
        reached: list[list[tuple[Floats, Flags]]] = [[], []]
        for turn in range(max(map(len, places))):
            for arm, points in enumerate(places):
                if turn < len(points) and (not reached[arm] or not self._limit.over()):
                    held = self._alone(points[turn], arm, self._poses)
                    reached[arm].append((points[turn], held))
                    step()
        return reached

    def _spread(self, own: Floats, arm: int, samples: int) -> list[Floats]:
        """Return an arm's own place, and places spread over the bounds."""
        # Imported here because the import takes half a second.
        from scipy.stats import qmc

        points = qmc.Halton(5, rng=self._seed).random(samples)
        points = qmc.scale(points, *self._ranges.T + [[0], [1e-9]])
        if arm:
            return [own, *self._across(own, list(points), arm)]
        points[:, self._open[arm].stop :] = own[self._open[arm].stop :]
        return [own, *points]

    def _across(self, own: Floats, points: Sequence[Floats], arm: int) -> list[Floats]:
        """Return places of an arm opposite some places of the other arm."""
        mirrored = np.array(points)
        mirrored[:, :2] = self._ranges[:2].sum(axis=1) - mirrored[:, :2]
        mirrored[:, self._open[arm].stop :] = own[self._open[arm].stop :]
        return list(mirrored)

    def _improved_alone(
        self, alone: Sequence[tuple[Floats, Flags]], arm: int, step: Callable[[], None]
    ) -> list[Floats]:
        some = self._poses[np.arange(0, len(self._poses), OF_VIEWS)]

        def held(point: Floats) -> float:
            return int(self._alone(point, arm, some).sum())

        best = sorted(alone, key=lambda of: -of[1].sum())[:IMPROVED_ALONE]
        steps = [UNITS[k] for k in range(self._open[arm].stop)]
        climb = partial(
            climbed,
            sizes=STEPS,
            steps=steps,
            ranges=self._ranges,
            most=len(some),
            over=self._limit.over,
        )
        return [climb(point, score=held, step=step) for point, _ in best]

    def _coordinates(self, arm: int) -> Floats:
        """Return an arm's present coordinates: base x, y, z, stand-off, tool rotation."""
        section = (self._cell.source_arm, self._cell.detector_arm)[arm]
        return np.array([*section.base_position_mm, section.standoff_mm, section.tool_rotation_deg])

    def _as_cell(self, pair: Floats) -> Cell:
        arms = {}
        for arm, point in enumerate(pair):
            section = (self._cell.source_arm, self._cell.detector_arm)[arm]
            if not np.array_equal(point, self._coordinates(arm)):
                x, y, z, standoff, turn = (round(float(value), 1) for value in point)
                if section.tool is not None:  # it has no spacer at least
                    standoff = max(standoff, section.tool.tip_mm[2])
                facing = np.degrees(np.arctan2(self._middle[1] - y, self._middle[0] - x))
                rotation = (*section.base_rotation_deg[:2], round(float(facing), 1))
                section = section.model_copy(
                    update={
                        "base_position_mm": (x, y, z),
                        "base_rotation_deg": rotation,
                        "standoff_mm": standoff,
                        "tool_rotation_deg": turn,
                    }
                )
            arms[f"{SIDES[arm]}_arm"] = section
        return self._cell.model_copy(update=arms)

    def _holder(self, cell: Cell, besides: str | None = None) -> Holder | None:
        """Return the checks of a cell; None if it cannot be, apart from one arm's fixed bodies."""
        try:
            model = self._build(cell)
        except ScenarioError:  # for example, the stand-off leaves no room for the housing
            return None
        if any(besides not in (o.first.owner, o.second.owner) for o in overlaps(model)):
            return None
        return Holder(
            model,
            self._motion,
            roll_free=self._roll_free,
            starts=STARTS,
            rolls=ROLLS,
            seed=self._seed,
        )

    def _alone(self, point: Floats, arm: int, poses: TargetPoses) -> Flags:
        """Return flags of the views that an arm holds, ignoring the other arm's moving links.

        The other arm's base and pillar count as obstacles, but may stand in a wrong place.
        """
        key = arm, len(poses), point.tobytes()
        if key not in self._held_alone:
            self._held_alone[key] = self._judge_alone(point, arm, poses)
        return self._held_alone[key]

    def _judge_alone(self, point: Floats, arm: int, poses: TargetPoses) -> Flags:
        pair = np.array([self._coordinates(0), self._coordinates(1)])
        pair[arm] = point
        holder = self._holder(self._as_cell(pair), SIDES[1 - arm])
        if holder is None:
            return np.zeros(len(poses), bool)
        return holder.can((poses.source, poses.detector)[arm], arm)

    def _promising(self, alone: list[list[tuple[Floats, Flags]]]) -> list[Floats]:
        """Return the pairs of places whose arms, each alone, hold the most views in common."""
        masks = [np.array([flags for _, flags in of]).astype(int) for of in alone]
        count, pairs = masks[0] @ masks[1].T, []
        uses = [np.zeros(len(of), int) for of in alone]
        for index in np.argsort(-count, axis=None, kind="stable").tolist():
            i, j = divmod(index, count.shape[1])
            pair = np.array([alone[0][i][0], alone[1][j][0]])
            if uses[0][i] < USES and uses[1][j] < USES and self._allowed(pair):
                uses[0][i] += 1
                uses[1][j] += 1
                pairs.append(pair)
                if len(pairs) == PAIRS:
                    break
        return pairs

    def _allowed(self, pair: Floats) -> bool:
        return bool(np.linalg.norm(pair[0, :2] - pair[1, :2]) >= BASES_APART_MM)

    def _judged(self, pair: Floats) -> tuple[float, Flags]:
        """Return the score of a pair of places, and flags of the views that both arms hold."""
        key = pair.tobytes()
        if key not in self._known:
            self._known[key] = self._judge(pair)
        return self._known[key]

    def _judge(self, pair: Floats) -> tuple[float, Flags]:
        holder = self._holder(self._as_cell(pair))
        if holder is None:
            return NOT_FREE, np.zeros(len(self._poses), bool)
        held, alone = holder.held_by(self._poses)
        score = held.mean() + ALONE_COUNTS * alone.mean(axis=1).sum()
        return float(score), held

    def _improved(self, pair: Floats, step: Callable[[], None]) -> Floats:
        steps = [
            np.outer(np.array(arms, float), UNITS[k])
            for arms in WAYS
            for k in range(min(self._open[arm].stop for arm in range(2) if arms[arm]))
        ]

        def score(trial: Floats) -> float:
            return self._judged(trial)[0] if self._allowed(trial) else -np.inf

        return climbed(pair, STEPS, steps, self._ranges, score, step, ALL_HELD, self._limit.over)


def _distinct(pairs: list[Floats]) -> list[Floats]:
    return list({pair.tobytes(): pair for pair in pairs}.values())
