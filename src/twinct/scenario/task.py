"""Task of view planning: a region, the goals, and the number of views."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from twinct.core.settings import Conflict, Finite, NonNegative, Positive, Section, Vector, setting
from twinct.scenario.evaluation import GaussianSignal, SphereSignal
from twinct.scenario.specimen import Specimen

Weight = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, allow_inf_nan=False)]

_LIMIT = (
    "Largest mean over the views, relative to the mean of views spread evenly over all "
    "reachable ones; null: no limit."
)
_ENOUGH = (
    "Smallest value, relative to that of views spread evenly over all reachable ones; null: "
    "whatever the weights yield."
)


class CompletenessGoal(Section):
    """Planes through points of the region that the source crosses (Tuy): more is better."""

    weight: Weight = setting(1.0, "Weight of this goal.", unit="1")
    at_least_rel: Share | None = setting(None, _ENOUGH, unit="1")
    within_deg: Positive = setting(
        3.0, "Angle from a plane within which a view counts as crossing it."
    )


class DetectabilityGoal(Section):
    """Detectability d' of a signal in the middle of the region: more is better."""

    weight: Weight = setting(1.0, "Weight of this goal.", unit="1")
    at_least_rel: Share | None = setting(None, _ENOUGH, unit="1")
    signal: Annotated[SphereSignal | GaussianSignal, Field(discriminator="kind")] = Field(
        description="Signal to detect."
    )
    voxel_mm: Positive = setting(1.0, "Voxel edge of the reconstruction for which it is predicted.")
    penalty: Positive = setting(
        1.0,
        "Strength of the reconstruction's quadratic penalty, relative to what evenly spread "
        "views measure at the signal's frequencies: 1 smooths half of the signal away.",
        unit="1",
    )


class SeenMetal(Section):
    """Metal that a volume shows, such as a volume from a few scout views."""

    path: Path = Field(
        description="NIfTI file of attenuation in 1/mm, in world coordinates, such as a run's "
        "volume.nii."
    )
    above_per_mm: Positive = setting(
        0.1, "Attenuation above which a voxel is metal; bone stays below it.", unit="1/mm"
    )
    material: str = setting("titanium", "Material of the metal, by name.")


class MetalGoal(Section):
    """Metal that rays cross: less is better."""

    weight: Weight = setting(1.0, "Weight of this goal.", unit="1")
    parts: tuple[str, ...] = setting((), "Names of the metal parts.")
    seen: SeenMetal | None = setting(None, "Metal that a volume shows, instead of parts.")
    counts: Literal["length", "starved", "shift"] = setting(
        "length",
        "Cost of a ray. length: its length in metal; starved: whether fewer than least_photons "
        "photons remain; shift: how much metal hardens it.",
    )
    least_photons: Positive = setting(
        100.0, "Photons in a pixel below which a ray is starved.", unit="1"
    )
    rays: Literal["region", "metal"] = setting(
        "region",
        "Rays that count. region: those through the region; metal: those through the metal "
        "itself, if the surroundings of the metal are of interest.",
    )
    at_most_rel: Share | None = setting(None, _LIMIT, unit="1")


class DoseGoal(Section):
    """Primary kerma in a part: less is better. Scattered photons are ignored."""

    weight: Weight = setting(1.0, "Weight of this goal.", unit="1")
    part: str = Field(description="Name of the part.")
    at_most_rel: Share | None = setting(None, _LIMIT, unit="1")


class MovingGoal(Section):
    """Time that the arms need from view to view at full speed: less is better."""

    weight: Weight = setting(1.0, "Weight of this goal.", unit="1")
    at_most_rel: Share | None = setting(
        None,
        "Largest time, relative to that of as many views spread evenly over all reachable ones; "
        "null: no limit.",
        unit="1",
    )


class KnownGoal(Section):
    """Knowledge of the region from few views, predicted by a linear model: more is better."""

    weight: Weight = setting(1.0, "Weight of this goal.", unit="1")
    at_least_rel: Share | None = setting(None, _ENOUGH, unit="1")
    correlation_mm: Positive = setting(
        20.0, "Distance at which the correlation of attenuations is 1 / e, before any view."
    )
    deviation_rel: Positive = setting(
        0.5,
        "Standard deviation of attenuation before any view, relative to the attenuation of the "
        "reference material.",
        unit="1",
    )
    voxels: int = setting(
        600, "Number of voxels of the coarse grid around the specimen.", ge=8, le=5000
    )


class TryingGoal(Section):
    """Error in the region of a volume made from images of each path: less is better."""

    weight: Weight = setting(1.0, "Weight of this goal.", unit="1")


class ExposureSharing(Section):
    """Distribution of the mAs among the chosen views for the best detectability, at a fixed sum."""

    least_rel: float = setting(
        0.25, "Smallest mAs of a view, relative to the source's mAs.", unit="1", gt=0, le=1
    )
    most_rel: float = setting(
        4.0, "Largest mAs of a view, relative to the source's mAs.", unit="1", ge=1, le=1000
    )


class FamilyParameter(Section):
    """Numeric key of the scenario's trajectory that is optimised."""

    key: str = Field(description="Key in `trajectory`, such as tilt_deg.")
    low: Finite = Field(description="Lowest value.")
    high: Finite = Field(description="Highest value.")


class FamilySearch(Section):
    """Best path of the scenario's kind of trajectory, found by CMA-ES, instead of free views."""

    parameters: tuple[FamilyParameter, ...] = Field(min_length=2, description="Keys to optimise.")
    generations: int = setting(15, "Largest number of generations of the search.", ge=1, le=1000)
    population: int = setting(8, "Number of paths in each generation.", ge=4, le=1000)


class ViewTask(Section):
    """Goals for which `twinct plan` chooses views; a run does not read them."""

    position_mm: Vector = setting(
        (0.0, 0.0, 0.0), "Centre of the region, a ball, in the specimen's frame."
    )
    radius_mm: NonNegative = setting(20.0, "Radius of the region; 0: a point.")
    views: int = Field(ge=1, le=2000, description="Number of views to choose.")
    candidates: int = setting(
        400,
        "Number of candidate views, spread over the sphere at the trajectory's distances. Views "
        "are chosen from those that the arms can reach.",
        ge=2,
        le=20_000,
    )
    rounds: int = setting(2, "Rounds in which each view may be exchanged.", ge=0, le=20)
    completeness: CompletenessGoal | None = setting(None, "Favour complete data.")
    detectability: DetectabilityGoal | None = setting(None, "Favour the detectability of a signal.")
    known: KnownGoal | None = setting(None, "Favour knowledge of the region from few views.")
    metal: MetalGoal | None = setting(None, "Avoid metal in the rays.")
    dose: DoseGoal | None = setting(None, "Avoid dose.")
    moving: MovingGoal | None = setting(None, "Avoid long moving times of the arms.")
    trying: TryingGoal | None = setting(
        None,
        "Favour a small error in the region. Paths of a family are tried: images as from a "
        "gantry are reconstructed as in the scenario.",
    )
    exposure: ExposureSharing | None = setting(
        None, "Give each view its own mAs; null: all views have the source's mAs."
    )
    family: FamilySearch | None = setting(
        None, "Choose the views of the best path of a family; null: choose views freely."
    )

    def conflicts(self, specimen: Specimen) -> Iterator[Conflict]:
        """Yield conflicts: no goal, more views than candidates, or unknown parts."""
        if not (self.completeness or self.detectability or self.known or self.trying):
            yield Conflict(
                "task: completeness, detectability or known is required: metal, dose and "
                "moving alone would choose the same view again and again",
                ("task",),
            )
        if self.trying and not self.family:
            yield Conflict(
                "task.trying: this goal needs task.family, because it tries whole paths, "
                "not single views; twinct plan --try tries the chosen views",
                ("task.trying", "task.family"),
            )
        if self.views > self.candidates:
            yield Conflict(
                f"task.views ({self.views}) must be at most task.candidates ({self.candidates})",
                ("task.views", "task.candidates"),
            )
        if self.exposure and not self.detectability:
            yield Conflict(
                "task.exposure: sharing the mAs serves detectability and needs task.detectability",
                ("task.exposure", "task.detectability"),
            )
        if self.exposure and self.family:
            yield Conflict(
                "task.exposure: a file of views can give each view its own mAs, a path of "
                "task.family cannot; leave out one of the two",
                ("task.exposure", "task.family"),
            )
        yield from self._family_conflicts()
        if self.metal and bool(self.metal.parts) == (self.metal.seen is not None):
            yield Conflict(
                "task.metal: give either parts (of the specimen) or seen (in a volume)",
                ("task.metal.parts", "task.metal.seen"),
            )
        yield from self._unknown_parts([part.label for part in specimen.parts])

    def _family_conflicts(self) -> Iterator[Conflict]:
        family = self.family.parameters if self.family else ()
        for i, one in enumerate(family):
            key = f"task.family.parameters.{i}"
            if one.low >= one.high:
                message = f"{key}: low ({one.low:g}) must be below high ({one.high:g})"
                yield Conflict(message, (f"{key}.low", f"{key}.high"))
            if one.key in [other.key for other in family[:i]]:
                yield Conflict(f"{key}.key: {one.key!r} is listed twice", (f"{key}.key",))

    def _unknown_parts(self, names: list[str]) -> list[Conflict]:
        having = (
            f"{'the parts are' if len(names) > 1 else 'the only part is'} "
            f"{', '.join(map(repr, names))}"
        )
        metal = self.metal.parts if self.metal else ()
        wanted = [(f"metal.parts.{i}", part) for i, part in enumerate(metal)]
        wanted += [("dose.part", self.dose.part)] if self.dose else []
        return [
            Conflict(f"task.{key}: unknown part {name!r}; {having}", (f"task.{key}",))
            for key, name in wanted
            if name not in names
        ]
