"""The sections of a scenario: what each key means, its unit, its default and its bounds.

A function elsewhere takes its own section, never the whole scenario. Units stand in the key names.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from twinct.geometry import Pose
from twinct.scenario.composition import Composition
from twinct.scenario.reconstruction import Reconstruction
from twinct.scenario.section import (
    Conflict,
    ConflictError,
    Finite,
    Lengths,
    NonNegative,
    Positive,
    Section,
    Vector,
    facts,
)
from twinct.scenario.xray import Detector, Source, TubeSpectrum


class _Orbit(Section):
    views: int = Field(ge=1, le=100_000, description="Number of projections.")
    isocentre_mm: Vector = Field(default=(0.0, 0.0, 0.0), description="Centre of the orbit.")
    sod_mm: Positive = Field(
        default=300.0,
        description="Distance from source to isocentre.",
        json_schema_extra=facts(source="the paper"),
    )
    sdd_mm: Positive = Field(
        default=600.0,
        description="Distance from source to panel centre.",
        json_schema_extra=facts(source="the paper, as docs/paper.md reads it"),
    )
    centre_longitude_deg: Finite = Field(
        default=0.0,
        description="Longitude of the source in the middle of the path; 0 is +x, 90 is +y.",
    )

    @model_validator(mode="after")
    def _isocentre_between(self) -> _Orbit:
        if self.sdd_mm <= self.sod_mm:
            message = (
                f"sdd_mm ({self.sdd_mm:g}) must exceed sod_mm ({self.sod_mm:g}): "
                "the isocentre lies between source and panel"
            )
            raise ConflictError(Conflict(message, ("sdd_mm", "sod_mm")))
        return self


class SinusoidTrajectory(_Orbit):
    """The paper's path: a sine of latitude over an arc of longitude, on a sphere."""

    kind: Literal["sinusoid"]
    longitude_range_deg: float = Field(
        default=210.0,
        gt=0,
        le=360,
        description="Arc of longitude.",
        json_schema_extra=facts(source="the paper: 180 degrees and the fan"),
    )
    latitude_amplitude_deg: float = Field(
        default=30.0,
        ge=0,
        lt=90,
        description="Amplitude of the sine of latitude.",
        json_schema_extra=facts(source="the paper"),
    )
    periods: Positive = Field(
        default=1.0,
        description="Sine periods over the range.",
        json_schema_extra=facts(source="the paper, as docs/paper.md reads it"),
    )


class CircleTrajectory(_Orbit):
    """A full circle; the first and last view are one step apart."""

    kind: Literal["circle"]
    tilt_deg: Finite = Field(default=0.0, description="Tilt of the circle about the x axis.")


class ArcTrajectory(_Orbit):
    """Part of a circle of constant latitude, both ends included."""

    kind: Literal["arc"]
    longitude_range_deg: float = Field(
        default=210.0,
        gt=0,
        le=360,
        description="Arc of longitude.",
        json_schema_extra=facts(source="180 degrees and the paper's fan"),
    )
    latitude_deg: float = Field(
        default=0.0, gt=-90, lt=90, description="Latitude of the source; 90 is +z."
    )


class HelixTrajectory(_Orbit):
    """A helix about z: source and panel rise together."""

    kind: Literal["helix"]
    turns: Positive = Field(default=2.0, description="Turns about z.")
    pitch_mm: Finite = Field(default=50.0, description="Rise for each turn.")


class FileTrajectory(Section):
    """Views from a CSV file: S and D, or S, D, u, v for each row, mm."""

    kind: Literal["file"]
    path: Path = Field(description="CSV file.")


Trajectory = Annotated[
    SinusoidTrajectory | CircleTrajectory | ArcTrajectory | HelixTrajectory | FileTrajectory,
    Field(discriminator="kind"),
]


class Skull(Section):
    """The built-in adult skull from implicit surfaces."""

    kind: Literal["skull"]
    scale: Positive = Field(default=1.0, description="1 is adult size.")
    mesh_resolution_mm: Positive = Field(
        default=1.0, description="Cell of the lattice on which the surface mesh is extracted."
    )


class Sphere(Section):
    """A sphere about the part's origin."""

    kind: Literal["sphere"]
    radius_mm: Positive = Field(description="Radius.")


class Ellipsoid(Section):
    """An ellipsoid along the part's axes."""

    kind: Literal["ellipsoid"]
    semi_axes_mm: Lengths = Field(description="Semi-axes along x, y, z.")


class Cylinder(Section):
    """A cylinder along the part's z axis, centred."""

    kind: Literal["cylinder"]
    radius_mm: Positive = Field(description="Radius.")
    height_mm: Positive = Field(description="Height.")


class Box(Section):
    """A box along the part's axes, centred."""

    kind: Literal["box"]
    size_mm: Lengths = Field(description="Edges along x, y, z.")


class MeshFile(Section):
    """A watertight triangle mesh: STL, PLY, OBJ or what else trimesh reads."""

    kind: Literal["mesh"]
    path: Path = Field(description="Mesh file.")
    unit_mm: Positive = Field(default=1.0, description="Length of the file's unit.")
    centre: bool = Field(
        default=False, description="Move the middle of its bounds to the part's origin."
    )


class CtVolume(Section):
    """A CT volume, segmented at a threshold into a closed surface."""

    kind: Literal["ct"]
    path: Path = Field(description="NIfTI file, folder of one DICOM series, or InVesalius .inv3.")
    threshold_hu: Finite = Field(default=300.0, description="Bone is what lies above.")
    smoothing_mm: NonNegative = Field(
        default=0.0, description="Sigma of a Gaussian filter before the threshold."
    )
    smallest_part_cm3: NonNegative = Field(
        default=0.1,
        description="Connected pieces below this volume are left out: crumbs by default; a larger "
        "number leaves out a head rest or other things around the patient.",
    )
    centre: bool = Field(
        default=True, description="Move the middle of its bounds to the part's origin."
    )


Shape = Annotated[
    Skull | Sphere | Ellipsoid | Cylinder | Box | MeshFile | CtVolume, Field(discriminator="kind")
]


class Part(Section):
    """One body of one material. Where parts overlap the later one wins."""

    name: str = Field(default="", description="Shown in messages; the kind of shape where empty.")
    shape: Shape = Field(description="Its shape.")
    material: str | Composition = Field(
        default="bone",
        description="A name, or a composition with its density.",
        json_schema_extra=facts(source="attenuation: xraylib"),
    )
    position_mm: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Origin in the specimen's frame."
    )
    rotation_deg: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Extrinsic rotations about x, y, z."
    )

    @property
    def specimen_from_part(self) -> Pose:
        """Pose of the part in the specimen's frame."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)

    @property
    def label(self) -> str:
        """What messages call it."""
        return self.name or self.shape.kind


class Specimen(Section):
    """What is imaged, and where it stands."""

    parts: tuple[Part, ...] = Field(min_length=1, description="Bodies, each of one material.")
    position_mm: Vector = Field(default=(0.0, 0.0, 0.0), description="Origin in the world.")
    rotation_deg: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Extrinsic rotations about x, y, z."
    )

    @property
    def world_from_specimen(self) -> Pose:
        """Pose of the specimen where it stands."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)


ARMS = ("ur10e", "lbr_iiwa14")
"""Arms that are built in."""


class Arm(Section):
    """One arm and what it carries."""

    model: str = Field(
        default="ur10e",
        description="ur10e, lbr_iiwa14, or menagerie:NAME.",
        json_schema_extra=facts(source="makers' data sheets: docs/arms.md")
        | {"pattern": r"^(ur10e|lbr_iiwa14|menagerie:[A-Za-z0-9_]+)$"},
    )
    base_position_mm: Vector = Field(description="Origin of the arm's base in the world.")
    base_rotation_deg: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Extrinsic rotations of the base about x, y, z."
    )
    standoff_mm: Positive = Field(
        default=150.0,
        description="From flange to focal spot, or to panel centre, along the flange axis.",
    )
    tool_rotation_deg: Finite = Field(
        default=0.0, description="Turn of the tool about the flange axis when it was mounted."
    )
    tool_mass_kg: Positive = Field(description="Mass of the tool.")
    torque_scale: float = Field(
        default=1.0,
        gt=0,
        le=1,
        description="Share of the published torque limits that may be used.",
        json_schema_extra=facts(source="limits: the maker's"),
    )
    speed_scale: float = Field(
        default=0.5,
        gt=0,
        le=1,
        description="Share of the published joint speeds that a move may use.",
        json_schema_extra=facts(source="limits: the maker's"),
    )
    joint_speed_deg_s: Positive = Field(
        default=90.0,
        description="Limit of every joint's speed, for a Menagerie model: those state none.",
    )

    @field_validator("model")
    @classmethod
    def _known_model(cls, model: str) -> str:
        menagerie, colon, name = model.partition(":")
        if model in ARMS or (menagerie == "menagerie" and re.fullmatch(r"\w+", name)):
            return model
        near = difflib.get_close_matches(model, ARMS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near and not colon else ""
        raise ValueError(
            f"{model!r} is no arm{hint} (known: {', '.join(ARMS)}, and menagerie:NAME for one of "
            "MuJoCo Menagerie)"
        )


class SourceArm(Arm):
    """The arm with the X-ray source."""

    base_position_mm: Vector = Field(
        default=(850.0, 0.0, 0.0), description="Origin of the arm's base in the world."
    )
    base_rotation_deg: Vector = Field(
        default=(0.0, 0.0, 180.0), description="Extrinsic rotations of the base about x, y, z."
    )
    tool_mass_kg: Positive = Field(default=8.0, description="Mass of the X-ray source.")


class DetectorArm(Arm):
    """The arm with the panel."""

    base_position_mm: Vector = Field(
        default=(-850.0, 0.0, 0.0), description="Origin of the arm's base in the world."
    )
    tool_mass_kg: Positive = Field(default=4.0, description="Mass of the panel.")


class Table(Section):
    """The table and the post that carries the specimen."""

    present: bool = Field(default=True, description="Whether there is a table.")
    size_mm: Lengths = Field(default=(500.0, 900.0, 50.0), description="Top plate along x, y, z.")
    top_z_mm: Finite = Field(default=-450.0, description="Height of the upper face of the plate.")
    holder_radius_mm: Positive = Field(
        default=30.0, description="Radius of the specimen holder's post."
    )


class Cell(Section):
    """The operating room: two arms, table, floor."""

    source_arm: SourceArm = Field(default=SourceArm(), description="The arm with the X-ray source.")
    detector_arm: DetectorArm = Field(default=DetectorArm(), description="The arm with the panel.")
    table: Table = Field(default=Table(), description="The table.")
    floor_z_mm: Finite = Field(default=-1200.0, description="Height of the floor.")
    timestep_ms: float = Field(
        default=2.0, gt=0, le=10, description="Step of the dynamic simulation."
    )


class InverseKinematics(Section):
    """When a joint configuration counts as solved."""

    position_tolerance_mm: Positive = Field(
        default=0.1,
        description="Distance from the target at which an end-effector counts as there.",
        json_schema_extra=facts(source="the paper"),
    )
    rotation_tolerance_deg: Positive = Field(
        default=0.05, description="Angle from the target at which an end-effector counts as there."
    )
    max_iterations: int = Field(
        default=200, ge=1, description="Steps of the solver before it gives up."
    )


class Motion(Section):
    """How the arms get from view to view, and when the image is taken."""

    ik: InverseKinematics = Field(
        default=InverseKinematics(), description="The inverse kinematics."
    )
    trigger: Literal["on_entry", "settled"] = Field(
        default="on_entry",
        description="on_entry: first step with both end-effectors within the tolerance, still "
        "moving; settled: at rest.",
        json_schema_extra=facts(source="the paper"),
    )
    tolerance_mm: Positive = Field(
        default=1.0,
        description="Distance at which a target counts as reached.",
        json_schema_extra=facts(source="the paper"),
    )
    clearance_mm: NonNegative = Field(
        default=10.0, description="Smallest gap between bodies that a plan may have."
    )
    acceleration_deg_s2: Positive = Field(default=300.0, description="Largest joint acceleration.")
    jerk_deg_s3: Positive = Field(default=5000.0, description="Largest joint jerk.")
    settle_speed_mm_s: Positive = Field(
        default=0.05, description="Speed of both end-effectors below which they count as at rest."
    )
    timeout_s: Positive = Field(
        default=10.0, description="Simulated time in which a move must arrive."
    )


class PositionNoise(Section):
    """Normal noise for each axis, redrawn beyond the cut-off."""

    sigma_mm: NonNegative = Field(
        default=0.1,
        description="Standard deviation for each axis.",
        json_schema_extra=facts(source="the paper"),
    )
    cutoff_mm: Positive = Field(
        default=0.15,
        description="Largest deviation on each axis.",
        json_schema_extra=facts(source="the paper: repeatability"),
    )


class Uncertainty(Section):
    """What separates the believed poses from the executed ones."""

    source: PositionNoise = Field(
        default=PositionNoise(),
        description="Of the source's position.",
        json_schema_extra=facts(source="the paper"),
    )
    detector: PositionNoise = Field(
        default=PositionNoise(),
        description="Of the panel's position.",
        json_schema_extra=facts(source="the paper"),
    )


class Scenario(Section):
    """Everything one simulation needs."""

    name: str = Field(
        default="scan", min_length=1, description="Names the scan in the report and in messages."
    )
    description: str = Field(default="", description="What the scan is for; the report shows it.")
    seed: int = Field(default=0, ge=0, lt=2**63, description="Every random draw is keyed by it.")
    source: Source = Field(default=Source(), description="The X-ray source.")
    detector: Detector = Field(default=Detector(), description="The flat panel.")
    trajectory: Trajectory = Field(description="Where source and panel shall go.")
    specimen: Specimen = Field(description="What is imaged.")
    cell: Cell = Field(default=Cell(), description="The room and the arms.")
    motion: Motion = Field(default=Motion(), description="How the arms move.")
    uncertainty: Uncertainty = Field(
        default=Uncertainty(), description="What the reported poses are off by."
    )
    reconstruction: Reconstruction = Field(
        default=Reconstruction(), description="How the volume is made."
    )

    @model_validator(mode="after")
    def _sections_go_together(self) -> Scenario:
        found = (self._photon_number(), self._subsets(), self._something_to_correct())
        if conflicts := [conflict for conflict in found if conflict is not None]:
            raise ConflictError(*conflicts)
        return self

    def _photon_number(self) -> Conflict | None:
        quantum = self.detector.noise is not None and self.detector.noise.kind == "quantum"
        tube = isinstance(self.source.spectrum, TubeSpectrum)
        if not quantum or tube or self.source.photons_per_mm2_mas is not None:
            return None
        return Conflict(
            "detector.noise of kind 'quantum' needs a photon number: give "
            "source.photons_per_mm2_mas, or a source.spectrum of kind 'tube'",
            ("detector.noise", "source.photons_per_mm2_mas", "source.spectrum"),
        )

    def _subsets(self) -> Conflict | None:
        views = getattr(self.trajectory, "views", None)
        subsets = self.reconstruction.subsets
        if views is None or subsets is None or subsets <= views:
            return None
        return Conflict(
            f"reconstruction.subsets ({subsets}) must be at most trajectory.views ({views})",
            ("reconstruction.subsets", "trajectory.views"),
        )

    def _something_to_correct(self) -> Conflict | None:
        if self.reconstruction.beam_hardening is None or self.source.spectrum is not None:
            return None
        return Conflict(
            "reconstruction.beam_hardening needs a source.spectrum: a beam of one energy, as here, "
            "does not harden",
            ("reconstruction.beam_hardening", "source.spectrum"),
        )

    def resolved(self) -> str:
        """The whole scenario, defaults included, as canonical JSON."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))

    def digest(self) -> str:
        """SHA-256 of what the scan depends on; a file counts by its content, not by its place.

        Name, description and reconstruction are left out: they may change without a new scan.
        """
        data = self.model_dump(mode="json", exclude={"name", "description", "reconstruction"})
        text = json.dumps(_with_contents(data), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def files(self) -> dict[str, Path]:
        """Files and folders the scenario names, by key."""
        files = {}
        if isinstance(self.trajectory, FileTrajectory):
            files["trajectory.path"] = self.trajectory.path
        for i, part in enumerate(self.specimen.parts):
            if isinstance(part.shape, MeshFile | CtVolume):
                files[f"specimen.parts.{i}.shape.path"] = part.shape.path
        chain = {
            "source.spectrum": self.source.spectrum,
            "source.focal_spot": self.source.focal_spot,
            "detector.response": self.detector.response,
            "detector.point_spread": self.detector.point_spread,
            "detector.bad_pixels": self.detector.bad_pixels,
        }
        for key, section in chain.items():
            path = getattr(section, "path", None)
            if path is not None:
                files[f"{key}.path"] = path
        return files


def _with_contents(data: object) -> object:
    if isinstance(data, dict):
        return {
            key: _content_digest(Path(value)) if key == "path" else _with_contents(value)
            for key, value in data.items()
        }
    if isinstance(data, list):
        return [_with_contents(value) for value in data]
    return data


def _content_digest(path: Path) -> str:
    digest = hashlib.sha256()
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for file in files:
        with file.open("rb") as stream:
            digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()
