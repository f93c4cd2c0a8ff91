"""Reach of source and panel over a sphere of directions: alone, together, and joined by paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinct.core.errors import InputError
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, Panel, ScanGeometry, fibonacci_directions
from twinct.robots.cell import CellModel, Clearance
from twinct.robots.reach.connected import joined
from twinct.robots.reach.holding import Flags, Holder, TargetPoses
from twinct.robots.sections import Motion
from twinct.trajectory import panel_axes

PAIRS_LOOKED_AT = 16
"""Number of clear pairs per direction from which the pair with the largest clearance is chosen."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Reach of the arms of a cell, for d directions at r radii.

    Attributes:
        isocentre_mm: common point of all beams, (3,).
        directions: unit vectors from the isocentre to the source, (d, 3).
        sod_mm: radii of the source, (r,).
        odd_mm: distance from the isocentre to the panel.
        source: flags of the poses that the source arm alone can hold, (r, d).
        detector: flags of the poses that the detector arm alone can hold, (r, d).
        both: flags of the views that both arms can hold at once, (r, d).
        clearance_mm: largest clearance among the pairs of configurations, NaN without any, (r, d).
        margin_deg: distance of that pair from the nearest end of a joint range, or NaN, (r, d).
        joints: joint configuration of that pair, rad, or NaN, (r, d, n).
        connected: flags of the largest set of directions that collision-free paths join, (r, d);
            None if not requested.
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
) -> TargetPoses:
    """Return the poses of source and upright panel on opposite sides of the isocentre.

    Args:
        directions: unit vectors to the source, (d, 3), none vertical.
        sod_mm: distance from the isocentre to the source.
        odd_mm: distance from the isocentre to the panel.
        isocentre_mm: common point of all beams, (3,).
        panel: pixel lattice.
    """
    u, v = panel_axes(directions)
    sources, panels = isocentre_mm + sod_mm * directions, isocentre_mm - odd_mm * directions
    geometry = ScanGeometry(sources, panels, u, v, panel)
    return TargetPoses.of(geometry)


def check_reach_request(directions: int, sod_mm: Sequence[float], odd_mm: float) -> None:
    """Check the parameters of ``reach`` before any work.

    Raises:
        InputError: no direction, no radius, or a distance that is not positive.
    """
    problems = [] if directions >= 1 else [f"directions: {directions}; at least 1 is needed"]
    problems += [] if len(sod_mm) else ["radii: at least one is needed"]
    for name, value in (*(("radii", sod) for sod in sod_mm), ("odd", odd_mm)):
        if not (np.isfinite(value) and value > 0):
            problems.append(f"{name}: {value:g} mm; a distance must be positive")
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
    """Compute the directions over the whole sphere that the arms can hold.

    Source and panel may roll about the beam. Both arms keep the clearance of a plan.

    Args:
        cell: robot cell.
        motion: tolerances, and the required clearance.
        directions: number of directions.
        sod_mm: radii of the source.
        odd_mm: distance from the isocentre to the panel.
        isocentre_mm: common point of all beams, (3,); the origin by default.
        connected: whether to search for paths between the directions, too.
        seed: seed of the searches.
        progress: progress display.

    Raises:
        InputError: no direction, no radius, or a distance that is not positive.
        MissingExtraError: mink, or OMPL for the search for paths, is not installed.
    """
    radii = np.array(sod_mm, dtype=np.float64)
    check_reach_request(directions, radii.tolist(), odd_mm)
    centre = np.zeros(3) if isocentre_mm is None else np.array(isocentre_mm, dtype=np.float64)
    towards = fibonacci_directions(directions)
    holder = Holder(cell, motion, seed=seed)
    results = [
        _at(
            holder, towards, poses_of(towards, sod, odd_mm, centre, cell.panel), connected, progress
        )
        for sod in radii.tolist()
    ]
    rows: dict[str, Any] = {name: np.stack([one[name] for one in results]) for name in results[0]}
    if not connected:
        rows["connected"] = None
    return Reach(centre, towards, radii, odd_mm, **rows)


def _at(
    holder: Holder, towards: Floats, poses: TargetPoses, connected: bool, progress: Progress
) -> dict[str, Any]:
    """Return the results for one radius, by the attributes of ``Reach``."""
    count, cell = len(poses), holder.cell
    alone = np.zeros((2, count), bool)
    of_arms = [
        holder.alone(matrices, arm) for arm, matrices in enumerate((poses.source, poses.detector))
    ]
    for flags, result in zip(alone, of_arms, strict=True):
        flags[result.pose] = True
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
