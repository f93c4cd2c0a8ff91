"""Poses of the parts of a CTSimU scene: placement, stage rotation, deviations, drifts.

A part has a centre and two orthogonal vectors: u and w, or r and t for a sample; v = w x u. It is
given in the world (x, y, z) or, for a sample only, in the stage (u, v, w). The order is as in BAM's
own loader for aRTist: the stage turns about its w, then the deviations are applied one by one, then
the drifts of centre and vectors are added.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from twinct.ctsimu.drifts import short
from twinct.ctsimu.ranges import FARTHEST_MM, PLACE, Interval
from twinct.ctsimu.reader import JsonSection
from twinct.geometry import Floats, Pose

WORLD, LOCAL, SAMPLE = ("x", "y", "z"), ("u", "v", "w"), ("r", "s", "t")
COMPONENT = Interval(-FARTHEST_MM, FARTHEST_MM)
"""Limits of a direction's component, so that its square is finite."""
ORTHOGONAL = 1e-3
"""Maximum cosine between u and w that counts as a right angle; four digits suffice."""


def place(
    section: JsonSection,
    *,
    turn_deg: float = 0.0,
    world_from_stage: Pose | None = None,
    vectors: tuple[str, str] = ("vector_u", "vector_w"),
) -> Pose:
    """Return a part's pose in the world at the section's moment; axes u, v, w (or r, s, t).

    Args:
        section: section with ``center``, the two vectors and ``deviations``.
        turn_deg: the stage's rotation about the part's own w, before all deviations.
        world_from_stage: stage pose for a sample that may stand on the stage.
        vectors: keys of the first and the third axis.
    """
    stage = world_from_stage if section.section("center", needed=True).has("u") else None
    axes = WORLD if stage is None else LOCAL
    centre, drift = _vector(section, "center", axes, "mm")
    centre = np.nan_to_num(centre)  # already reported
    first, first_drift = _vector(section, vectors[0], axes)
    third, third_drift = _vector(section, vectors[1], axes)
    basis = _basis(section, vectors, first, third)
    basis = basis @ Rotation.from_rotvec([0, 0, turn_deg], degrees=True).as_matrix()
    pose = Pose.from_matrix(centre, basis)
    for deviation in section.sections("deviations"):
        pose = _deviate(pose, deviation, stage)
    if first_drift.any() or third_drift.any():
        # Vectors drift from unit length, whatever length the file states.
        axes_now = pose.rotation
        basis = _basis(section, vectors, axes_now[:, 0] + first_drift, axes_now[:, 2] + third_drift)
        pose = Pose.from_matrix(pose.position, basis)
    pose = Pose(pose.position + drift, pose.quat)
    return pose if stage is None else stage @ pose


def _deviate(pose: Pose, deviation: JsonSection, world_from_stage: Pose | None) -> Pose:
    """Apply one translation or rotation to a pose in the stage, or in the world without a stage."""
    kind = deviation.text("type", ("translation", "rotation"))
    deviation.require("type")
    known = deviation.flag("known_to_reconstruction", True)
    axis = _turned(deviation, "axis", pose, world_from_stage)
    pivot = _pivot(deviation, pose, world_from_stage)
    amount = deviation.needed("amount", "mm" if kind == "translation" else "rad", PLACE)
    length = float(np.linalg.norm(axis))
    if length == 0:
        deviation.problem("axis", "has no direction")
        return pose
    if not np.isfinite([*axis, *pivot, amount]).all():
        return pose  # already reported
    if not known and deviation.moment.believed:
        return pose
    axis = axis / length
    if kind == "translation":
        return Pose(pose.position + amount * axis, pose.quat)
    turn = Rotation.from_rotvec(amount * axis)
    quat = (turn * Rotation.from_quat(pose.quat)).as_quat()
    return Pose(pivot + turn.apply(pose.position - pivot), quat)


def _turned(section: JsonSection, key: str, pose: Pose, world_from_stage: Pose | None) -> Floats:
    """Return an axis in the frame of the pose."""
    value = section.data.get(key)
    if isinstance(value, str):
        section.skip(key)
        for names in (WORLD, LOCAL, SAMPLE):
            if value in names:
                axis = np.eye(3)[names.index(value)]
                return _frame(names, pose, world_from_stage).rotate(axis)
        section.problem(
            key, f"{short(value)} is not an axis; allowed: x y z u v w r s t or a vector"
        )
        return np.full(3, np.nan)
    names = _names(section.section(key, needed=True))
    direction, drift = _vector(section, key, names)
    return _frame(names, pose, world_from_stage).rotate(direction + drift)


def _frame(names: tuple[str, ...], pose: Pose, world_from_stage: Pose | None) -> Pose:
    """Return the pose of named axes in the frame of ``pose``."""
    if names is WORLD:
        return Pose.identity() if world_from_stage is None else world_from_stage.inverse()
    return Pose.identity() if names is LOCAL and world_from_stage is not None else pose


def _pivot(section: JsonSection, pose: Pose, world_from_stage: Pose | None) -> Floats:
    if not section.has("pivot"):
        section.skip("pivot")
        return pose.position
    names = _names(section.section("pivot"))
    point, drift = _vector(section, "pivot", names, "mm")
    return _frame(names, pose, world_from_stage).apply(point + drift)


def _names(section: JsonSection) -> tuple[str, ...]:
    return next((names for names in (LOCAL, SAMPLE) if names[0] in section.data), WORLD)


def _vector(
    section: JsonSection, key: str, names: tuple[str, ...], unit: str = ""
) -> tuple[Floats, Floats]:
    """Return a vector without its drifts, and the sum of its drifts; NaN for missing components."""
    inner = section.section(key, needed=True)
    inner.may_be_empty(*WORLD, *LOCAL, *SAMPLE)
    drift = np.array([inner.drift(name, unit) for name in names])
    allowed = PLACE if unit else COMPONENT
    values = np.array([inner.needed(name, unit, allowed) for name in names])
    drift = np.where(np.isnan(values), 0.0, drift)  # drifts may be infinite there
    return values - drift, drift


def _basis(section: JsonSection, keys: tuple[str, str], first: Floats, third: Floats) -> Floats:
    lengths = np.linalg.norm(first), np.linalg.norm(third)
    if not np.isfinite(lengths).all():
        return np.eye(3)  # already reported
    both = ", ".join(keys)
    if min(lengths) == 0:
        section.problem(both, "one of them has zero length")
        return np.eye(3)
    first, third = first / lengths[0], third / lengths[1]
    cosine = float(first @ third)
    if abs(cosine) > ORTHOGONAL:
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        section.problem(both, f"must be orthogonal, but their angle is {angle:.4f} deg")
        return np.eye(3)
    first = first - (first @ third) * third
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third], axis=1)
