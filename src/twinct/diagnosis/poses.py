"""Wrong poses: in all views alike, more from view to view, or in each view on its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from twinct.diagnosis.cause import Cause
from twinct.diagnosis.coarse import Coarse
from twinct.diagnosis.moves import (
    angle_of,
    middle_of,
    object_moved,
    object_turned,
    panel_turned,
    signatures,
    turns,
)
from twinct.geometry import ScanGeometry
from twinct.recon.engine import Singles


def _right(views: ScanGeometry, pixels: float) -> ScanGeometry:
    return replace(views, detector=views.detector + pixels * views.panel.pitch_u * views.u)


def _up(views: ScanGeometry, pixels: float) -> ScanGeometry:
    return replace(views, detector=views.detector + pixels * views.panel.pitch_v * views.v)


def _rolled(views: ScanGeometry, pixels: float) -> ScanGeometry:
    return panel_turned(views, views.normal, angle_of(views, pixels))


def _tilted(views: ScanGeometry, pixels: float) -> ScanGeometry:
    return panel_turned(views, views.u, _lean_of(views, pixels))


def _slanted(views: ScanGeometry, pixels: float) -> ScanGeometry:
    return panel_turned(views, views.v, _lean_of(views, pixels))


def _lean_of(views: ScanGeometry, pixels: float) -> float:
    """Return the lean that moves the panel's border by some pixels along the rays."""
    slope = max(views.panel.size_mm) / 2 / float(np.median(views.sdd))
    return min(angle_of(views, pixels) / slope, 0.5)


def _axis_leaning(views: ScanGeometry, pixels: float) -> ScanGeometry:
    return object_turned(views, views.u, angle_of(views, pixels))


def _panel_farther(views: ScanGeometry, pixels: float) -> ScanGeometry:
    away = angle_of(views, pixels) * views.sdd[:, None] * views.normal
    return replace(views, detector=views.detector - away)


def _object_farther(views: ScanGeometry, pixels: float) -> ScanGeometry:
    depth = views.depth(middle_of(views))[:, None]
    return object_moved(views, angle_of(views, pixels) * depth * views.normal)


def _turned_farther(views: ScanGeometry, pixels: float) -> ScanGeometry:
    spread = np.linalg.svd(views.source - views.source.mean(axis=0), full_matrices=False)[2]
    course = np.linspace(-1, 1, len(views))[:, None]
    axes = np.broadcast_to(spread[-1], (len(views), 3))
    return object_turned(views, axes, angle_of(views, pixels) * course)


def _leans(scan: Coarse) -> Iterator[Singles]:
    yield from signatures(_tilted, _slanted)(scan)
    yield turns(scan, _axis_leaning)


def _slopes(scan: Coarse) -> Iterator[Singles]:
    yield from scan.slopes


OFFSET = Cause("offset", signatures(_right, _up), geometric=True)
"""Panel beside its stated place, which no scan tells from an axis beside it."""

ROLL = Cause("roll", signatures(_rolled), geometric=True)
"""Panel turned in its plane, or an axis that leans to the side."""

TILT = Cause("tilt", _leans, geometric=True)
"""Panel or axis that leans along the beam."""

DISTANCES = Cause("distances", signatures(_panel_farther, _object_farther), geometric=True)
"""Panel or object at another distance from the source."""

ANGLES = Cause("angles", signatures(_turned_farther, change=turns), geometric=True)
"""A scan that turns by more or less than stated."""

POSES = Cause("poses", _slopes, geometric=True, by_view=True)
"""Views that are each off on their own."""
