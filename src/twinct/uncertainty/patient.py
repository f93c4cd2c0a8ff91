"""Patient motion: a slow nod, and a single jerk."""

from __future__ import annotations

import numpy as np

from twinct.core.draws import scan_rng
from twinct.geometry import Floats, Pose
from twinct.uncertainty.sections import PatientMotion

JERK_S = 0.2


def directions(seed: int, draws: int = 1) -> Floats:
    """Draw unit vectors: direction and axis of the nod, then of the jerk, (draws, 4, 3)."""
    result = scan_rng(seed, "patient").normal(size=(draws, 4, 3))
    return result / np.linalg.norm(result, axis=-1, keepdims=True)


def amplitudes(section: PatientMotion, time_s: Floats) -> Floats:
    """Return shift and rotation of the nod, then of the jerk, (times, 4), mm and rad."""
    nod = (1 - np.cos(2 * np.pi * time_s / section.nod_period_s)) / 2
    share = np.clip((time_s - section.jerk_at_s) / JERK_S, 0, 1)
    jerk = share**2 * (3 - 2 * share)
    sizes = (
        section.nod_mm,
        np.radians(section.nod_deg),
        section.jerk_mm,
        np.radians(section.jerk_deg),
    )
    return np.stack([nod, nod, jerk, jerk], axis=1) * sizes


def patient_twists(section: PatientMotion, towards: Floats, time_s: Floats) -> Floats:
    """Return the motion since the scan began as twists (v, w) of the pivot's frame, mm and rad.

    Args:
        section: size of the motion.
        towards: unit vectors from ``directions``, (draws, 4, 3).
        time_s: (times,).

    Returns:
        (draws, times, 6), in world axes.
    """
    parts = amplitudes(section, time_s)[..., None] * towards[:, None]
    way, turn = parts[:, :, 0] + parts[:, :, 2], parts[:, :, 1] + parts[:, :, 3]
    return np.concatenate([way, turn], axis=-1)


def world_from_moved(section: PatientMotion, seed: int, time_s: float) -> Pose:
    """Return the transform of specimen points from the start of the scan to the present."""
    twist = patient_twists(section, directions(seed), np.array([time_s]))[0, 0]
    pivot = Pose(np.array(section.pivot_mm), Pose.identity().quat)
    return pivot @ Pose.exp(twist) @ pivot.inverse()
