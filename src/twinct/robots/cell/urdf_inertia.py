"""Inertia of a robot description (URDF) that no body can have, repaired link by link."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinct.core.foreign_text import number
from twinct.geometry import Floats

RADIUS_M = 0.01
"""Radius of gyration of a link whose moments say nothing."""

_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def repair_inertia(root: Any) -> tuple[str, ...]:
    """Give each link moments that a body can have, and return notes about those that changed.

    The three moments become equal if one of them is not positive, or exceeds the sum of the two
    others. Inertia without mass is a placeholder, and is removed. What is no number stays, and
    MuJoCo refuses it.
    """
    equal, removed = list[str](), list[str]()
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        mass, moments = inertial.find("mass"), inertial.find("inertia")
        try:
            kg = 0.0 if mass is None else number(mass.get("value", "0"))
            values = [0.0 if moments is None else number(moments.get(m, "0")) for m in _MOMENTS]
        except ValueError:
            continue
        if kg <= 0:
            link.remove(inertial)
            removed.append(link.get("name", ""))
        elif moments is not None and not _can_be(values):
            mean = float(np.mean(values[:3]))
            mean = mean if mean > 0 else kg * RADIUS_M**2
            for name, value in zip(_MOMENTS, [mean] * 3 + [0.0] * 3, strict=True):
                moments.set(name, repr(value))
            equal.append(link.get("name", ""))
    notes = []
    if equal:
        notes.append(f"moments of inertia that no body can have, made equal: {', '.join(equal)}")
    if removed:
        notes.append(f"inertia without mass, left out: {', '.join(removed)}")
    return tuple(notes)


def _can_be(values: list[float]) -> bool:
    """Return True if a body can have the moments: all positive, each at most the others' sum."""
    xx, yy, zz, xy, xz, yz = values
    tensor: Floats = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite(tensor).all():
        return True
    low, middle, high = np.linalg.eigvalsh(tensor)
    return bool(low > 0 and high <= low + middle)
