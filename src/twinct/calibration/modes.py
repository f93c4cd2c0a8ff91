"""Seven modes that no image shows: a rigid motion of the whole scene, and its scale.

As the pixel pitch is known, the scale is one of object and source: if both are s times as far from
a point and the panel moves with the source, at the same SDD, every image is unchanged and the
attenuation 1/s times as large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twinct.geometry import Floats, Pose, ScanGeometry

_TYPICAL = np.array([1.0] * 3 + [0.01] * 3 + [0.003])
"""Sizes of a shift (mm), a turn (rad) and a scale with about the same effect on an image."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """A geometry moved as a whole onto a reference.

    Attributes:
        geometry: the moved geometry.
        motion: applied rigid motion, in the world.
        scale: scale applied to the positions of source and object.
        before_px: root mean square distance of the projected points before the motion, over both
            image axes.
        after_px: the corresponding distance after the motion: the visible difference.
    """

    geometry: ScanGeometry
    motion: Pose
    scale: float
    before_px: float
    after_px: float


def aligned(geometry: ScanGeometry, reference: ScanGeometry, points: ArrayLike) -> Aligned:
    """Move a geometry as a whole until points project to their places in a reference.

    Least squares over rigid motion and scale. The remaining distance is the true difference of the
    two geometries. Before figures of merit of volumes are compared, each geometry is moved this
    way; a volume is never resampled.

    Args:
        geometry: the geometry to move.
        reference: geometry of the same views, such as the executed one.
        points: points in the region of interest, at least four not in one plane, (n, 3), mm.
    """
    points = np.asarray(points, dtype=np.float64)
    middle = points.mean(axis=0)
    target = reference.project(points)

    def off(seven: Floats) -> Floats:
        moved = _moved(geometry, seven * _TYPICAL, middle)
        return (moved.project(points) - target).ravel()

    fit = scipy.optimize.least_squares(off, np.zeros(7), method="lm")
    seven = fit.x * _TYPICAL
    count = target[..., 0].size
    before, after = (float(np.sqrt((off(at) ** 2).sum() / count)) for at in (np.zeros(7), fit.x))
    motion = _about(middle, seven[:6])
    return Aligned(_moved(geometry, seven, middle), motion, float(1 + seven[6]), before, after)


def _moved(geometry: ScanGeometry, seven: Floats, middle: Floats) -> ScanGeometry:
    further = seven[6] * (geometry.source - middle)
    scaled = ScanGeometry(
        geometry.source + further,
        geometry.detector + further,
        geometry.u,
        geometry.v,
        geometry.panel,
    )
    return _about(middle, seven[:6]) @ scaled


def _about(middle: Floats, twist: Floats) -> Pose:
    at = Pose(middle, Pose.identity().quat)
    return at @ Pose.exp(twist) @ at.inverse()
