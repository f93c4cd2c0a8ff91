"""Connection of reachable directions by collision-free paths.

Clear straight joint paths join configurations of neighbouring directions, the nearest first, and
only between components that are not joined yet. Directions outside the largest component are then
tried with detours.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy

from twinct.core.progress import Progress
from twinct.geometry import Floats
from twinct.robots.motion.feasible import Feasible, Flags, Indices
from twinct.robots.motion.path_planner import Detours
from twinct.robots.reach.holding import Holder

NEIGHBOURS = 8
"""Number of nearest directions, the direction itself included, to which paths are tried."""

FARTHEST_RAD = 1.5
"""Largest turn of a joint on a straight path that is tried."""

AT_ONCE = 32
"""Number of straight paths that are checked at once."""

TRIES = 3
"""Number of detours tried from a direction to the largest component, nearest pairs first."""

EFFORT = 0
"""Effort of the detours, an index into ``SEARCHES``."""


def joined(
    holder: Holder, directions: Floats, nodes: Mapping[int, Floats], progress: Progress
) -> list[int]:
    """Return the largest set of directions that paths join.

    Args:
        holder: feasibility checks of the cell.
        directions: unit vectors, (d, 3).
        nodes: configurations of each reachable direction, (m, n).
        progress: progress display.
    """
    if not nodes:
        return []
    cell, least_mm = holder.cell, holder.least_mm
    joints = np.vstack(list(nodes.values()))
    whose = np.repeat(list(nodes), [len(of) for of in nodes.values()])
    turns = np.ptp(cell.joint_ranges, axis=1) > 3 * np.pi
    room, parts = Feasible(cell), scipy.cluster.hierarchy.DisjointSet(range(len(joints)))
    edges = _edges(directions, joints, whose, turns)
    with progress.stage("straight paths", len(edges)) as step:
        for start in range(0, len(edges), AT_ONCE):
            some = edges[start : start + AT_ONCE]
            open_ = [(a, b) for a, b in some.tolist() if not parts.connected(a, b)]
            for _ in some:
                step()
            if not open_:
                continue
            a, b = np.array(open_).T
            good = room.straight(joints[a], joints[a] + _way(joints[a], joints[b], turns), least_mm)
            for one, other in zip(a[good].tolist(), b[good].tolist(), strict=True):
                parts.merge(one, other)
    detours = Detours(cell, room, turns, 0)
    of_node = np.array([parts[node] for node in range(len(joints))])
    largest = _largest(of_node, whose)
    apart = sorted(set(nodes) - set(whose[of_node == largest].tolist()))
    with progress.stage("detours", len(apart)) as step:
        for view in apart:
            step()
            of_node = np.array([parts[node] for node in range(len(joints))])
            main, mine = np.flatnonzero(of_node == parts[largest]), np.flatnonzero(whose == view)
            if np.isin(mine, main).any():
                continue
            far = np.abs(_way(joints[mine][:, None], joints[main], turns)).max(axis=2)
            pairs = np.stack([mine, main[far.argmin(axis=1)]], axis=1)
            for a, b in pairs[np.argsort(far.min(axis=1), kind="stable")][:TRIES].tolist():
                if detours.between(joints[a], joints[b], least_mm, EFFORT) is not None:
                    parts.merge(a, b)
                    break
    of_node = np.array([parts[node] for node in range(len(joints))])
    return sorted(set(whose[of_node == _largest(of_node, whose)].tolist()))


def _way(start: Floats, end: Floats, turns: Flags) -> Floats:
    """Return the motion of each joint, the shorter way round for joints with full turns."""
    way = end - start
    return np.where(turns, (way + np.pi) % (2 * np.pi) - np.pi, way)


def _edges(directions: Floats, joints: Floats, whose: Indices, turns: Flags) -> Indices:
    """Pair each node with the nearest node of each neighbour, nearest pairs first, (e, 2)."""
    views = np.unique(whose)
    tree = scipy.spatial.KDTree(directions[views])
    _, near = tree.query(directions[views], min(NEIGHBOURS, len(views)))
    chosen = []
    for view, others in zip(views, views[near.reshape(len(views), -1)], strict=True):
        mine = np.flatnonzero(whose == view)
        for other in others:
            theirs = np.flatnonzero(whose == other)
            far = np.abs(_way(joints[mine][:, None], joints[theirs], turns)).max(axis=2)
            far[mine[:, None] == theirs] = np.inf
            chosen.append(np.stack([far.min(axis=1), mine, theirs[far.argmin(axis=1)]], axis=1))
    edges = np.vstack(chosen)
    edges = edges[edges[:, 0] < FARTHEST_RAD]
    edges = edges[np.argsort(edges[:, 0], kind="stable"), 1:].astype(np.intp)
    _, first = np.unique(np.sort(edges, axis=1), axis=0, return_index=True)
    return edges[np.sort(first)]


def _largest(of_node: Indices, whose: Indices) -> int:
    """Return the component with configurations of the most directions."""
    labels, part = np.unique(of_node, return_inverse=True)
    views = np.unique(np.stack([part, whose], axis=1), axis=0)[:, 0]
    return int(labels[np.bincount(views).argmax()])
