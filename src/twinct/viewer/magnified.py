"""Geometries of the same views, with their differences magnified to be visible."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from twinct.geometry import Floats, ScanGeometry


def magnified(reference: ScanGeometry, other: ScanGeometry, factor: float) -> ScanGeometry:
    """Return ``other`` with its differences from a reference multiplied by ``factor``.

    Positions move along straight lines; the panel turns about the axis of its relative rotation.

    Raises:
        ValueError: the numbers of views differ, or so large a factor would show a panel from
            behind.
    """
    if len(reference) != len(other):
        raise ValueError(f"cannot compare {len(reference)} views with {len(other)}")
    if factor == 1.0:
        return other
    source, detector = (
        getattr(reference, name) + factor * (getattr(other, name) - getattr(reference, name))
        for name in ("source", "detector")
    )
    before, after = _axes(reference), _axes(other)
    turn = Rotation.from_rotvec(factor * (before.inv() * after).as_rotvec())
    axes = (before * turn).as_matrix()
    return ScanGeometry(source, detector, axes[:, :, 0], axes[:, :, 1], other.panel)


def _axes(geometry: ScanGeometry) -> Rotation:
    columns = [geometry.u, geometry.v, geometry.normal]
    return Rotation.from_matrix(np.stack(columns, axis=2))


def corners(geometry: ScanGeometry, view: int) -> Floats:
    """Return the corners of the active area, in order around it, (4, 3), mm."""
    width, height = geometry.panel.size_mm
    across, up = geometry.u[view] * width / 2, geometry.v[view] * height / 2
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return np.array([geometry.detector[view] + a * across + b * up for a, b in signs])
