"""Line profiles through an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, Panel

Along = Literal["columns", "rows"]
Quantity = Literal["line integral", "transmission"]
QUANTITIES: tuple[Quantity, ...] = ("line integral", "transmission")


@dataclass(frozen=True, eq=False)
class Profile:
    """Values along a line of pixels.

    Attributes:
        place_mm: place on the panel from its centre, along u or v, (pixels,).
        values: transmission or line integrals, (pixels,).
        index: row, or column, of the line.
    """

    place_mm: Floats
    values: Floats
    index: int


def profile_of(
    transmission: NDArray[np.float32],
    panel: Panel,
    along: Along,
    at_mm: float,
    quantity: Quantity,
) -> Profile:
    """Return the profile of an image through a point.

    Args:
        transmission: the image, (rows, columns), which may have fewer pixels than the panel.
        panel: the panel, of which the image shows all.
        along: ``columns``: along u, through one row; ``rows``: along v, through one column.
        at_mm: place of the line from the panel's centre, along v or u; the nearest pixels count.
        quantity: transmission, or its negative logarithm.
    """
    rows, columns = transmission.shape
    width, height = panel.size_mm
    pitch_u, pitch_v = width / columns, height / rows
    if along == "columns":
        index = _nearest(at_mm / pitch_v, rows)
        line, pitch = transmission[index], pitch_u
    else:
        index = _nearest(at_mm / pitch_u, columns)
        line, pitch = transmission[:, index], pitch_v
    values = np.asarray(line, dtype=float)
    if quantity == "line integral":
        values = -np.log(np.maximum(values, np.finfo(np.float32).tiny))
    place = (np.arange(len(values)) - (len(values) - 1) / 2) * pitch
    return Profile(place, values, index)


def _nearest(steps: float, count: int) -> int:
    return int(np.clip(np.rint(steps + (count - 1) / 2), 0, count - 1))
