"""Turning, flipping, cutting and binning of images, and of the views to match."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.geometry import ScanGeometry
from twinct.measured.description import Images, Measured
from twinct.measured.stack import Stack
from twinct.measured.views import ImageFacts, StatedViews, cut

Numbers = TypeVar("Numbers", bound=np.generic)


def turned_shape(section: Images, shape: tuple[int, int]) -> tuple[int, int]:
    """Return (rows, columns) of stored images after transposition and turn."""
    exchanged = section.transpose != (section.turn_deg in (90, 270))
    return (shape[1], shape[0]) if exchanged else shape


def turned(section: Images, image: NDArray[Numbers]) -> NDArray[Numbers]:
    """Return an image as the description turns and flips it; what the geometry speaks of."""
    image = image.T if section.transpose else image
    image = np.rot90(image, section.turn_deg // 90)
    image = image[::-1] if section.flip_rows else image
    return image[:, ::-1] if section.flip_columns else image


@dataclass(frozen=True, eq=False)
class PanelPlacement:
    """The way of a turned image to the panel of the scan.

    Attributes:
        section: the section ``images``.
        views: the views that the geometry states, for the whole turned images.
    """

    section: Images
    views: StatedViews

    @property
    def geometry(self) -> ScanGeometry:
        """The views, with the panel that is left by cutting and binning.

        Raises:
            InputError: no pixel is left.
        """
        crop, panel = self.section.crop, self.views.geometry.panel
        if crop.top + crop.bottom >= panel.rows or crop.left + crop.right >= panel.columns:
            raise InputError(
                f"images.crop: nothing is left of {panel.rows} x {panel.columns} pixels (rows x "
                f"columns)"
            )
        rows = crop.top, panel.rows - crop.bottom
        columns = crop.left, panel.columns - crop.right
        # Cutting names pixels of the turned image; those of the panel may run the other way.
        if self.views.flip_rows:
            rows = panel.rows - rows[1], panel.rows - rows[0]
        if self.views.flip_columns:
            columns = panel.columns - columns[1], panel.columns - columns[0]
        part, by = cut(self.views.geometry, rows, columns), self.section.bin
        if by == 1:
            return part
        if by > min(part.panel.shape):
            raise InputError(
                f"images.bin: {by} is more than the {part.panel.rows} x {part.panel.columns} "
                "pixels (rows x columns) of an image"
            )
        return part.binned(by, by)

    def image(self, stored: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return a stored image on the panel of the scan, (rows, columns)."""
        image, by = self._cut(turned(self.section, stored)), self.section.bin
        if by == 1:
            return np.ascontiguousarray(image)
        rows, columns = (n // by for n in image.shape)
        blocks = image[: rows * by, : columns * by].reshape(rows, by, columns, by)
        return blocks.mean(axis=(1, 3))

    def stored(self, panel: NDArray[Numbers]) -> NDArray[Numbers]:
        """Return an image of the whole panel, (rows, columns), as it would be stored."""
        section = self.section
        image = panel[:, ::-1] if self.views.flip_columns != section.flip_columns else panel
        image = image[::-1] if self.views.flip_rows != section.flip_rows else image
        image = np.rot90(image, -section.turn_deg // 90)
        return image.T if section.transpose else image

    def mask(self, stored: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a map of bad pixels on the panel: a block is bad if most of it is."""
        return self.image(stored.astype(np.float64)) > 0.5

    def _cut(self, image: NDArray[Numbers]) -> NDArray[Numbers]:
        crop = self.section.crop
        rows, columns = image.shape
        image = image[crop.top : rows - crop.bottom, crop.left : columns - crop.right]
        image = image[::-1] if self.views.flip_rows else image
        return image[:, ::-1] if self.views.flip_columns else image


def placed(description: Measured, stack: Stack) -> PanelPlacement:
    """Return the way of stored images to the panel that the description states.

    Raises:
        InputError: the geometry cannot be read, or does not fit the images.
    """
    section = description.images
    rows, columns = turned_shape(section, stack.shape)
    as_stored = not (section.transpose or section.turn_deg)
    stated = (stack.spacing, stack.first_pixel) if as_stored else (None, None)
    return PanelPlacement(
        section, description.views(ImageFacts(stack.count, rows, columns, *stated))
    )
