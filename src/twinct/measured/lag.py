"""Ghosts: what a detector still shows of the image before, as dark and flat images tell.

An image s of a detector with lag is (1 - a) x + a s', where s' is the image before and x what the
beam would have left (one exponential; Hsieh, Gurmen and King, IEEE Trans. Med. Imaging 19 (2000)
930). In views that change steadily a small a only delays the turn. But dark and flat images do not
change: what the first one has beyond the last ones is the ghost of the view, or the beam, before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.measured.description import FieldImages, Images
from twinct.measured.fields import FieldsByView
from twinct.measured.stack import Stack, open_stack

Floats = NDArray[np.float64]

FEWEST = 3
"""Smallest number of images that tell the first from those after."""

LEAST = 0.001
"""Smallest share that is named: 0.1 % of the image before."""

SURE = 6.0
"""Standard errors, from parts of the image, by which a share is not 0."""

PARTS = 4
"""Parts along each edge of the image."""


class Ghost(NamedTuple):
    """A ghost in the first of some images.

    Attributes:
        where: the entry of darks or flats.
        of: the image that it shows, in words.
        share: part of that image.
    """

    where: str
    of: str
    share: float


def ghosts(
    section: Images, stack: Stack, dark: FieldsByView | None, flat: FieldsByView | None
) -> list[Ghost]:
    """Return the ghost of each entry of dark and flat images that shows one.

    Args:
        section: the section ``images``.
        stack: the views.
        dark: dark images.
        flat: flat images without their dark part.
    """
    found: list[Ghost] = []
    for where, entry in _entries(section):
        if entry.count < FEWEST:
            continue
        first, second = (entry.image(i).astype(np.float64) for i in (0, 1))
        extra = first - entry.image(entry.count - 1)
        # The image before lies on top of what is there: of a flat, only what differs from it.
        level = (first + second) / 2
        before = {f"image {v}": stack.image(v).astype(np.float64) for v in (stack.count - 1, 0)}
        if flat is not None and where.startswith("images.darks"):
            before["the beam"] = flat.images[-1] + (0.0 if dark is None else dark.images[-1])
        seen = [Ghost(where, name, _share(extra, one - level)) for name, one in before.items()]
        best = max(seen, key=lambda ghost: ghost.share)
        if best.share > LEAST:
            found.append(best)
    return found


def sentences(found: Sequence[Ghost], stated: float) -> list[str]:
    """Return one sentence for each ghost."""
    cure = "its first images are better left out"
    if not stated:
        cure += "; images.lag: {share:.2g} takes the ghosts out of the views"
    return [
        f"{ghost.where}: the first image shows {ghost.share:.1%} of {ghost.of}: the detector lags, "
        f"{cure.format(share=ghost.share)}"
        for ghost in found
    ]


def _entries(section: Images) -> Iterator[tuple[str, Stack]]:
    entries: tuple[tuple[str, tuple[FieldImages, ...]], ...] = (
        ("images.darks", section.darks),
        ("images.flats", section.flats),
    )
    for key, fields in entries:
        for index, entry in enumerate(fields):
            yield f"{key}.{index}", open_stack(entry, f"{key}.{index}")


def _share(extra: Floats, before: Floats) -> float:
    """Return how much of an image the extra part holds; 0 if parts of it do not agree on that.

    The means are left out in each part: a drift of the beam or of the readout is no ghost.
    """
    products, squares = np.zeros(PARTS**2), np.zeros(PARTS**2)
    part = 0
    for rows in zip(np.array_split(extra, PARTS), np.array_split(before, PARTS), strict=True):
        strips = (np.array_split(one, PARTS, axis=1) for one in rows)
        for a, b in zip(*strips, strict=True):
            if b.size:
                b = b - b.mean()
                products[part], squares[part] = (a * b).sum(), (b * b).sum()
            part += 1
    if (squares.sum() - squares).min() <= 0:
        return 0.0
    share = products.sum() / squares.sum()
    without = (products.sum() - products) / (squares.sum() - squares)
    error = np.sqrt((len(without) - 1) * np.var(without))
    return float(share) if share > SURE * error else 0.0
