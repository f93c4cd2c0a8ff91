"""Moves of source and panel, and the change of the images that they cause.

A move is stated in coarse pixels: by so many it shifts an image at the border of the panel, about.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from twinct.diagnosis.coarse import Coarse
from twinct.geometry import Floats, ScanGeometry
from twinct.recon.engine import Singles

Move = Callable[[ScanGeometry, float], ScanGeometry]

STEP = 0.5
"""Step of the derivatives, in pixels."""


def shifts(scan: Coarse, move: Move) -> Singles:
    """Return the change of images by a move that shifts and stretches what they show.

    It is the slope of the measured images times the way of the object's middle: no volume is
    needed, which would show a ghost of each edge where poses are wrong.
    """
    views = scan.A.geometry
    moved, share = move(views, STEP), (views.depth(middle_of(views)) / views.sdd)[:, None]
    rows, columns = np.indices(views.panel.shape)
    down, right = scan.slopes
    change = np.empty_like(scan.p)
    for view, (source, part) in enumerate(zip(views.source, share, strict=True)):
        points = source + part * (views.pixel_centres(view) - source)
        to = moved[view].project(points.reshape(-1, 3)).reshape(*rows.shape, 2)
        change[view] = right[view] * (columns - to[..., 0]) + down[view] * (rows - to[..., 1])
    return change


def turns(scan: Coarse, move: Move) -> Singles:
    """Return the change of images by a move that shows the object from other directions."""
    views = scan.A.geometry
    one, other = (scan.A.on(scan.A.grid, move(views, step))(scan.volume) for step in (STEP, -STEP))
    return one - other


def signatures(
    *moves: Move, change: Callable[[Coarse, Move], Singles] = shifts
) -> Callable[[Coarse], Iterator[Singles]]:
    """Return the signatures of a cause with one number for each move."""
    return lambda scan: (change(scan, move) for move in moves)


def angle_of(views: ScanGeometry, pixels: float) -> float:
    """Return the angle by which a turn about the panel's middle moves its border, rad."""
    return 2 * pixels / max(views.panel.shape)


def middle_of(views: ScanGeometry) -> Floats:
    """Return the point that is nearest to the beams of all views, mm."""
    beam = views.detector - views.source
    beam = beam / np.linalg.norm(beam, axis=1, keepdims=True)
    across = np.eye(3) - beam[:, :, None] * beam[:, None, :]
    both = across.sum(axis=0), np.einsum("vij,vj->i", across, views.source)
    return np.asarray(np.linalg.lstsq(*both, rcond=1e-9)[0])


def rotated(vectors: Floats, axes: Floats, angles: float | Floats) -> Floats:
    """Return vectors turned about unit axes, (views, 3) each, by one angle or (views, 1), rad."""
    along = (vectors * axes).sum(axis=1, keepdims=True) * axes
    turned = along + np.cos(angles) * (vectors - along)
    return np.asarray(turned + np.sin(angles) * np.cross(axes, vectors))


def panel_turned(views: ScanGeometry, axes: Floats, angles: float | Floats) -> ScanGeometry:
    """Turn the panel about its middle."""
    return replace(views, u=rotated(views.u, axes, angles), v=rotated(views.v, axes, angles))


def object_turned(views: ScanGeometry, axes: Floats, angles: float | Floats) -> ScanGeometry:
    """Turn source and panel about the middle of the object."""
    middle = middle_of(views)
    source, detector = (
        middle + rotated(points - middle, axes, angles) for points in (views.source, views.detector)
    )
    return panel_turned(replace(views, source=source, detector=detector), axes, angles)


def object_moved(views: ScanGeometry, by: Floats) -> ScanGeometry:
    """Shift source and panel, (views, 3) or (3,), mm."""
    return replace(views, source=views.source + by, detector=views.detector + by)
