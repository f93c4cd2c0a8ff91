"""Kinds of figures that a scenario can request: settings, words, references, check and formula.

Each kind's file ends with its ``FigureKind``. Kinds from outside the package come from the entry
points of the group ``twinct.figures``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Generic, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from twinct.core.settings import Section
from twinct.evaluation.figure import Figure, has_signal, null_without_signal
from twinct.evaluation.region_voxels import VoxelSet
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.specimen.signals import GaussianSignal, SphereSignal

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
"""Part of a figure's dotted name."""

T = TypeVar("T")


class FigureSettings(Section):
    """Keys of one entry of a kind in the section ``evaluation``."""

    @property
    def label(self) -> str:
        """Name of the entry's figures, without dots: by default, the value of its first key."""
        first = next(iter(type(self).model_fields))
        return str(getattr(self, first)).replace(".", "_")


class RoundBody(NamedTuple):
    """Sphere, or cylinder along its z axis.

    Attributes:
        world_from_body: pose of the centre.
        radius_mm: radius.
        height_mm: height of a cylinder; None for a sphere.
    """

    world_from_body: Pose
    radius_mm: float
    height_mm: float | None = None


class NamedPlaces(Protocol):
    """Regions and parts of a scenario on a grid, by name."""

    @property
    def grid(self) -> VolumeGrid:
        """Grid of the voxels."""
        ...

    def region(self, name: str) -> VoxelSet:
        """Return the voxels of a region."""
        ...

    def part(self, name: str) -> VoxelSet:
        """Return all voxels that a part fills, even partly."""
        ...

    def body(self, name: str) -> RoundBody:
        """Return a region or a part that is a sphere or a cylinder."""
        ...


class Repeated(NamedTuple):
    """Volumes of a scan that was taken again, all made alike.

    Attributes:
        without: volumes of scans with noise of their own, the measured one first, (z, y, x), 1/mm.
        with_signal: volume of the first scan with a signal in its images, and the same noise.
    """

    without: Sequence[NDArray[np.float32]]
    with_signal: NDArray[np.float32]


class Again(Protocol):
    """Scan of a volume, which can be taken and reconstructed again."""

    def __call__(
        self, signal: SphereSignal | GaussianSignal, centres_mm: Floats, scans: int
    ) -> Repeated:
        """Return further volumes.

        Args:
            signal: signal to insert.
            centres_mm: its places in the world, (copies, 3), mm.
            scans: number of scans with noise of their own, the measured one included; a scan
                without noise is not repeated.
        """
        ...


@dataclass(frozen=True, eq=False)
class Measurement:
    """Volume to measure in.

    Attributes:
        places: regions and parts.
        volume: attenuation on the grid, (z, y, x), 1/mm.
        known_truth: true attenuation on the grid, (z, y, x), 1/mm; None if it is not known, as of
            an imported scan.
        mu_reference: attenuation to which figures are relative, 1/mm; NaN without a truth.
        signal_rel: contrast of the volume, relative to the truth's; NaN if it is unknown.
        mu_water: attenuation of water, 1/mm; NaN if it is unknown.
        again: takes the scan of the volume again; None if there is no scan.
        signal_error_rel: standard error of ``signal_rel``.
    """

    places: NamedPlaces
    volume: NDArray[Any]
    known_truth: NDArray[Any] | None
    mu_reference: float
    signal_rel: float = math.nan
    mu_water: float = math.nan
    again: Again | None = None
    signal_error_rel: float = 0.0
    _known: dict[Any, Any] = field(default_factory=dict[Any, Any], init=False, repr=False)

    @property
    def truth(self) -> NDArray[Any]:
        """True attenuation on the grid, (z, y, x), 1/mm.

        Raises:
            ValueError: there is none, and the kind does not say that it needs one.
        """
        if self.known_truth is None:
            raise ValueError("a figure without needs_truth must not ask for the truth")
        return self.known_truth

    @property
    def grid(self) -> VolumeGrid:
        """Grid of the voxels."""
        return self.places.grid

    def region(self, name: str) -> VoxelSet:
        """Return the voxels of a region."""
        return self.once(_voxels_of_region, name)

    def once(self, function: Callable[[Measurement, str], T], name: str) -> T:
        """Return ``function(self, name)``, which several entries may need, from a single call."""
        if (function, name) not in self._known:
            self._known[function, name] = function(self, name)
        return self._known[function, name]


def _voxels_of_region(at: Measurement, name: str) -> VoxelSet:
    return at.places.region(name)


class Curve(NamedTuple):
    """Curve over ``frequency_per_mm``, which the report plots.

    Attributes:
        key: name of its values.
        label: label of its axis.
        title: title of the picture.
        meaning: a sentence; {0} stands for the material that figures are relative to.
    """

    key: str
    label: str
    title: str
    meaning: str


Target = Literal["part", "region", "round body"]
"""Things that a key can name: a part, a region, or one of both that is a sphere or a cylinder."""

SettingsT = TypeVar("SettingsT", bound=FigureSettings)


@dataclass(frozen=True, eq=False)
class FigureKind(Generic[SettingsT]):
    """Kind of figures that a scenario can request.

    Attributes:
        name: key in the section ``evaluation``.
        settings: class of an entry.
        description: description of the key, a sentence.
        figures: scalar figures of each entry.
        measure: computes the figures and curves of an entry, by key; a figure that is left out is
            NaN.
        names: keys of the settings that name something: what they name, or "KIND.KEY" if they
            repeat a key of an entry of another kind. None is allowed if the key allows it. Parts
            must cover voxels of the grid, and so must regions.
        check: returns problems with the grid, before any work: sentences by key of the settings.
        curves: curves of each entry.
        repeats: its figures need further reconstructions (``Measurement.again``), so that they are
            not measured again without need.
        needs_truth: its figures compare the volume with the truth; False for figures of the volume
            alone, such as its noise or its sharpness, which imported scans have, too.
    """

    name: str
    settings: type[SettingsT]
    description: str
    figures: tuple[Figure, ...]
    measure: Callable[[Measurement, SettingsT], Mapping[str, Any]]
    names: Mapping[str, Target | str] = field(default_factory=dict[str, str])
    check: Callable[[NamedPlaces, SettingsT], Mapping[str, str]] = lambda places, one: {}
    curves: tuple[Curve, ...] = ()
    repeats: bool = False
    needs_truth: bool = True

    def __post_init__(self) -> None:
        """Refuse a name that is no key, and references from keys that the settings lack."""
        if not re.fullmatch("[a-z][a-z_0-9]*", self.name):
            raise ValueError(f"{self.name!r} must be lower-case letters, digits and underscores")
        if unknown := sorted(self.names.keys() - self.settings.model_fields.keys()):
            raise ValueError(f"{self.settings.__name__} has no key {', '.join(unknown)}")

    def measured(self, at: Measurement, entry: SettingsT) -> dict[str, Any]:
        """Return the figures and curves of an entry, by key.

        A figure that rewards a volume without signal is NaN for it.
        """
        seen = has_signal(at.signal_rel, at.signal_error_rel)
        rewarded = all(one.without_signal == "null" for one in self.figures)
        result = self.measure(at, entry) if seen or not rewarded else {}
        if not seen:  # curves go, too
            data = {one.key: result[one.key] for one in self.figures if one.key in result}
            result = null_without_signal(data, self.figures)
        scalars = {one.key: float(result.get(one.key, math.nan)) for one in self.figures}
        return scalars | {key: value for key, value in result.items() if key not in scalars}
