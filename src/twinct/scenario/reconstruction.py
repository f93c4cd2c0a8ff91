"""The section that says how a volume is made."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.geometry import Pose, VolumeGrid
from twinct.scenario.beam_hardening import BeamHardening
from twinct.settings import (
    Conflict,
    ConflictError,
    Lengths,
    NonNegative,
    Positive,
    Section,
    Vector,
    facts,
)


class Grid(Section):
    """The voxels of the reconstruction."""

    voxels: Annotated[int, Field(ge=2, le=4096)] | tuple[int, int, int] = Field(
        default=512,
        description="Voxels along each axis; three numbers for (x, y, z).",
        json_schema_extra=facts(source="the paper"),
    )
    voxel_mm: Positive | Lengths = Field(
        default=0.31,
        description="Voxel edge; three for (x, y, z).",
        json_schema_extra=facts(source="the paper"),
    )
    centre_mm: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Centre of the grid in the world."
    )
    rotation_deg: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Extrinsic rotations about x, y, z."
    )

    @model_validator(mode="after")
    def _some_voxels(self) -> Grid:
        if isinstance(self.voxels, tuple) and min(self.voxels) < 2:
            raise ValueError(f"voxels {self.voxels} must be at least 2 along each axis")
        return self

    @property
    def volume_grid(self) -> VolumeGrid:
        """The voxel lattice."""
        nx, ny, nz = self.voxels if isinstance(self.voxels, tuple) else (self.voxels,) * 3
        return VolumeGrid(
            (nz, ny, nx), self.voxel_mm, Pose.from_euler(self.centre_mm, self.rotation_deg)
        )


GeometryName = Literal["commanded", "executed", "believed"]


class Surroundings(Section):
    """A coarse reconstruction of more than the grid, to take out what lies around the grid."""

    margin_mm: Positive = Field(
        description="By how much the coarse grid is larger on each side; the specimen should end "
        "inside of it.",
        json_schema_extra=facts(source="Ziegler, Nielsen and Grass, Med. Phys. 35 (2008)"),
    )
    voxel_mm: Positive = Field(description="Coarse voxel edge, such as four times the grid's.")
    iterations: int = Field(default=5, ge=1, le=10_000, description="Of a coarse SART.")
    relaxation: float = Field(default=0.3, gt=0, lt=2, description="Of the coarse SART.")


class Reconstruction(Section):
    """From projections to a volume. A key that the algorithm does not use has no effect."""

    algorithm: Literal["sart", "os_sart", "sirt", "cgls", "fdk", "fista_tv"] = Field(
        default="sart",
        description="docs/reconstruction.md says which for what.",
        json_schema_extra=facts(source="the paper"),
    )
    engine: Literal["twinct", "rtk"] = Field(
        default="twinct",
        description="rtk is the independent cross-check of sart; it needs the extra rtk.",
    )
    iterations: int = Field(
        default=10,
        ge=1,
        le=10_000,
        description="Passes over all views; not for fdk.",
        json_schema_extra=facts(source="the paper"),
    )
    relaxation: float = Field(
        default=0.3,
        gt=0,
        lt=2,
        description="For sart, os_sart and sirt.",
        json_schema_extra=facts(source="the paper"),
    )
    order: Literal["golden", "sequential", "random", "weighted_distance"] = Field(
        default="golden",
        description="Order of the views, for sart.",
        json_schema_extra=facts(source="weighted_distance: Mueller, Yagel and Cornhill 1997"),
    )
    subsets: int | None = Field(
        default=None,
        ge=1,
        description="Groups of views, for os_sart and fista_tv; one for each 10 views by default.",
    )
    regularisation: NonNegative = Field(
        default=1e-4,
        description="Strength of the total variation, for fista_tv: a pure number that means the "
        "same for any number of views, pixels or voxels.",
    )
    weighting: Literal["uniform", "counts"] = Field(
        default="uniform",
        description="Weight of each pixel, for fista_tv; counts: its transmission, for Poisson "
        "noise.",
    )
    tv_steps: int = Field(
        default=10, ge=1, le=1000, description="Steps of the denoising in each update of fista_tv."
    )
    window: Literal["ramp", "shepp_logan", "cosine", "hamming", "hann"] = Field(
        default="ramp", description="Window of the ramp filter of fdk, from sharp to smooth."
    )
    nonnegative: bool | None = Field(
        default=None,
        description="Whether no voxel falls below 0; by default so for fista_tv only. Not for "
        "cgls.",
    )
    surroundings: Surroundings | None = Field(
        default=None, description="Take out what lies around the grid first."
    )
    beam_hardening: BeamHardening | None = Field(
        default=None, description="Correction of line integrals before reconstruction."
    )
    geometry: GeometryName | tuple[GeometryName, ...] = Field(
        default="believed",
        description="Geometry to reconstruct from; several are judged side by side, and the first "
        "one's volume is kept.",
        json_schema_extra=facts(source="the paper"),
    )
    grid: Grid = Field(default=Grid(), description="The voxels.")

    @model_validator(mode="after")
    def _distinct_geometries(self) -> Reconstruction:
        if not self.geometries or len(set(self.geometries)) != len(self.geometries):
            raise ValueError("geometry must name at least one geometry, each once")
        return self

    @model_validator(mode="after")
    def _possible(self) -> Reconstruction:
        if self.engine == "rtk" and self.algorithm != "sart":
            message = f"engine rtk has the algorithm sart only, not {self.algorithm}"
            raise ConflictError(Conflict(message, ("engine", "algorithm")))
        if self.algorithm == "cgls" and self.nonnegative:
            message = "nonnegative is not possible with cgls: use sirt or fista_tv"
            raise ConflictError(Conflict(message, ("nonnegative", "algorithm")))
        return self

    @property
    def geometries(self) -> tuple[GeometryName, ...]:
        """Always a tuple."""
        return self.geometry if isinstance(self.geometry, tuple) else (self.geometry,)

    @property
    def keeps_nonnegative(self) -> bool:
        """Whether no voxel may fall below 0."""
        return self.algorithm == "fista_tv" if self.nonnegative is None else self.nonnegative

    @property
    def in_words(self) -> str:
        """Algorithm and the parameters it uses, in one line."""
        name = self.algorithm if self.engine == "twinct" else f"{self.algorithm} ({self.engine})"
        used = {
            "sart": ("iterations", "relaxation", "order"),
            "os_sart": ("iterations", "relaxation", "subsets"),
            "sirt": ("iterations", "relaxation"),
            "cgls": ("iterations",),
            "fdk": ("window",),
            "fista_tv": ("iterations", "regularisation", "subsets", "weighting"),
        }[self.algorithm]
        values = {key: getattr(self, key) for key in used}
        words = [
            f"{value} iterations"
            if key == "iterations"
            else f"{key} {value:g}"
            if isinstance(value, float)
            else f"{key} {value}"
            for key, value in values.items()
            if value is not None
        ]
        if self.keeps_nonnegative:
            words.append("non-negative")
        if self.beam_hardening:
            words.append(f"beam hardening of {self.beam_hardening.kind.replace('_', ' ')}")
        if self.surroundings:
            words.append(f"surroundings of {self.surroundings.margin_mm:g} mm taken out")
        return ", ".join([name, *words])
