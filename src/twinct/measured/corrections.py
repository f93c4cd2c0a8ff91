"""Corrections of stored images: dark and flat fields, drift of the intensity, bad pixels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.images import read_image
from twinct.measured.air import Brighter, found_air, level_of
from twinct.measured.bad_pixels import filled, unlike
from twinct.measured.beam import FreeBeam
from twinct.measured.description import Air, Images, Rings
from twinct.measured.fields import FieldsByView, fields_of
from twinct.measured.lag import Ghost, ghosts
from twinct.measured.lines import AirOfLines, seams
from twinct.measured.noise import DarkNoise, noise_of_dark
from twinct.measured.pixels import Doubtful, Levels, ThreeViews, levels_of, singles, starved
from twinct.measured.rings import MeanView
from twinct.measured.stack import Stack

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

DEAD = 0.05
"""Largest share of the pixels of a flat image that may be no brighter than the dark image."""

MOST_FOR_MEAN = 24
"""Largest number of views in the mean image in which bad pixels are found."""

MOST_FOR_NOISE = 6
"""Largest number of views in which the noise is measured, each with its neighbours."""

OPAQUE = 0.2
"""Largest share of the pixels of transmissions that may be 0 or below."""

LIMITS = {
    "transmissions": (5.0, "a transmission is at most about 1"),
    "line_integrals": (50.0, "a line integral is at most about 15"),
}
"""Largest median of the images' maxima, and what to say above it."""


class Corrected(NamedTuple):
    """A view as a transmission.

    Attributes:
        image: transmission, (rows, columns).
        scale: brightness of its air, by which it was divided; 1 without a region of air.
        doubtful: pixels that were repaired.
        saturated: pixels that hold the largest number of their type.
        stored: the image as stored.
    """

    image: Floats
    scale: float
    doubtful: Doubtful
    saturated: Bools
    stored: NDArray[Any]


@dataclass(frozen=True, eq=False)
class Corrections:
    """Everything that turns a stored image into a transmission: it decides what a pixel is worth.

    Attributes:
        section: the section ``images``.
        stack: the stored images.
        dark: dark images; None: nothing is subtracted.
        flat: flat images without their dark part; None: nothing is divided by.
        bad: bad pixels of the stored images, (rows, columns).
        beam: the free beam of the stated geometry.
        falls: True if images are divided by the free beam.
        lacks_fall: True if air falls off with the free beam although it should not.
        brighter: pixels brighter than air, in some view; None: there are none.
        seams: rows and columns at which tiles of the panel begin, and the steps there.
        ghosts: ghosts in the first dark and flat images.
        air: pixels that show air in all views, (rows, columns); None: unknown.
        noise: noise of the dark image.
        levels: noise by brightness; None: single pixels are left as they are.
        gains: factors by which single pixels are too bright, (rows, columns); None: no rings are
            removed.
    """

    section: Images
    stack: Stack
    dark: FieldsByView | None
    flat: FieldsByView | None
    bad: Bools
    beam: FreeBeam
    falls: bool = False
    lacks_fall: bool = False
    brighter: Brighter | None = None
    seams: dict[str, tuple[tuple[int, float], ...]] = field(default_factory=dict)
    air: Bools | None = None
    ghosts: tuple[Ghost, ...] = ()
    noise: DarkNoise = DarkNoise(0.0, "unknown")
    levels: Levels | None = None
    gains: Floats | None = None
    _lines: dict[str, AirOfLines] = field(default_factory=dict)
    _near: dict[int, tuple[Floats, NDArray[Any]]] = field(default_factory=dict)

    def transmission(self, view: int) -> Corrected:
        """Return the transmission of a stored image.

        Raises:
            InputError: good pixels are not finite, or the air is not brighter than the dark image.
        """
        image, stored = self._read(view)
        bright = dark = np.zeros(image.shape, np.bool_)
        if self.levels is not None and (three := self._three(view)) is not None:
            bright, dark = singles(three, self.levels)
        left_out = self.bad | bright | dark
        image, low, means = starved(filled(image, left_out), self.noise.sigma)
        image = image / self.beam.image(view) if self.falls else image
        scale = 1.0
        if self.scaled:
            scale = self._air(image, left_out, view)
            image = image / scale
        if self.section.lines is not None:
            image = self.lines(self.section.lines.along).evened(image, self.section.lines.kind)
        image = image if self.gains is None else image / self.gains
        return Corrected(
            image, scale, Doubtful(bright, dark, low, means), stored == self.largest, stored
        )

    @cached_property
    def brightness(self) -> float:
        """Median brightness of air, relative to the flats; 1 unless each view is scaled."""
        few = _some(self.stack.count, MOST_FOR_NOISE) if self.scaled else []
        return float(np.median([self.transmission(view).scale for view in few] or [1.0]))

    def dark_of(self, view: int) -> Floats | float:
        """Return the dark image of a view, as stored, (rows, columns); 0 without any."""
        return 0.0 if self.dark is None else self.dark.image(view)

    def lines(self, along: str) -> AirOfLines:
        """Return the air of rows or columns; it must be known."""
        assert self.air is not None
        if along not in self._lines:
            self._lines[along] = AirOfLines(self.air & ~self.bad, along)
        return self._lines[along]

    @property
    def scaled(self) -> bool:
        """True if the air of each view is scaled to 1."""
        return self.section.air not in (None, "fall_off")

    @property
    def least_beam(self) -> float:
        """Brightness of the free beam in its darkest pixel, relative to the brightest."""
        return float(self.beam.image(0).min())

    @cached_property
    def largest(self) -> float:
        """The largest number that a pixel can hold; infinite for numbers with fractions."""
        whole = np.issubdtype(self.stack.dtype, np.integer)
        return float(np.iinfo(self.stack.dtype).max) if whole else np.inf

    def _read(self, view: int) -> tuple[Floats, NDArray[Any]]:
        """Return an image without bad pixels, and as stored; keep the last."""
        if view not in self._near:
            stored = self.stack.image(view)
            image = self._uncorrected(view, stored)
            wrong = ~np.isfinite(image) & ~self.bad
            if wrong.any():
                row, column = np.argwhere(wrong)[0]
                raise InputError(
                    f"{self.stack.where}: image {view}: {int(wrong.sum())} pixels are not finite, "
                    f"the first at row {row}, column {column}: name them in images.bad_pixels"
                )
            image[self.bad] = 0.0  # filled later; NaN would spread
            if self.section.values != "line_integrals" and not (image > 0).any():
                least = "the dark images" if self.dark is not None else "0"
                raise InputError(
                    f"{self.stack.where}: image {view}: no pixel is brighter than {least}: was "
                    "the beam off? Leave this view out, or correct images.darks"
                )
            while len(self._near) > 2:
                del self._near[next(iter(self._near))]
            self._near[view] = image, stored
        return self._near[view]

    def _three(self, view: int) -> ThreeViews | None:
        """Return a view between its neighbours, bad pixels filled; None if it has none."""
        last = self.stack.count - 1
        if last < 1:
            return None
        before, after = (view - 1 if view else 1), (view + 1 if view < last else last - 1)
        here, *near = (filled(self._read(v)[0], self.bad) for v in (view, before, after))
        return ThreeViews(near[0], here, near[1])

    def _uncorrected(self, view: int, stored: NDArray[Any] | None = None) -> Floats:
        stored = self.stack.image(view) if stored is None else stored
        image = stored.astype(np.float64)
        if self.section.values == "line_integrals":
            return np.exp(-image, out=image)
        if self.section.lag and view:
            # Both images hold the dark image, which has no lag.
            before = self.stack.image(view - 1).astype(np.float64)
            share = self.section.lag / (1 - self.section.lag)
            image += share * (image - before)
        if self.dark is not None:
            image -= self.dark.image(view)
        if self.flat is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                image /= self.flat.image(view)
        elif self.section.white is not None:
            image /= self.section.white - float(np.mean(self.dark_of(view)))
        return image

    def _air(self, image: Floats, left_out: Bools, view: int) -> float:
        assert self.air is not None
        good = image[self.air & ~left_out]
        level = level_of(good)[0] if self.section.air == "auto" and good.size else None
        scale = level if level is not None else float(good.mean()) if good.size else 0.0
        if not scale > 0:
            raise InputError(
                f"{self.stack.where}: image {view}: images.air has {good.size} good pixels, of "
                f"mean {scale:.4g}; it must be above 0"
            )
        return scale


def corrections(section: Images, stack: Stack, beam: FreeBeam) -> Corrections:
    """Open the fields and bad pixels that correct the images of a section.

    Args:
        section: the section ``images``.
        stack: its images.
        beam: the free beam of the stated geometry.

    Raises:
        InputError: fields or map are missing, unreadable, of other sizes, saturated or
            dark.
    """
    dark = fields_of(section.darks, "images.darks", stack)
    if section.black is not None:
        dark = FieldsByView((0.0,), (np.full(stack.shape, section.black),))
    flat = fields_of(section.flats, "images.flats", stack, bright=True)
    bad = np.zeros(stack.shape, np.bool_)
    if flat is not None:
        if dark is not None:
            less = (
                image - dark.image(int(at)) for at, image in zip(flat.at, flat.images, strict=True)
            )
            flat = FieldsByView(flat.at, tuple(less))
        for image in flat.images:
            bad |= ~(image > 0)
        if (share := bad.mean()) > DEAD:
            raise InputError(
                f"images.flats: {share:.1%} of the pixels are no brighter than "
                f"{'the dark images' if dark else '0'}; at most {DEAD:.0%} are allowed"
            )
    if isinstance(section.air, Air):
        _check_air(section.air, stack)
    if section.bad_pixels.path is not None:
        bad |= read_image(Path(section.bad_pixels.path), "bad pixels", stack.shape) != 0
    result = Corrections(section, stack, dark, flat, bad, beam)
    _check_values(result)
    if section.bad_pixels.find:
        bad |= unlike(_mean_image(result), bad)
    if bad.all():
        raise InputError("images.bad_pixels: no pixel is good")
    result = _with_levels(result)
    return result if section.rings is None else replace(result, gains=_gains(result, section.rings))


def _with_levels(corrected: Corrections) -> Corrections:
    """Return corrections that know air and noise, as some views show them."""
    section, count = corrected.section, corrected.stack.count
    few = _some(count, MOST_FOR_NOISE)
    threes = [three for view in few if (three := corrected._three(view)) is not None]
    images = [filled(corrected._read(view)[0], corrected.bad) for view in few]
    bright = float(np.median([_bright(image) for image in images]))
    noise = noise_of_dark(section, corrected.stack.dtype, _unit(corrected), images, bright)
    levels = levels_of(threes, noise.sigma) if threes else None
    many = _some(count, MOST_FOR_MEAN)
    views = [filled(corrected._read(view)[0], corrected.bad) for view in many]
    beams = [corrected.beam.image(view) for view in many]
    found = found_air(views, beams, True if section.air == "fall_off" else None)
    air, shows_fall, brighter = found.pixels, found.falls, found.brighter
    falls = section.air == "fall_off" or (section.air == "auto" and shows_fall)
    if isinstance(section.air, Air):
        falls = section.air.fall_off
        air = np.zeros(corrected.stack.shape, np.bool_)
        air[slice(*section.air.rows), slice(*section.air.columns)] = True
    elif air is None and (section.air == "auto" or section.lines is not None):
        key = "air: auto" if section.air == "auto" else "lines"
        raise InputError(
            f"{corrected.stack.where}: images.{key}, but no part of the panel is bright "
            "and steady in all views: state its rows and columns, or flats of these views"
        )
    return replace(
        corrected,
        falls=falls,
        lacks_fall=shows_fall and not falls,
        brighter=brighter and brighter._replace(view=many[brighter.view]),
        seams={name: seams(found.mean, found.steady, name) for name in ("rows", "columns")},
        air=air,
        ghosts=tuple(ghosts(section, corrected.stack, corrected.dark, corrected.flat)),
        noise=noise,
        levels=levels if section.single_pixels else None,
    )


def _some(count: int, most: int) -> list[int]:
    """Return views, spread over a scan."""
    return [int(v) for v in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


def _unit(corrected: Corrections) -> float:
    """Return the transmission, before any scale of air, that a stored number of 1 is."""
    if corrected.flat is not None:
        return 1.0 / float(np.median(corrected.flat.images[0]))
    if corrected.section.white is not None:
        return 1.0 / (corrected.section.white - float(np.mean(corrected.dark_of(0))))
    return 1.0


def _gains(corrected: Corrections, rings: Rings) -> Floats:
    mean = MeanView()
    for view in range(0, corrected.stack.count, corrected.section.every):
        mean.add(corrected.transmission(view).image)
    return mean.gains(corrected.section, rings)


def _check_air(air: Air, stack: Stack) -> None:
    for name, (first, last), most in (
        ("rows", air.rows, stack.shape[0]),
        ("columns", air.columns, stack.shape[1]),
    ):
        if not first < last <= most:
            raise InputError(
                f"images.air.{name}: {first} to {last} is no part of the {most} {name} of an image"
            )


def _check_values(corrected: Corrections) -> None:
    """Raise if the numbers cannot be what the description states."""
    values, stack = corrected.section.values, corrected.stack
    few = np.unique(np.linspace(0, stack.count - 1, 5).round().astype(int))
    highest = float(np.median([_bright(stack.image(int(v))) for v in few]))
    if values in LIMITS and highest > LIMITS[values][0]:
        most, why = LIMITS[values]
        raise InputError(
            f"{stack.where}: images.values: {values}, but numbers reach {highest:.4g}, and {why}: "
            "are they intensities?"
        )
    if values == "transmissions":
        shares = [np.mean(stack.image(int(v)) <= 0) for v in few]
        if (share := float(np.median(shares))) > OPAQUE:
            raise InputError(
                f"{stack.where}: images.values: transmissions, but {share:.0%} of the pixels are 0 "
                f"or below; at most {OPAQUE:.0%} are allowed: are they line integrals?"
            )
    field = "images.flats" if corrected.flat is not None else "images.white"
    if values == "intensities" and (
        corrected.flat is not None or corrected.section.white is not None
    ):
        lit = float(np.median([_bright(corrected._uncorrected(int(v))) for v in few]))
        if not 0.05 < lit < LIMITS["transmissions"][0]:
            raise InputError(
                f"{stack.where}: divided by {field}, numbers reach {lit:.4g}; the brightest parts "
                f"must be near 1: does {field} belong to these images?"
            )


def _bright(image: NDArray[Any]) -> float:
    """Return the 99.5th percentile of the finite pixels of an image; 0 without any."""
    finite = image[np.isfinite(image)]
    return float(np.percentile(finite, 99.5)) if finite.size else 0.0


def _mean_image(corrected: Corrections) -> Floats:
    """Return the image in which bad pixels are found: flat, else the mean of some views."""
    if corrected.flat is not None:
        return corrected.flat.images[0]
    count = corrected.stack.count
    few = np.unique(np.linspace(0, count - 1, min(count, MOST_FOR_MEAN)).round().astype(int))
    return np.mean([corrected._uncorrected(int(view)) for view in few], axis=0)
