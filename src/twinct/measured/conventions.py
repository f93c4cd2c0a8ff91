"""Conventions of a measured scan, tried: each candidate is reconstructed coarsely and ranked.

A candidate is judged by views that did not take part: every other view is reconstructed by SART,
and the others are predicted. Two candidates of which one only mirrors the volume predict equally
well, and rank as one class: a marker on the object decides between them. A common scale of all
lengths changes no projection, and cannot be found.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.pictures import show
from twinct.diagnosis.left_out import left_out
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.measured.beam import FreeBeam
from twinct.measured.circle import Circle
from twinct.measured.corrections import Corrections, corrections
from twinct.measured.description import Measured
from twinct.measured.orientation import PanelPlacement, placed, turned_shape
from twinct.measured.stack import open_stack
from twinct.measured.views import ImageFacts, StatedViews
from twinct.observers import Observers, audience_of
from twinct.recon import Projector
from twinct.recon.field_of_view import grid_of
from twinct.scan import line_integrals

MOST_VIEWS = 80
"""Largest number of views of a candidate, half of them reconstructed."""

MOST_PIXELS = 64
"""Largest number of coarse pixels along an axis."""

FEWEST_VIEWS = 6
"""Smallest number of views of which half can be predicted by the others."""

SAME = 0.002
"""Largest relative difference of residuals within a class."""

MOST_SHOWN = 8

TITLE_WIDTH = 36
"""Most characters of a line above one of four pictures abreast."""

SCALE = (
    "a common scale of all lengths changes no projection: distances and pitch cannot be found "
    "by trying"
)
MIRROR = (
    "candidates of one class differ by a mirrored or moved volume only: a marker on the object "
    "decides"
)


class Candidate(NamedTuple):
    """Changes to the stated conventions.

    Attributes:
        reversed_order: the object turns the other way.
        rows: rows run the other way.
        columns: columns run the other way.
        transposed: rows and columns are exchanged.
        offset_sign: offsets have the other sign.
        offset_px: offsets are pixels, not mm.
        views_rows: views and rows are exchanged among the axes of an array.
        views_columns: views and columns are.
    """

    reversed_order: bool = False
    rows: bool = False
    columns: bool = False
    transposed: bool = False
    offset_sign: bool = False
    offset_px: bool = False
    views_rows: bool = False
    views_columns: bool = False

    @property
    def in_words(self) -> str:
        """The changes in words."""
        words = {
            "rotation reversed": self.reversed_order,
            "rows flipped": self.rows,
            "columns flipped": self.columns,
            "transposed": self.transposed,
            "offsets of the other sign": self.offset_sign,
            "offsets in pixels": self.offset_px,
            "axes of views and rows exchanged": self.views_rows,
            "axes of views and columns exchanged": self.views_columns,
        }
        return ", ".join(name for name, on in words.items() if on) or "as stated"


@dataclass(frozen=True, eq=False)
class Tried:
    """A candidate that was reconstructed.

    Attributes:
        candidate: its changes.
        residual_rel: root mean square of p - A x over the views that were not reconstructed,
            relative to that of p.
        plane: middle plane of its coarse volume, (y, x), 1/mm.
    """

    candidate: Candidate
    residual_rel: float
    plane: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Ranking:
    """Candidates by classes of equal residuals, the best class first."""

    classes: tuple[tuple[Tried, ...], ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence for each class, and what cannot be found."""
        lines = [
            f"{rank}. {100 * one[0].residual_rel:.2f} %: "
            + "; or ".join(tried.candidate.in_words for tried in one)
            for rank, one in enumerate(self.classes[:MOST_SHOWN], start=1)
        ]
        if len(self.classes) > MOST_SHOWN:
            lines.append(f"and {len(self.classes) - MOST_SHOWN} worse classes")
        return (*lines, *([MIRROR] if len(self.classes[0]) > 1 else []), SCALE)

    def show(self, path: Path) -> None:
        """Draw the middle planes of the best classes side by side."""
        best = [one[0] for one in self.classes[:MOST_SHOWN]]
        show(partial(_draw, best), (10.4, 3.3 * -(-len(best) // 4)), path)


def try_conventions(description: Measured, observers: Observers = ()) -> Ranking:
    """Reconstruct a measured scan coarsely with each candidate of its conventions, and rank them.

    Args:
        description: description of the scan.
        observers: notified of the candidates.

    Raises:
        InputError: images or geometry cannot be read, or there are too few views.
    """
    orders = list(_orders(description))
    tried: list[Tried] = []
    with audience_of(observers) as audience:
        with audience.stage("conventions", sum(len(order.candidates) for order in orders)) as step:
            for order in orders:
                stored = order.read()
                for candidate in order.candidates:
                    try:
                        tried.append(_tried(description, candidate, order, stored))
                    except InputError:  # no scanner has this geometry: its grid meets the source
                        if not any(candidate):
                            raise
                    step()
    tried.sort(key=lambda one: one.residual_rel)
    return Ranking(tuple(_classes(tried)))


@dataclass(frozen=True, eq=False)
class _Order:
    """Images of a scan with one order of the axes, and the candidates that have it."""

    images: Corrections
    candidates: tuple[Candidate, ...]

    @property
    def views(self) -> NDArray[np.intp]:
        """The views that are used."""
        count = self.images.stack.count
        return np.unique(np.linspace(0, count - 1, min(count, MOST_VIEWS)).round().astype(int))

    def read(self) -> list[NDArray[np.float32]]:
        """Return the transmissions of these views."""
        return [self.images.transmission(int(v)).image.astype(np.float32) for v in self.views]

    def facts(self, shape: tuple[int, int]) -> ImageFacts:
        """Return the facts on images that are turned to (rows, columns)."""
        stack = self.images.stack
        return ImageFacts(stack.count, *shape, stack.spacing, stack.first_pixel)


def _orders(told: Measured) -> Iterator[_Order]:
    """Yield the stated order of axes, then those that fit the geometry, too.

    Raises:
        InputError: the images cannot be read as stated, or there are too few views.
    """
    for exchange in (Candidate(), Candidate(views_rows=True), Candidate(views_columns=True)):
        try:
            section = changed(told, exchange).images
            stack = open_stack(section, "images")
            if stack.count < FEWEST_VIEWS:
                raise InputError(
                    f"--try: {stack.count} views are too few; at least {FEWEST_VIEWS} are needed"
                )
            beam = FreeBeam(placed(changed(told, exchange), stack))
            images = corrections(section, stack, beam)
            order = _Order(images, tuple(_candidates(told, images.stack.shape, exchange)))
        except InputError:
            if any(exchange):
                continue  # no reading of these images
            raise
        yield order
        if not images.stack.exchangeable:
            return


def _classes(tried: list[Tried]) -> Iterator[tuple[Tried, ...]]:
    """Yield candidates with the residual of the first of their class, the simplest first."""
    while tried:
        limit = tried[0].residual_rel * (1 + SAME)
        alike = [one for one in tried if one.residual_rel <= limit]
        yield tuple(sorted(alike, key=lambda one: sum(one.candidate)))
        tried = tried[len(alike) :]


def _candidates(
    description: Measured, shape: tuple[int, int], exchange: Candidate
) -> Iterator[Candidate]:
    """Yield all combinations that the description leaves open, with an exchange of axes."""
    geometry, both = description.geometry, (False, True)
    circle = isinstance(geometry, Circle)
    offsets = circle and bool(np.any([*geometry.panel_offset_mm, geometry.axis_offset_mm]))
    other_shape = circle or shape[0] == shape[1]
    cropped = any(description.images.crop.model_dump().values())
    yield from itertools.starmap(
        Candidate,
        itertools.product(
            *(both, both, both),
            both if other_shape and not cropped else (False,),
            both if offsets else (False,),
            both if offsets else (False,),
            (exchange.views_rows,),
            (exchange.views_columns,),
        ),
    )


def changed(description: Measured, candidate: Candidate) -> Measured:
    """Return a description with the conventions of a candidate, except for reversed views."""
    images, geometry = description.images, description.geometry
    if candidate.transposed:
        images = images.model_copy(update={"transpose": not images.transpose})
    if candidate.views_rows or candidate.views_columns:
        other = "row" if candidate.views_rows else "column"
        exchanged = {"view": other, other: "view"}
        axes = tuple(exchanged.get(axis, axis) for axis in images.axes)
        images = images.model_copy(update={"axes": axes})
    if isinstance(geometry, Circle):
        keys: dict[str, Any] = {}
        if candidate.reversed_order:
            back = {"clockwise": "counterclockwise", "counterclockwise": "clockwise"}
            keys["direction"] = back[geometry.direction]
        sign = -1.0 if candidate.offset_sign else 1.0
        pitch = ImageFacts(1, 1, 1).panel(geometry.pitch_mm)
        scale = (pitch.pitch_u, pitch.pitch_v) if candidate.offset_px else (1.0, 1.0)
        right, up = geometry.panel_offset_mm
        keys["panel_offset_mm"] = (sign * scale[0] * right, sign * scale[1] * up)
        at_axis = scale[0] * (geometry.sod_mm / geometry.sdd_mm if candidate.offset_px else 1.0)
        keys["axis_offset_mm"] = sign * at_axis * geometry.axis_offset_mm
        geometry = geometry.model_copy(update=keys)
    return description.model_copy(update={"images": images, "geometry": geometry})


def _tried(
    description: Measured, candidate: Candidate, order: _Order, stored: list[NDArray[np.float32]]
) -> Tried:
    """Reconstruct a candidate from every other view, and predict the others."""
    measured, shape = changed(description, candidate), order.images.stack.shape
    by = max(1, -(-max(shape) // MOST_PIXELS))
    section = measured.images.model_copy(update={"bin": by})
    stated = measured.views(order.facts(turned_shape(section, shape)))
    chosen = stated.geometry[order.views]
    if candidate.reversed_order and not isinstance(description.geometry, Circle):
        chosen = chosen[::-1]
    flips = stated.flip_rows != candidate.rows, stated.flip_columns != candidate.columns
    placement = PanelPlacement(section, StatedViews(chosen, *flips))
    geometry = placement.geometry
    p = line_integrals(np.array([placement.image(image) for image in stored], np.float32))
    found = left_out(Projector(geometry, _grid(geometry)), p)
    return Tried(candidate, found.residual_rel, found.volume[len(found.volume) // 2].copy())


def _grid(geometry: ScanGeometry) -> VolumeGrid:
    from twinct.recon.sections.reconstruction import Grid

    return Grid.model_validate(grid_of(geometry)).volume_grid


def _draw(best: list[Tried], figure: Any) -> None:
    rows = -(-len(best) // 4)
    figure.get_layout_engine().set(h_pad=0.12)  # titles must not touch the edge
    axes = figure.subplots(rows, min(4, len(best)), squeeze=False)
    for at in axes.flat[len(best) :]:
        at.set_visible(False)
    for at, tried in zip(axes.flat, best, strict=False):
        top = max(float(np.percentile(tried.plane, 99.5)), 1e-9)
        at.imshow(tried.plane, cmap="gray", vmin=0, vmax=top, origin="lower")
        lines = f"{100 * tried.residual_rel:.1f} %", *wrap(tried.candidate.in_words, TITLE_WIDTH)
        at.set_title("\n".join(lines), fontsize=8)
        at.set_axis_off()
