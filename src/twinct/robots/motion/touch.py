"""Contact of bodies during a motion, as MuJoCo finds it in each cycle."""

from __future__ import annotations

import numpy as np

from twinct.geometry import MM_PER_M
from twinct.robots.cell import CellModel, mujoco
from twinct.robots.motion.refusals import readable

DEEPER_MM = 0.1
"""Depth by which bodies that touch at the start may press deeper than before, or touch again.

A body that two servos lift rocks on another: by 0.002 mm as a panel left a table.
"""


class Touch:
    """Bodies that touch: a motion may leave a contact, but neither make nor deepen one."""

    def __init__(self, cell: CellModel) -> None:
        """Start with no contact."""
        self._cell = cell
        # Least depth so far of each pair of geoms that touched at the start; 0 once apart.
        self._depths_m: dict[tuple[int, int], float] = {}

    def begin(self, data: mujoco.MjData) -> None:
        """Note which bodies touch at the start of a motion."""
        self._depths_m = _depths_m(data)

    def made(self, data: mujoco.MjData) -> tuple[str, str] | None:
        """Return the names of two bodies in new or deeper contact; None if there are none."""
        if not data.ncon and not self._depths_m:
            return None
        now_m = _depths_m(data)
        for pair, depth_m in now_m.items():
            if depth_m > self._depths_m.get(pair, -np.inf) + DEEPER_MM / MM_PER_M:
                first, second = sorted(self._cell.body_of_geom(geom) for geom in pair)
                return first, second
        self._depths_m = {p: min(d, now_m.get(p, 0.0)) for p, d in self._depths_m.items()}
        return None


def touches(pair: tuple[str, str]) -> str:
    """Return that two bodies touch, in words."""
    return f"{readable(pair[0])} touches {readable(pair[1])}"


def _depths_m(data: mujoco.MjData) -> dict[tuple[int, int], float]:
    """Return the largest depth of each pair of geoms that touch."""
    depths_m: dict[tuple[int, int], float] = {}
    for contact in data.contact:
        first, second = (int(geom) for geom in contact.geom)
        pair = min(first, second), max(first, second)
        depths_m[pair] = max(depths_m.get(pair, -np.inf), -float(contact.dist))
    return depths_m
