"""Dark and flat images, as means that may change over the scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.measured.description import FieldImages
from twinct.measured.stack import Stack, open_stack

Floats = NDArray[np.float64]

SATURATED = 0.001
"""Largest share of the pixels of a flat image at the largest number of its bits."""

BITS = 8, 10, 12, 14, 16
"""Bits of the numbers of detectors, which may be stored in wider types."""


@dataclass(frozen=True)
class FieldsByView:
    """Dark and bright images by view; one image if they do not change."""

    at: tuple[float, ...]
    images: tuple[Floats, ...]

    def image(self, view: int) -> Floats:
        """Return the image of a view, interpolated between two of the measured ones."""
        after = int(np.searchsorted(self.at, view))
        if len(self.at) == 1 or after == 0:
            return self.images[0]
        if after == len(self.at):
            return self.images[-1]
        share = (view - self.at[after - 1]) / (self.at[after] - self.at[after - 1])
        return (1 - share) * self.images[after - 1] + share * self.images[after]


def fields_of(
    sections: tuple[FieldImages, ...], key: str, like: Stack, *, bright: bool = False
) -> FieldsByView | None:
    """Return the mean image of each section, by the views at which they were taken.

    Args:
        sections: the sections.
        key: their dotted name, for messages.
        like: the projections.
        bright: whether they must not be saturated.

    Raises:
        InputError: they are missing, unreadable, of another size, saturated, or taken at views that
            do not exist.
    """
    fields: list[tuple[float, Floats]] = []
    for index, section in enumerate(sections):
        stack = open_stack(section, f"{key}.{index}")
        if stack.shape != like.shape:
            raise InputError(
                f"{key}.{index}: {stack.where}: images of {stack.shape[0]} x {stack.shape[1]} "
                f"pixels, but the projections have {like.shape[0]} x {like.shape[1]}"
            )
        if bright:
            _refuse_saturated(stack, f"{key}.{index}")
        images = (stack.image(i).astype(np.float64) for i in range(stack.count))
        mean = next(images)
        for image in images:
            mean += image
        if not -1 <= (at := section.view or 0.0) <= like.count:
            raise InputError(
                f"{key}.{index}.view: {at:g} is none of the views 0 to {like.count - 1}"
            )
        fields.append((at, mean / stack.count))
    if not fields:
        return None
    fields.sort(key=lambda one: one[0])
    if len({at for at, _ in fields}) < len(fields):
        raise InputError(f"{key}: two of them have the same view")
    return FieldsByView(tuple(at for at, _ in fields), tuple(image for _, image in fields))


def _refuse_saturated(stack: Stack, key: str) -> None:
    tops = {2**bits - 1: f"{bits} bits" for bits in BITS}
    if np.issubdtype(stack.dtype, np.integer):
        tops[np.iinfo(stack.dtype).max] = f"{stack.dtype}"
    for index in range(stack.count):
        image = stack.image(index)
        most = float(np.nanmax(image, initial=0))
        share = float((image == most).mean())
        if most in tops and share > SATURATED:
            raise InputError(
                f"{key}: {stack.where}: image {index} is saturated: {share:.1%} of its pixels are "
                f"{most:.0f}, the largest number of {tops[int(most)]}; at most {SATURATED:.1%} are "
                "allowed"
            )
