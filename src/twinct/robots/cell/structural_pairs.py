"""Pairs of links of one arm whose gap says nothing: no pose makes it smaller or larger.

The hull of a forked link contains the link in its fork, and a wrist's housings stand a constant gap
apart. A plan that asked such a pair for a clearance could never have it.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats
from twinct.robots.cell._mujoco import mujoco_module

if TYPE_CHECKING:
    import mujoco

POSES = 100
"""Random configurations in which pairs of links are looked at."""

CONSTANT_M = 0.0005
"""Largest change of a gap that counts as constant: the joints between turn about the surfaces."""

NEVER_FAR_M = 0.01
"""Gap that a pair never has: plans ask for ``motion.clearance_mm``, 10 mm unless it is set."""

SOUGHT_M = 0.2
"""Distance beyond which a gap is not measured, and no pair is structural."""


def exclude_structural(spec: mujoco.MjSpec, model: mujoco.MjModel) -> tuple[str, ...]:
    """Exclude pairs of links that can never be clear of each other, and return notes about them.

    Excluded are pairs that overlap in every configuration, whose gap is constant, or is never as
    large as the usual clearance. MoveIt's setup treats such pairs in this way, too.
    """
    mujoco = mujoco_module()
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    low, high = model.jnt_range.T
    pairs = _pairs(model)
    gaps = {pair: np.full(POSES, np.inf) for pair in pairs}
    for pose in range(POSES):
        data.qpos[:] = rng.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        for pair in list(gaps):
            gap = min(
                mujoco.mj_geomDistance(model, data, a, b, SOUGHT_M, None) for a, b in pairs[pair]
            )
            gaps[pair][pose] = gap
            seen = gaps[pair][: pose + 1]
            if _moves_apart(seen):
                del gaps[pair]
    kinds = {
        "as their hulls overlap in every pose": [],
        "as their gap is constant or never 10 mm": [],
    }
    overlap, near = kinds.values()
    for pair, seen in gaps.items():
        (overlap if seen.max() < 0 else near).append(pair)
        exclude(spec, model, *pair)
    return tuple(
        f"not checked against each other, {why}: {_named(model, found)}"
        for why, found in kinds.items()
        if found
    )


def _moves_apart(gaps: Floats) -> bool:
    """Return True if gaps, m, are those of a pair that can be clear of each other."""
    far = float(gaps.max())
    return far >= NEVER_FAR_M and (far >= SOUGHT_M or float(np.ptp(gaps)) > CONSTANT_M)


def without_structural(
    model: mujoco.MjModel, pairs: np.ndarray, tools: Iterable[str]
) -> np.ndarray:
    """Return the pairs without those of a tool and the link before the last that never part.

    Args:
        model: the cell.
        pairs: geom ids, (p, 2).
        tools: names of the tools' bodies.
    """
    mujoco, welded = mujoco_module(), model.body_weldid
    data, keep = mujoco.MjData(model), np.ones(len(pairs), bool)
    for tool in (model.body(name).id for name in tools):
        last = int(welded[tool])
        before, joint = int(welded[model.body_parentid[last]]), int(model.body_jntadr[last])
        low, high = model.jnt_range[joint]
        links = welded[model.geom_bodyid[pairs]]
        own = (model.geom_bodyid[pairs] == tool).any(axis=1)
        near = np.flatnonzero(own & (links == before).any(axis=1))
        gaps = np.empty((POSES, len(near)))
        for pose, angle in enumerate(np.linspace(low, high, POSES)):
            data.qpos[joint] = angle
            mujoco.mj_kinematics(model, data)
            for k, (a, b) in enumerate(pairs[near].tolist()):
                gaps[pose, k] = mujoco.mj_geomDistance(model, data, a, b, SOUGHT_M, None)
        keep[near] = [_moves_apart(seen) for seen in gaps.T]
    return pairs[keep]


def exclude_stated(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    pairs: Iterable[tuple[str, str]],
    origin: str,
    where: str,
) -> tuple[str, ...]:
    """Exclude the pairs of links that somebody states, and return a note about them.

    Args:
        spec: the arm.
        model: its compiled form.
        pairs: names of the links.
        origin: who states them, for messages.
        where: name of the file in messages.

    Raises:
        ScenarioError: the arm has no such link.
    """
    names = [model.body(body).name for body in range(1, model.nbody)]
    pairs = list(pairs)
    if unknown := sorted({name for pair in pairs for name in pair} - set(names)):
        raise ScenarioError(
            f"{where} has no link {', '.join(map(quoted, unknown))}, which {origin} names: it has "
            f"{', '.join(names)}"
        )
    bodies = [(model.body(one).id, model.body(other).id) for one, other in pairs]
    for pair in bodies:
        exclude(spec, model, *pair)
    if not bodies:
        return ()
    return (f"not checked against each other, by {origin}: {_named(model, bodies)}",)


def exclude(spec: mujoco.MjSpec, model: mujoco.MjModel, one: int, other: int) -> None:
    """Exclude two links with all bodies that are welded to them."""
    pieces = [np.flatnonzero(model.body_weldid == model.body_weldid[link]) for link in (one, other)]
    if 0 in (model.body_weldid[one], model.body_weldid[other]):  # what stands is no one link
        pieces = [
            np.array([link]) if model.body_weldid[link] == 0 else piece
            for link, piece in zip((one, other), pieces, strict=True)
        ]
    for a, b in product(*pieces):
        if a != b:
            spec.add_exclude(bodyname1=model.body(int(a)).name, bodyname2=model.body(int(b)).name)


def _pairs(model: mujoco.MjModel) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """Return the pairs of solid shapes of links that no joint joins, by their links."""
    solid = np.flatnonzero((model.geom_contype | model.geom_conaffinity) != 0)
    bodies, welded = model.geom_bodyid, model.body_weldid[model.geom_bodyid]
    links = np.where(welded == 0, bodies, welded)  # each body that stands is one link
    above = model.body_weldid[model.body_parentid[links]]
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for k, a in enumerate(solid.tolist()):
        for b in solid[k + 1 :].tolist():
            joined = welded[a] == welded[b] or above[a] == welded[b] or above[b] == welded[a]
            if not joined:
                one, other = sorted((int(links[a]), int(links[b])))
                pairs.setdefault((one, other), []).append((a, b))
    return pairs


def _named(model: mujoco.MjModel, pairs: Iterable[tuple[int, int]]) -> str:
    names = ((model.body(link).name for link in pair) for pair in pairs)
    return ", ".join(f"{one} and {other}" for one, other in names)
