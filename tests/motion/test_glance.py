"""A collisions at a configuration tells the same as all distances."""

from __future__ import annotations

import numpy as np

from twinct.robots.cell import CellModel
from twinct.robots.motion.collision_check import CollisionCheck
from twinct.robots.motion.feasible import Feasible


def test_a_glance_tells_what_distances_tell(cell: CellModel) -> None:
    joints = np.random.default_rng(1).uniform(-6, 6, (1200, 12))
    collisions, room = CollisionCheck(cell), Feasible(cell)
    for least_mm in (16.0, 10.5):
        collisions.keep(least_mm)
        seen = [collisions.clear(q) for q in joints]
        clear = room.clear(joints, least_mm)
        assert 0.1 < clear.mean() < 0.9
        np.testing.assert_array_equal(seen, clear)
    assert collisions.looked == 2 * len(joints)
    assert not cell.model.geom_margin.any()  # the cell is not changed
