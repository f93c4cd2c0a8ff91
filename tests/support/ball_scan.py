"""A small circular scan of a ball off the axis, as exact line integrals."""

from __future__ import annotations

import numpy as np

from twinct.geometry import Panel, ScanGeometry

SOD, SDD, PITCH = 200.0, 300.0, 2.0
VIEWS, ROWS, COLUMNS = 24, 20, 26
BALL = np.array([12.0, 5.0, -6.0])
RADIUS = 5.0
MU = 0.04


def orbit(views: int = VIEWS, turn: float = 360.0) -> ScanGeometry:
    """A circle counterclockwise from +x, u to the right and v up as seen from the source."""
    angle = np.radians(np.arange(views) * turn / views)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(views)], axis=1)
    right = np.stack([-np.sin(angle), np.cos(angle), np.zeros(views)], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (views, 1))
    return ScanGeometry(SOD * out, (SOD - SDD) * out, right, up, Panel(ROWS, COLUMNS, PITCH, PITCH))


def ball_images(geometry: ScanGeometry) -> np.ndarray:
    """Exact line integrals of the ball, (views, rows, columns)."""
    images = []
    for view in range(len(geometry)):
        ray = geometry.pixel_centres(view) - geometry.source[view]
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        off = geometry.source[view] - BALL
        along = ray @ off
        images.append(2 * np.sqrt(np.maximum(along**2 - off @ off + RADIUS**2, 0)))
    return MU * np.array(images)
