"""Doubts about a measured scan: statements that can be right, but seldom are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry
from twinct.measured.circle import Circle
from twinct.measured.corrections import Corrected, Corrections
from twinct.measured.description import Measured
from twinct.measured.fields import SATURATED
from twinct.measured.lag import sentences as ghost_sentences
from twinct.measured.looks import Looks
from twinct.measured.order import ViewOrder, listed
from twinct.measured.sharpness import Sharpness
from twinct.scan.integrals import DARKEST

OFF_AIR = 0.05
"""Difference of air from 1 that is looked at."""

UNSTEADY = 0.1
"""Change of the mean line integral from view to view, relative to it, that is looked at."""

STEADIER = 3.0
"""How many times less it changes along another axis that may be that of the views."""

NEAR_ONE = 0.9, 1.15
"""Range of the largest line integrals that may be the transmission of air."""

AIR = 0.1
"""Least share of the pixels of an image that show air, if any do."""

NO_AIR = 0.02
"""Line integrals up to this one, relative to the largest, are taken for air."""

SOME = 256
"""Rows and columns of a view, at most, in which air is looked for."""

FEW_DEG = 2.5, 7.0
"""Range of spans, deg, that are more likely to be those of a scan in rad."""

TURNS = 2.0
"""Number of turns of a circular scan beyond which its angles are doubtful."""


@dataclass(eq=False)
class Doubts:
    """Sums of the images of a scan while they are read, and what they make doubtful.

    Attributes:
        description: description of the scan.
        images: its images.
        geometry: its views.
        looks: counts of its pixels.
    """

    description: Measured
    images: Corrections
    geometry: ScanGeometry
    looks: Looks
    _views: list[float] = field(default_factory=list)
    _rows: NDArray[np.float64] | float = 0.0
    _columns: NDArray[np.float64] | float = 0.0
    _like_transmissions: int = 0
    _order: ViewOrder = field(default_factory=ViewOrder)
    _sharpness: Sharpness = field(default_factory=Sharpness)

    def add(self, view: int, corrected: Corrected) -> None:
        """Count one more view, of a number in the stack."""
        transmission = corrected.image
        self._order.add(view, corrected.stored, transmission)
        self._sharpness.add(view, transmission)
        p = -np.log(np.maximum(transmission, DARKEST))
        self._views.append(float(p.mean()))
        self._rows = self._rows + p.mean(axis=1)
        self._columns = self._columns + p.mean(axis=0)
        some = p[:: -(-p.shape[0] // SOME), :: -(-p.shape[1] // SOME)]
        high = float(np.percentile(some, 99.5))
        air = np.mean(some <= NO_AIR * high), np.mean(some >= NEAR_ONE[0] * high)
        alike = NEAR_ONE[0] < high < NEAR_ONE[1] and air[0] < AIR < air[1]
        self._like_transmissions += int(alike)

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence for each doubt."""
        count = len(self._views)
        if count == 1:
            return ("one view: no volume can be made from it",)
        result = _doubts_of_angles(self.description.geometry, self.images.stack.count)
        where = self.images.stack.where
        if missing := self.images.stack.missing:
            result.append(
                f"{where}: the numbers of the files leave out {listed([str(n) for n in missing])}: "
                "are views missing? Then the angles must leave them out, too"
            )
        # Images that are read wrongly show all other faults, too.
        if misread := self._doubts_of_reading():
            return (*result, *misread)
        of_views = [*self._order.sentences(self.geometry), *self._sharpness.sentences]
        result += [f"{where}: {told}" for told in of_views]
        result += ghost_sentences(self.images.ghosts, self.images.section.lag)
        return (*result, *self._doubts_of_pixels())

    def _doubts_of_reading(self) -> list[str]:
        result, count = [], len(self._views)
        if (
            self.description.images.values == "line_integrals"
            and self._like_transmissions > count / 2
        ):
            result.append(
                "images.values: line_integrals, but most views have many pixels near 1 and hardly "
                "any near 0: are they transmissions, which are 1 in air?"
            )
        changes = {name: _change(sums) for name, sums in self._other_axes()}
        here = _change(np.array(self._views))
        if changes and here > UNSTEADY and here > STEADIER * min(changes.values()):
            name = min(changes, key=lambda one: changes[one])
            result.append(
                f"line integrals change by {here:.0%} (RMS) from view to view, but by "
                f"{changes[name]:.1%} from {name} to {name}: are views and {name}s exchanged? "
                + (
                    "See images.axes; --try tries both"
                    if self.images.stack.exchangeable
                    else "Are the files sinograms?"
                )
            )
        return result

    def _doubts_of_pixels(self) -> list[str]:
        result, air, where = [], self.looks.air, self.images.stack.where
        if self.images.lacks_fall:
            result.append(
                f"{where}: air falls by {1 - self.images.least_beam:.1%} towards the darkest "
                "corner, as the beam of this geometry does: "
                + ("images.flats lack" if self.images.flat is not None else "nothing corrects")
                + " this fall-off: images.air: auto divides by it and scales each view to 1 in "
                "air, images.air: fall_off only divides; images.air.fall_off for a region of your "
                "own"
            )
        elif air is not None and not self.images.scaled and abs(air - 1) > OFF_AIR:
            flats = "flats" if self.images.flat is not None else "white"
            cause = {"intensities": f"images.{flats} of another exposure than the views'"}.get(
                self.description.images.values, "numbers that were never divided by air"
            )
            result.append(
                f"{where}: the brightest steady pixels read {air:.3g}; air must read 1: {cause}? "
                "images.air: auto scales each view to 1 there, images.air with rows and columns in "
                "a region of your own; right only if these pixels show air"
            )
        if not self.images.scaled and (drift := self.looks.drift):
            (darkest, low), (brightest, high) = drift.least, drift.most
            result.append(
                f"{where}: air {'drifts' if drift.slow else 'flickers'} from {low:.4g} in image "
                f"{darkest} to {high:.4g} in image {brightest}, by more than its noise of "
                f"{drift.error:.1g}: the tube is not steady: images.air: auto scales each view to "
                "1 in air"
            )
        for name in self.looks.lines:
            result += [f"{where}: {told}" for told in self._doubts_of_lines(name)]
        if self.images.flat is not None and (brighter := self.images.brighter):
            result.append(
                f"{where}: {brighter.share:.1%} of the pixels of image {brighter.view} are "
                "brighter than air by more than 10 %: do images.flats hold the object, or are they "
                "of another beam? Take flats without it"
            )
        if (share := self.looks.share("saturated")) > SATURATED:
            result.append(
                f"{where}: {share:.1%} of the pixels are saturated, at {self.images.largest:.0f}, "
                f"the first in image {self.looks.first_saturated}: their line integrals are too "
                "large; repeat the scan with less exposure"
            )
        return result

    def _doubts_of_lines(self, name: str) -> Iterator[str]:
        odd = self.looks.lines[name].odd
        cure = f"images.lines: {{along: {name}}} evens them by their air"
        if odd.always:
            told = listed([f"{line} by {off:+.1%}" for line, off in odd.always])
            yield (
                f"air of {name} differs from that of their neighbours in all views, {told}: do the "
                f"flats lack them? {cure}, images.rings in the mean of a turn"
            )
        if odd.flickers:
            view, line, off = odd.worst
            yield (
                f"air of {name} of single views ({odd.flickers}) differs from that of their "
                f"neighbours, the most in image {view}, {name[:-1]} {line}, by {off:+.1%}: {cure}, "
                "with kind: offset if the readout adds a number to them"
            )
        if seams := self.images.seams.get(name):
            told = listed([f"{line} by {step:+.1%}" for line, step in seams])
            yield (
                f"brightness steps at {name} {told}, in pixels that no view changes: are there "
                "tiles of other gains? Take flats of these views"
            )

    def _other_axes(self) -> list[tuple[str, NDArray[np.float64]]]:
        """Return the sums along each axis that may be that of the views, by their counts."""
        stack, geometry = self.images.stack, self.description.geometry
        free = isinstance(geometry, Circle) and geometry.angles.step is not None
        axes = zip(("row", "column"), stack.shape, (self._rows, self._columns), strict=True)
        return [
            (name, np.asarray(sums))
            for name, count, sums in axes
            if count > 1 and (free or count == stack.count)
        ]


def _doubts_of_angles(geometry: object, views: int) -> list[str]:
    if not isinstance(geometry, Circle):
        return []
    span, unit = float(np.ptp(geometry.angles.radians(views, "angles"))), geometry.angles.unit
    if unit == "deg" and FEW_DEG[0] < np.degrees(span) < FEW_DEG[1]:
        return [
            f"geometry.angles: {views} views cover {np.degrees(span):.3g} deg: are the angles in "
            "radians? Then state unit: rad"
        ]
    if span > TURNS * 2 * np.pi:
        other = "are they in degrees? Then state unit: deg" if unit == "rad" else "is that right?"
        return [f"geometry.angles: the angles cover {span / (2 * np.pi):.3g} turns: {other}"]
    return []


def _change(sums: NDArray[np.float64]) -> float:
    """Return the standard deviation of sums, relative to their mean."""
    return float(np.std(sums) / max(abs(float(np.mean(sums))), 1e-12))
