"""Where on the sphere source and panel can go: alone, together, and from one place to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinct.cell import CellModel, Clearance
from twinct.errors import InputError
from twinct.geometry import Floats, Panel, ScanGeometry, fibonacci_directions
from twinct.progress import SILENT, Progress
from twinct.reach.connected import joined
from twinct.reach.holding import Flags, Holder, Poses
from twinct.scenario import Motion
from twinct.trajectory import panel_axes

PAIRS_LOOKED_AT = 16
"""Clear pairs of a direction of which the one with the largest clearance is told."""


@dataclass(frozen=True, eq=False)
class Reach:
    """What the arms of a cell can hold, for d directions at r radii.

    Attributes:
        isocentre_mm: what all beams go through, (3,).
        directions: unit vectors from the isocentre to the source, (d, 3).
        sod_mm: radii of the source, (r,).
        odd_mm: from the isocentre to the panel.
        source: whether the source arm alone can hold its pose, (r, d).
        detector: the same of the panel's arm, (r, d).
        both: whether both can at a time, (r, d).
        clearance_mm: the largest that was found of both; NaN where there is none, (r, d).
        margin_deg: of that pair, from the nearest end of a joint's range; NaN likewise, (r, d).
        joints: that pair, rad, NaN likewise, (r, d, n).
        connected: whether collision-free ways join it with most of the others, (r, d); None where
            nobody asked.
    """

    isocentre_mm: Floats
    directions: Floats
    sod_mm: Floats
    odd_mm: float
    source: Flags
    detector: Flags
    both: Flags
    clearance_mm: Floats
    margin_deg: Floats
    joints: Floats
    connected: Flags | None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.setflags(write=False)


def poses_of(
    directions: Floats, sod_mm: float, odd_mm: float, isocentre_mm: Floats, panel: Panel
) -> Poses:
    """Source and upright panel on both sides of the isocentre.

    Args:
        directions: unit vectors to the source, (d, 3), none vertical.
        sod_mm: from the isocentre to the source.
        odd_mm: from the isocentre to the panel.
        isocentre_mm: what the beams go through, (3,).
        panel: the pixel lattice.
    """
    u, v = panel_axes(directions)
    sources, panels = isocentre_mm + sod_mm * directions, isocentre_mm - odd_mm * directions
    geometry = ScanGeometry(sources, panels, u, v, panel)
    return Poses.of(geometry.source_poses(), geometry.detector_poses())


def check_asked(directions: int, sod_mm: Sequence[float], odd_mm: float) -> None:
    """Look at what is asked for before any work.

    Raises:
        InputError: no direction, no radius, or one that is none.
    """
    problems = [] if directions >= 1 else [f"directions: {directions}: at least 1 is needed"]
    problems += [] if len(sod_mm) else ["radii: at least one is needed"]
    for name, value in (*(("radii", sod) for sod in sod_mm), ("odd", odd_mm)):
        if not (np.isfinite(value) and value > 0):
            problems.append(f"{name}: {value:g} mm: a distance must be positive")
    if problems:
        raise InputError(problems)


def reach(
    cell: CellModel,
    motion: Motion,
    *,
    directions: int = 1000,
    sod_mm: Sequence[float] = (300.0,),
    odd_mm: float = 300.0,
    isocentre_mm: Floats | None = None,
    connected: bool = False,
    seed: int = 0,
    progress: Progress = SILENT,
) -> Reach:
    """Ask for directions all over the sphere whether the arms can hold them.

    Source and panel may be turned about the beam. Both arms keep the clearance of a plan.

    Args:
        cell: the room.
        motion: tolerances, and the clearance asked for.
        directions: how many.
        sod_mm: radii of the source.
        odd_mm: from the isocentre to the panel.
        isocentre_mm: what the beams go through, (3,); the origin unless given.
        connected: also seek ways between them.
        seed: of searches.
        progress: hears how far it is.

    Raises:
        InputError: no direction, or a radius that is none.
        MissingExtraError: mink, or OMPL where ways are sought, is not installed.
    """
    radii = np.array(sod_mm, dtype=np.float64)
    check_asked(directions, radii.tolist(), odd_mm)
    centre = np.zeros(3) if isocentre_mm is None else np.array(isocentre_mm, dtype=np.float64)
    towards = fibonacci_directions(directions)
    holder = Holder(cell, motion, seed=seed)
    found = [
        _at(
            holder, towards, poses_of(towards, sod, odd_mm, centre, cell.panel), connected, progress
        )
        for sod in radii.tolist()
    ]
    rows: dict[str, Any] = {name: np.stack([one[name] for one in found]) for name in found[0]}
    if not connected:
        rows["connected"] = None
    return Reach(centre, towards, radii, odd_mm, **rows)


def _at(
    holder: Holder, towards: Floats, poses: Poses, connected: bool, progress: Progress
) -> dict[str, Any]:
    """The rows of one radius, by the attributes of ``Reach``."""
    count, cell = len(poses), holder.cell
    alone = np.zeros((2, count), bool)
    of_arms = [
        holder.alone(matrices, arm) for arm, matrices in enumerate((poses.source, poses.detector))
    ]
    for flags, found in zip(alone, of_arms, strict=True):
        flags[found.pose] = True
    clearance, ranges = Clearance(cell), cell.joint_ranges
    gaps, margin = np.full((2, count), np.nan)
    joints = np.full((count, len(ranges)), np.nan)
    nodes: dict[int, Floats] = {}
    views = np.flatnonzero(alone.all(axis=0)).tolist()
    with progress.stage("pairs of arms", len(views)) as step:
        for view in views:
            step()
            pairs = holder.pairs(of_arms[0], of_arms[1], view, PAIRS_LOOKED_AT)
            if not len(pairs):
                continue
            each = np.array([clearance.over(q[None]).distance_mm for q in pairs])
            pairs = pairs[np.argsort(-each, kind="stable")]
            joints[view], gaps[view] = pairs[0], each.max()
            to_ends = np.minimum(pairs[0] - ranges.T[0], ranges.T[1] - pairs[0])
            margin[view] = np.degrees(to_ends.min())
            nodes[view] = pairs
    both, ways = np.isfinite(gaps), np.zeros(count, bool)
    if connected:
        ways[joined(holder, towards, nodes, progress)] = True
    return {
        "source": alone[0],
        "detector": alone[1],
        "both": both,
        "clearance_mm": gaps,
        "margin_deg": margin,
        "joints": joints,
        "connected": ways,
    }
