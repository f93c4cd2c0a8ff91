"""Task of view planning: a region, the goals, and the number of views."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from twinct.scenario.evaluation import GaussianSignal, SphereSignal
from twinct.scenario.specimen import Specimen
from twinct.settings import Conflict, Finite, NonNegative, Positive, Section, Vector, setting

Weight = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, allow_inf_nan=False)]

_LIMIT = (
    "Largest mean over the views, as a share of that of views spread evenly over all that can be "
    "had; none: no limit."
)
_ENOUGH = (
    "Least of it, as a share of what views spread evenly over all that can be had have; none: as "
    "much as comes of the weights."
)


class CompletenessGoal(Section):
    """Planes through points of the region that the source crosses (Tuy): more is better."""

    weight: Weight = setting(1.0, "How much it counts.", unit="1")
    at_least_rel: Share | None = setting(None, _ENOUGH, unit="1")
    within_deg: Positive = setting(3.0, "Angle from a plane within which a view crosses it.")


class DetectabilityGoal(Section):
    """Detectability d' of a signal in the middle of the region: more is better."""

    weight: Weight = setting(1.0, "How much it counts.", unit="1")
    at_least_rel: Share | None = setting(None, _ENOUGH, unit="1")
    signal: Annotated[SphereSignal | GaussianSignal, Field(discriminator="kind")] = Field(
        description="What shall be detected."
    )
    voxel_mm: Positive = setting(1.0, "Voxels of the reconstruction that it is predicted for.")
    penalty: Positive = setting(
        1.0,
        "Strength of its quadratic penalty, as a share of what views spread evenly tell of the "
        "signal's frequencies: at 1 half of it is smoothed away.",
        unit="1",
    )


class SeenMetal(Section):
    """Metal that a volume shows, such as a volume from a few scout views."""

    path: Path = Field(
        description="NIfTI file of attenuation, 1/mm, in the world, as a run's volume.nii."
    )
    above_per_mm: Positive = setting(
        0.1, "Attenuation above which a voxel is metal: bone stays below.", unit="1/mm"
    )
    material: str = setting("titanium", "What it is made of, by name.")


class MetalGoal(Section):
    """Metal that rays cross: less is better."""

    weight: Weight = setting(1.0, "How much it counts.", unit="1")
    parts: tuple[str, ...] = setting((), "Names of the parts of metal.")
    seen: SeenMetal | None = setting(None, "Metal as a volume shows it, instead of parts.")
    counts: Literal["length", "starved", "shift"] = setting(
        "length",
        "What counts of a ray: its length in metal; whether fewer photons than least_photons are "
        "left of it; by how much metal hardens it.",
    )
    least_photons: Positive = setting(
        100.0, "Photons in a pixel below which a ray is starved.", unit="1"
    )
    rays: Literal["region", "metal"] = setting(
        "region",
        "Whose rays: those through the region, or through the metal itself, where what lies about "
        "it is looked for.",
    )
    at_most_rel: Share | None = setting(None, _LIMIT, unit="1")


class DoseGoal(Section):
    """Primary kerma in a part: less is better. Scattered photons are ignored."""

    weight: Weight = setting(1.0, "How much it counts.", unit="1")
    part: str = Field(description="Name of the part.")
    at_most_rel: Share | None = setting(None, _LIMIT, unit="1")


class MovingGoal(Section):
    """Time that the arms need from view to view at full speed: less is better."""

    weight: Weight = setting(1.0, "How much it counts.", unit="1")
    at_most_rel: Share | None = setting(
        None,
        "Most of it, as a share of what as many views spread evenly over all that can be had take; "
        "none: no limit.",
        unit="1",
    )


class KnownGoal(Section):
    """Knowledge of the region from few views, predicted by a linear model: more is better."""

    weight: Weight = setting(1.0, "How much it counts.", unit="1")
    at_least_rel: Share | None = setting(None, _ENOUGH, unit="1")
    correlation_mm: Positive = setting(
        20.0, "Distance at which attenuations are correlated by 1 / e, before any view."
    )
    deviation_rel: Positive = setting(
        0.5,
        "Standard deviation of attenuation before any view, as a share of the reference "
        "material's.",
        unit="1",
    )
    voxels: int = setting(600, "Voxels of the coarse grid about the specimen.", ge=8, le=5000)


class TryingGoal(Section):
    """Error in the region of a volume made from images of each path: less is better."""

    weight: Weight = setting(1.0, "How much it counts.", unit="1")


class ExposureSharing(Section):
    """Distribution of the mAs among the chosen views for the best detectability, at a fixed sum."""

    least_rel: float = setting(
        0.25, "Least mAs of a view, as a share of the source's.", unit="1", gt=0, le=1
    )
    most_rel: float = setting(
        4.0, "Most mAs of a view, as a share of the source's.", unit="1", ge=1, le=1000
    )


class FamilyParameter(Section):
    """Numeric key of the scenario's trajectory that is optimised."""

    key: str = Field(description="Its key in `trajectory`, such as tilt_deg.")
    low: Finite = Field(description="Lowest value.")
    high: Finite = Field(description="Highest value.")


class FamilySearch(Section):
    """Best path of the scenario's kind of trajectory, found by CMA-ES, instead of free views."""

    parameters: tuple[FamilyParameter, ...] = Field(min_length=2, description="What is sought.")
    generations: int = setting(15, "Generations of the search, at most.", ge=1, le=1000)
    population: int = setting(8, "Paths in each.", ge=4, le=1000)


class ViewTask(Section):
    """Goals for which `twinct plan` chooses views; a run does not read them."""

    position_mm: Vector = setting(
        (0.0, 0.0, 0.0), "Middle of the region, a ball, in the specimen's frame."
    )
    radius_mm: NonNegative = setting(20.0, "Its radius; 0: a point.")
    views: int = Field(ge=1, le=2000, description="How many views are chosen.")
    candidates: int = setting(
        400,
        "Views all over the sphere, at the trajectory's distances, of which those that the arms "
        "can have are chosen from.",
        ge=2,
        le=20_000,
    )
    rounds: int = setting(2, "Rounds in which each view may be exchanged.", ge=0, le=20)
    completeness: CompletenessGoal | None = setting(None, "Completeness counts.")
    detectability: DetectabilityGoal | None = setting(None, "Detectability counts.")
    known: KnownGoal | None = setting(None, "What few views tell counts.")
    metal: MetalGoal | None = setting(None, "Metal counts.")
    dose: DoseGoal | None = setting(None, "Dose counts.")
    moving: MovingGoal | None = setting(None, "Time that the arms take counts.")
    trying: TryingGoal | None = setting(
        None,
        "Paths of a family are tried: images as by a gantry, reconstructed as the scenario says; "
        "the error in the region counts.",
    )
    exposure: ExposureSharing | None = setting(
        None, "Views get mAs of their own; none: all have the source's."
    )
    family: FamilySearch | None = setting(
        None, "The views are those of the best path of a family; none: they are chosen freely."
    )

    def conflicts(self, specimen: Specimen) -> list[Conflict]:
        """Return conflicts: no goal, more views than candidates, or unknown parts."""
        names = [part.label for part in specimen.parts]
        having = f"there {'are' if len(names) > 1 else 'is'} {', '.join(map(repr, names))}"
        found: list[Conflict] = []
        if not (self.completeness or self.detectability or self.known or self.trying):
            found.append(
                Conflict(
                    "task: completeness, detectability or known must count: by metal, dose and "
                    "moving alone all views would be the same one",
                    ("task",),
                )
            )
        if self.trying and not self.family:
            found.append(
                Conflict(
                    "task.trying: whole paths are tried, not views one by one: it needs "
                    "task.family; twinct plan --try tries what was chosen",
                    ("task.trying", "task.family"),
                )
            )
        if self.views > self.candidates:
            found.append(
                Conflict(
                    f"task.views ({self.views}) must be at most task.candidates "
                    f"({self.candidates})",
                    ("task.views", "task.candidates"),
                )
            )
        if self.exposure and not self.detectability:
            found.append(
                Conflict(
                    "task.exposure: mAs are shared for the sake of detectability: it needs "
                    "task.detectability",
                    ("task.exposure", "task.detectability"),
                )
            )
        if self.exposure and self.family:
            found.append(
                Conflict(
                    "task.exposure: only a file of views has mAs of its own, not a path of "
                    "task.family: one of them",
                    ("task.exposure", "task.family"),
                )
            )
        family = self.family.parameters if self.family else ()
        for i, one in enumerate(family):
            key = f"task.family.parameters.{i}"
            if one.low >= one.high:
                message = f"{key}: low ({one.low:g}) must be below high ({one.high:g})"
                found.append(Conflict(message, (f"{key}.low", f"{key}.high")))
            if one.key in [other.key for other in family[:i]]:
                found.append(Conflict(f"{key}.key: {one.key!r} is sought twice", (f"{key}.key",)))
        if self.metal and bool(self.metal.parts) == (self.metal.seen is not None):
            found.append(
                Conflict(
                    "task.metal: parts of the specimen, or seen in a volume: one of them",
                    ("task.metal.parts", "task.metal.seen"),
                )
            )
        metal = self.metal.parts if self.metal else ()
        wanted = [(f"metal.parts.{i}", part) for i, part in enumerate(metal)]
        wanted += [("dose.part", self.dose.part)] if self.dose else []
        found += [
            Conflict(f"task.{key}: there is no part {name!r}; {having}", (f"task.{key}",))
            for key, name in wanted
            if name not in names
        ]
        return found
