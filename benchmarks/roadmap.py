"""Whether a gap between two views can be closed: a roadmap that shares nothing with the planner.

Kavraki, Svestka, Latombe and Overmars, "Probabilistic roadmaps for path planning in
high-dimensional configuration spaces", IEEE Transactions on Robotics and Automation 12 (1996).
"""

from __future__ import annotations

import copy
import time

import mujoco
import numpy as np
from referee import Referee
from scipy.cluster.hierarchy import DisjointSet

from twinct.geometry import MM_PER_M, Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel
from twinct.scenario import InverseKinematics

NEIGHBOURS = 12
"""Nodes that a new one is connected to, at most."""

STEP_RAD = 0.04
"""Between configurations of a straight path that are looked at."""

ENDS = 12
"""Configurations of each view that are nodes."""


class Roadmap:
    """Grows in one cell. Joints that can turn round are angles."""

    def __init__(self, cell: CellModel, least_mm: float, ik: InverseKinematics, seed: int = 0):
        self._cell, self._rng = cell, np.random.default_rng(seed)
        self._args = (cell, least_mm, ik)
        self._model = copy.copy(cell.model)
        self._model.geom_margin[:] = self._model.body_margin[:] = least_mm / MM_PER_M / 2
        self._data = mujoco.MjData(self._model)
        self._low, self._high = cell.joint_ranges.T
        self._turns = self._high - self._low > 3 * np.pi
        self._nodes = np.zeros((0, len(self._low)))

    def connects(
        self, first: PosePairs, second: PosePairs, roll_free: tuple[bool, bool], seconds: float
    ) -> bool:
        """Whether some configuration of one view was led to some configuration of another."""
        begin = time.process_time()
        groups = [self._held(target, roll_free) for target in (first, second)]
        self._set = DisjointSet()
        ends = [[self._added(q) for q in group] for group in groups]
        while time.process_time() - begin < seconds:
            low = np.where(self._turns, -np.pi, self._low)
            joints = self._rng.uniform(low, np.where(self._turns, np.pi, self._high))
            if self._rng.random() < 0.5:
                # Narrow places are near the views: half of all draws are about them.
                node = self._nodes[self._rng.integers(min(len(self._nodes), 2 * ENDS))]
                joints = node + self._rng.normal(0, 0.5, len(node))
                joints = np.where(self._turns, joints, joints.clip(self._low, self._high))
            if not self._clear(joints):
                continue
            self._added(joints)
            if any(self._set.connected(a, b) for a in ends[0] for b in ends[1]):
                return True
        return False

    def _held(self, target: PosePairs, roll_free: tuple[bool, bool]) -> list[Floats]:
        """Different configurations of both arms that hold a view."""
        found: list[Floats] = []
        for seed in range(ENDS):
            referee = Referee(*self._args, seed=seed)
            joints = referee.holds(*target[0], roll_free)
            if joints is not None:
                found.append(joints)
        return found

    def _added(self, joints: Floats) -> int:
        """Index of a new node, connected to those near it."""
        index = len(self._nodes)
        self._set.add(index)
        moves = self._moves(self._nodes - joints)
        self._nodes = np.vstack([self._nodes, joints])
        for other in np.argsort(np.abs(moves).sum(axis=1))[:NEIGHBOURS].tolist():
            if not self._set.connected(index, other) and self._straight(joints, moves[other]):
                self._set.merge(index, other)
        return index

    def _moves(self, moves: Floats) -> Floats:
        return np.where(self._turns, (moves + np.pi) % (2 * np.pi) - np.pi, moves)

    def _straight(self, start: Floats, move: Floats) -> bool:
        parts = int(np.ceil(np.abs(move).sum() / STEP_RAD))
        shares = np.arange(1, parts) / parts
        order = np.random.default_rng(parts).permutation(len(shares))
        return all(self._clear(start + share * move) for share in shares[order])

    def _clear(self, joints: Floats) -> bool:
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        return self._data.ncon == 0
