"""Place of the meshes of a prediction: a mesh outside every view would predict nothing."""

from __future__ import annotations

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Floats, ScanGeometry
from twinct.specimen import BuiltSpecimen


def check_seen(specimen: BuiltSpecimen, views: ScanGeometry) -> None:
    """Refuse a specimen outside every view.

    A part counts as seen where the rectangle about its shadow meets the panel.

    Raises:
        InputError: no view sees a part.
    """
    stands = specimen.world_from_specimen
    parts = [stands.apply(part.mesh.vertices) for part in specimen.parts]
    if any(_sees(one, points) for one in views for points in parts):
        return
    points = np.concatenate(parts)
    place = ", ".join(
        f"{axis} {low:.4g} to {high:.4g} mm"
        for axis, low, high in zip("xyz", points.min(axis=0), points.max(axis=0), strict=True)
    )
    names = ", ".join(part.name for part in specimen.parts)
    raise InputError(
        f"no view sees the mesh {names}, which lies at {place}: place it in the world's mm, where "
        "the scan's object is, by its file or by --set specimen.position_mm=[X,Y,Z]"
    )


def _sees(view: ScanGeometry, points: Floats) -> bool:
    """Return True if the rectangle about the shadow of points (n, 3) meets a view's panel."""
    depth = view.depth(points)
    if (depth <= 0).all() or (depth >= view.sdd[0]).all():
        return False
    if (depth <= 0).any():  # about the source
        return True
    columns, rows = view.project(points)[0].T
    height, width = view.panel.shape
    across = columns.max() >= -0.5 and columns.min() <= width - 0.5
    return bool(across and rows.max() >= -0.5 and rows.min() <= height - 0.5)
