"""Objectives: settings, and the measure that they make for candidate views.

Each objective's file ends with its ``Objective``. Objectives from outside the package come from the
entry points of the group ``twinct.objectives``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Protocol, TypeVar

from pydantic import Field

from twinct.core.foreign_text import quoted
from twinct.core.progress import SILENT, Progress
from twinct.core.settings import Conflict, Section, setting
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.rays import Body
from twinct.recon.volume import Volume
from twinct.specimen.materials import Material
from twinct.view_planning.objectives.measures import Measure, figure_of

Share = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class ObjectiveSettings(Section):
    """Keys of one objective; a class of its own derives from one of the two below."""

    weight: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)] = setting(
        1.0, "Weight of this goal.", unit="1"
    )


class MoreIsBetter(ObjectiveSettings):
    """Keys of an objective whose figure should be large."""

    at_least_rel: Share | None = setting(
        None,
        "Smallest value, relative to that of views spread evenly over all reachable ones; null: "
        "no limit.",
        unit="1",
    )


class LessIsBetter(ObjectiveSettings):
    """Keys of an objective whose figure should be small; only a ``Mean`` or a time has a limit."""

    at_most_rel: Share | None = setting(
        None,
        "Largest mean over the views, relative to the mean of views spread evenly over all "
        "reachable ones; null: no limit.",
        unit="1",
    )


@dataclass(frozen=True, eq=False)
class Views:
    """Views to be measured, and the region that they are to show.

    Attributes:
        geometry: the views, candidates first.
        even: views spread evenly over all reachable ones, by their index.
        points: middle of the region, then points on its surface, world, (points, 3), mm.
        radius_mm: radius of the region.
        in_order: True if the views form a path in the given order.
        progress: receives the progress.
    """

    geometry: ScanGeometry
    even: Sequence[int]
    points: Floats
    radius_mm: float = 0.0
    in_order: bool = False
    progress: Progress = SILENT


class PatientModel(Protocol):
    """Patient, beam and arms, as a plan knows them before any view."""

    @property
    def energy_kev(self) -> float:
        """Effective energy of the beam."""
        ...

    @property
    def reference_mu(self) -> float:
        """Attenuation of the reference material at the effective energy, 1/mm."""
        ...

    @property
    def seed(self) -> int:
        """Seed of random draws."""
        ...

    @property
    def voxel_mm(self) -> float:
        """Voxel edge of the patient's volume."""
        ...

    def attenuation(self, energy_kev: float) -> Volume:
        """Return the patient's attenuation on a coarse grid that holds all of it, 1/mm."""
        ...

    def photons(
        self, geometry: ScanGeometry, place: Floats, voxel_mm: float, key: str
    ) -> tuple[ScanGeometry, Floats]:
        """Compute the photons behind the patient, on pixels as coarse as voxels at a place.

        Args:
            geometry: the views.
            place: position of the voxels, in the world, mm.
            voxel_mm: edge of the voxels.
            key: key of the scenario, for messages.

        Returns:
            The views with a coarse panel; photons, (views, rows, columns).

        Raises:
            InputError: the source has no photon number.
        """
        ...

    def doses(
        self, views: Views, part: str, *, photons: int, simulated: int, voxel_mm: float, key: str
    ) -> Floats:
        """Return the mean dose of a part or label in each view, at ``source.mas``, Gy, (views,).

        Args:
            views: the views.
            part: name of the part or label.
            photons: photons of each simulated view.
            simulated: number of views in which scattered photons are simulated.
            voxel_mm: edge of the voxels.
            key: key of the scenario, for messages.

        Raises:
            InputError: the source has no photon number, or an energy is outside the tables.
        """
        ...

    def signals(self) -> tuple[Floats, Floats]:
        """Return energies, keV, and photons weighted with their signals, any unit, (energies,)."""
        ...

    def points_of(self, part: str) -> Floats:
        """Draw points inside a part of the specimen, in the world, (points, 3), mm."""
        ...

    def body(self, part: str) -> tuple[Body, Pose]:
        """Return the surface of a part and its pose in the world."""
        ...

    def material_of(self, part: str) -> Material:
        """Return the material of a part."""
        ...

    def material(self, name: str, key: str) -> Material:
        """Return a material by its name.

        Raises:
            InputError: an unknown material; the message names the key.
        """
        ...

    def seconds_between(self, geometry: ScanGeometry) -> Floats:
        """Return the arms' moving time between all views, s, (views, views); NaN out of reach.

        Raises:
            InputError: the cell has no arms.
        """
        ...

    def short_tour(self, seconds: Floats) -> list[int]:
        """Return a short order of views, from the times between all of them."""
        ...


SettingsT = TypeVar("SettingsT", bound=ObjectiveSettings)


def _as_without_blur(
    settings: Any, measure: Any, views: Sequence[int], blur_mm: float, exposures: Floats
) -> float:
    return figure_of(measure, views)


@dataclass(frozen=True, eq=False)
class Objective(Generic[SettingsT]):
    """Objective of view planning.

    Attributes:
        name: key in the scenario's section ``task``.
        settings: class of its keys, a ``MoreIsBetter`` or a ``LessIsBetter``.
        measure: makes the measure of views. Two measures: the second one gives
            evenly spread views the figure that is the unit.
        description: sentence on the key, for the scenario's reference.
        unit: unit of the figure, from the settings; "1" for a ratio.
        conflicts: finds values that do not fit together, or parts that the specimen, whose parts
            are given by name, does not have.
        under_errors: figure of executed views, from the settings, the measure, the views, the blur
            at the region's middle (one sigma, mm) and the exposure of each view relative to the
            source's; None: errors of poses do not change the figure.
    """

    name: str
    settings: type[SettingsT]
    measure: Callable[[SettingsT, Views, PatientModel], Measure | tuple[Measure, Measure]]
    description: str
    unit: Callable[[SettingsT], str] = lambda own: "1"
    conflicts: Callable[[SettingsT, Sequence[str]], Sequence[Conflict]] = lambda own, parts: ()
    under_errors: Callable[[SettingsT, Any, Sequence[int], float, Floats], float] | None = (
        _as_without_blur
    )

    @property
    def more_is_better(self) -> bool:
        """True if the figure should be large."""
        return issubclass(self.settings, MoreIsBetter)


def unknown_parts(wanted: Mapping[str, str], parts: Sequence[str]) -> list[Conflict]:
    """Return a conflict for each part that the specimen does not have.

    Args:
        wanted: names of parts, by their dotted key.
        parts: names of the specimen's parts.
    """
    having = (
        f"{'the parts are' if len(parts) > 1 else 'the only part is'} {', '.join(map(repr, parts))}"
    )
    return [
        Conflict(f"{key}: unknown part {quoted(name)}; {having}", (key,))
        for key, name in wanted.items()
        if name not in parts
    ]
