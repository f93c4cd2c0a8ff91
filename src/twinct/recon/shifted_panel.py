"""Weights of a panel that is shifted sideways, so that a full turn sees twice as wide an object.

Rays near the axis are measured twice in a turn, from either side; all others once. Where both sides
see a line, their shares go over into each other as half a wave of a sine (Cho et al., Phys. Med.
Biol. 41 (1996) 1149; Wang, Med. Phys. 29 (2002) 1634), by the angle of the ray in the fan. Filtered
rows reach beyond the panel's near edge: the panel is extended there, by columns of weight zero,
until it is as wide on both sides of the axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Floats, ScanGeometry
from twinct.recon.engine import Singles

CENTRED = 0.05
"""Largest distance of the axis from the panel's middle column without these weights.

It is a share of the panel's width.
"""

LEAST_OVERLAP = 0.01
"""Least distance of the axis from the panel's near edge, as a share of the panel's width."""


@dataclass(frozen=True, eq=False)
class ShiftedPanel:
    """Panel that sees farther on one side of the axis than on the other, in all views.

    Attributes:
        before: number of columns to add before the first.
        after: number of columns to add after the last.
        overlap: fan angle up to which both sides see the object, rad.
        far_side: sign of the fan angle on the side that sees farther.
    """

    before: int
    after: int
    overlap: float
    far_side: float

    def shares(self, fan: Floats) -> Floats:
        """Return the share of each ray among both along its line, (columns,).

        Args:
            fan: fan angle of each column, rad; the shares at g and -g add up to 1.
        """
        at = np.clip(self.far_side * fan / self.overlap, -1, 1)
        return 0.5 + 0.5 * np.sin(math.pi / 2 * at)

    def extended(self, geometry: ScanGeometry) -> ScanGeometry:
        """Return the views with the added columns."""
        panel = geometry.panel
        wider = replace(panel, columns=panel.columns + self.before + self.after)
        by = (self.after - self.before) / 2 * panel.pitch_u
        return replace(geometry, detector=geometry.detector + by * geometry.u, panel=wider)

    def padded(self, image: Singles) -> Singles:
        """Return an image with zeros in the added columns."""
        return np.pad(image, ((0, 0), (self.before, self.after)))


def shifted_panel(geometry: ScanGeometry, centre: Floats, fan: Floats) -> ShiftedPanel | None:
    """Return the shift of a panel, or None if the axis projects near its middle column.

    Args:
        geometry: views of a full turn.
        centre: centre of the circle, (3,), mm.
        fan: fan angle of each column, (views, columns), rad.

    Raises:
        InputError: the panel sees the axis in no column, or too near to its edge.
    """
    panel = geometry.panel
    off = _off_middle(geometry, centre)
    if np.abs(off).max() <= CENTRED * panel.columns:
        return None
    column = off + panel.middle[0]
    edge = np.minimum(column, panel.columns - 1 - column)
    if edge.min() < LEAST_OVERLAP * panel.columns:
        view = int(edge.argmin())
        raise InputError(
            f"fdk: the axis projects to column {column[view]:.1f} of view {view}; a shifted panel "
            f"of {panel.columns} columns must see at least {LEAST_OVERLAP * panel.columns:.3g} "
            "columns on either side of this column"
        )
    missing = math.ceil(float(np.abs(2 * off).max()))
    near_first = bool(off.mean() < 0)
    ends = fan[:, 0 if near_first else -1], fan[:, -1 if near_first else 0]
    return ShiftedPanel(
        missing if near_first else 0,
        0 if near_first else missing,
        float(np.abs(ends[0]).min()),
        float(np.sign(ends[1].mean())),
    )


def require_centred(geometry: ScanGeometry, centre: Floats) -> None:
    """Raise unless the axis projects near the panel's middle column, as an arc needs.

    Raises:
        InputError: the panel is shifted.
    """
    off, columns = np.abs(_off_middle(geometry, centre)), geometry.panel.columns
    if off.max() > CENTRED * columns:
        view = int(off.argmax())
        raise InputError(
            f"fdk needs a full turn where the panel is shifted: the distance of the projected "
            f"centre from the middle column of view {view} is {off[view]:.3g} px; at most "
            f"{CENTRED * columns:.3g} px is allowed in an arc"
        )


def _off_middle(geometry: ScanGeometry, centre: Floats) -> Floats:
    """Return how far right of the panel's middle column the centre projects, (views,), px."""
    return geometry.project(centre)[:, 0, 0] - geometry.panel.middle[0]
