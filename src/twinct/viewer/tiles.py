"""One picture of the slices of all volumes side by side, with one grey window."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from twinct.viewer.show import RECONSTRUCTION, TRUTH, Show
from twinct.viewer.slices import AXES, Plane
from twinct.viewer.stage import DIFFERENCE, Look, slice_picture

TILE_PX = 250
CAPTION_PX = 20
PAPER, INK = (255, 255, 255), (31, 41, 51)


def slices_beside(shows: Sequence[Show], look: Look) -> NDArray[np.uint8] | None:
    """Return the picture: a row per plane of each run, a column per volume; None if no volumes."""
    rows = []
    for show in shows:
        names = list(show.volumes)
        if RECONSTRUCTION in names and TRUTH in names:
            names.append(DIFFERENCE)
        for axis in (2, 1, 0):
            row = []
            for name in names:
                known = RECONSTRUCTION if name == DIFFERENCE else name
                plane = Plane.of(show.volumes[known].grid, axis, look.slices[axis])
                picture = slice_picture(show, name, plane, look.window)
                words = f"{name}, {AXES[axis]} = {plane.at_mm:.1f} mm"
                if len(shows) > 1:
                    words = f"{show.name}: {words}"
                row.append(_tile(picture, plane.size_mm, words))
            if row:
                rows.append(row)
    if not rows:
        return None
    width = max(len(row) for row in rows) * TILE_PX
    height = TILE_PX + CAPTION_PX
    sheet = np.full((len(rows) * height, width, 3), PAPER, np.uint8)
    for r, row in enumerate(rows):
        for c, tile in enumerate(row):
            sheet[r * height : (r + 1) * height, c * TILE_PX : (c + 1) * TILE_PX] = tile
    return sheet


def _tile(
    picture: NDArray[np.uint8], size_mm: tuple[float, float], words: str
) -> NDArray[np.uint8]:
    """Return a plane with its second axis upwards, scaled to fit, with its name below."""
    scale = (TILE_PX - 6) / max(size_mm)
    width, height = (max(1, round(edge * scale)) for edge in size_mm)
    tile = Image.new("RGB", (TILE_PX, TILE_PX + CAPTION_PX), PAPER)
    scaled = Image.fromarray(np.ascontiguousarray(picture[::-1])).resize((width, height))
    tile.paste(scaled, ((TILE_PX - width) // 2, (TILE_PX - height) // 2))
    draw = ImageDraw.Draw(tile)
    draw.text((TILE_PX / 2, TILE_PX + 2), words, INK, ImageFont.load_default(12), anchor="ma")
    return np.asarray(tile)
