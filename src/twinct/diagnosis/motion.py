"""Motion of the object during the scan: shifts along the world's axes, smooth over the views."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from twinct.diagnosis.cause import Cause
from twinct.diagnosis.coarse import Coarse
from twinct.diagnosis.moves import middle_of, object_moved, shifts
from twinct.geometry import Floats, ScanGeometry
from twinct.recon.engine import Singles

WAVES = 5
"""Number of cosines over the scan that make up the course of a motion."""


def _moving(scan: Coarse) -> Iterator[Singles]:
    views = scan.A.geometry
    time = (np.arange(len(views)) + 0.5) / len(views)
    waves = [np.cos(np.pi * k * time).astype(np.float32) for k in range(1, WAVES + 1)]
    for axis in np.eye(3):
        image = shifts(scan, partial(_along, axis))
        yield from (image * wave[:, None, None] for wave in waves)


def _along(axis: Floats, views: ScanGeometry, pixels: float) -> ScanGeometry:
    share = float(np.median(views.depth(middle_of(views)) / views.sdd))
    return object_moved(views, pixels * views.panel.pitch_u * share * axis)


MOTION = Cause("motion", _moving, geometric=True)
