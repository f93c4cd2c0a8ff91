"""Specimen and its pose."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import Field, model_validator

from twinct.core.extensions import Registry
from twinct.core.foreign_text import quoted
from twinct.core.settings import (
    Conflict,
    ConflictError,
    Finite,
    Length,
    Lengths,
    NonNegative,
    OneOf,
    Positive,
    ReadBy,
    Section,
    Vector,
    complete,
    kind_of,
    setting,
)
from twinct.geometry import Pose
from twinct.specimen.part_kinds import PartKind
from twinct.specimen.sections.body_motion import BodyMotion
from twinct.specimen.sections.composition import Composition
from twinct.specimen.sections.grey_volume import GreyVolume, HuLine

Scale = Annotated[float, Field(gt=0, le=1000)]


class Skull(Section):
    """Built-in adult skull, made of implicit surfaces."""

    kind: Literal["skull"]
    scale: Scale = setting(1.0, "1 is adult size.")
    mesh_resolution_mm: Length = setting(
        1.0, "Cell edge of the lattice on which the surface mesh is extracted."
    )


class Head(Section):
    """Soft tissue around the built-in skull at the same place, down to the chin, with airways."""

    kind: Literal["head"]
    scale: Scale = setting(1.0, "1 is adult size.")
    mesh_resolution_mm: Length = setting(
        2.0, "Cell edge of the lattice on which the surface mesh is extracted."
    )


class Brain(Section):
    """Content of the built-in skull's braincase, at the same place; list it before the skull."""

    kind: Literal["brain"]
    scale: Scale = setting(1.0, "1 is adult size.")
    mesh_resolution_mm: Length = setting(
        2.0, "Cell edge of the lattice on which the surface mesh is extracted."
    )


ROUND_MESH = "Longest edge of the surface mesh's triangles; null: 81,920 triangles."


class Sphere(Section):
    """A sphere about the part's origin."""

    kind: Literal["sphere"]
    radius_mm: Length = Field(description="Radius.")
    mesh_resolution_mm: Length | None = setting(None, ROUND_MESH)


class Ellipsoid(Section):
    """An ellipsoid along the part's axes."""

    kind: Literal["ellipsoid"]
    semi_axes_mm: Lengths = Field(description="Semi-axes along x, y, z.")
    mesh_resolution_mm: Length | None = setting(None, ROUND_MESH)


class Cylinder(Section):
    """A cylinder along the part's z axis, centred."""

    kind: Literal["cylinder"]
    radius_mm: Length = Field(description="Radius.")
    height_mm: Length = Field(description="Height.")


class Box(Section):
    """A box along the part's axes, centred."""

    kind: Literal["box"]
    size_mm: Lengths = Field(description="Edges along x, y, z.")


class BallHelix(Section):
    """Balls on a helix about the part's z axis, for calibration."""

    kind: Literal["ball_helix"]
    balls: int = setting(64, "Number of balls.", ge=8, le=1000)
    ball_radius_mm: Length = setting(1.5, "Radius of each ball.")
    radius_mm: Length = setting(70.0, "Radius of the helix.")
    height_mm: Length = setting(
        140.0, "Height from the centre of the first ball to that of the last."
    )
    turns: Positive = setting(
        4.3, "Turns of the helix; a whole number would place balls directly above one another."
    )
    tolerance_mm: NonNegative = setting(
        0.0,
        "Standard deviation of each centre along each axis; a calibration uses the nominal "
        "positions.",
    )
    tolerance_seed: int = setting(
        0, "Seed of these deviations; each seed gives another phantom.", ge=0, lt=2**63
    )
    mesh_resolution_mm: Length = setting(0.2, "Longest edge of a ball's triangles.")


class MeshFile(Section):
    """A watertight triangle mesh: STL, PLY, OBJ or OFF."""

    kind: Literal["mesh"]
    path: Path = Field(description="Mesh file.")
    unit_mm: Length = setting(1.0, "Length of the file's unit.")
    centre: bool = setting(False, "Move the centre of its bounding box to the part's origin.")


class CtVolume(Section):
    """A CT volume, segmented at a threshold into a closed surface."""

    kind: Literal["ct"]
    path: Path = Field(
        description="NIfTI or MetaImage file, folder of one DICOM series, or InVesalius .inv3 file."
    )
    hu: HuLine | None = setting(
        None,
        "Linear conversion of the file's values, after the file's own rescaling, to HU; null: the "
        "values are HU, and a file whose values cannot be HU is refused.",
    )
    threshold_hu: Finite = setting(300.0, "Everything above this value is bone.")
    smoothing_mm: NonNegative = setting(0.0, "Sigma of a Gaussian filter before the threshold.")
    smallest_part_cm3: NonNegative = setting(
        0.1,
        "Connected pieces below this volume are left out. The default drops crumbs; a larger "
        "value also drops a head rest or other objects around the patient.",
    )
    centre: bool = setting(True, "Move the centre of its bounding box to the part's origin.")


_BUILT_IN = (
    Skull,
    Head,
    Brain,
    Sphere,
    Ellipsoid,
    Cylinder,
    Box,
    BallHelix,
    MeshFile,
    CtVolume,
    GreyVolume,
)


@cache
def part_kinds() -> Registry[PartKind]:
    """Return the kinds of part that other packages offer; they are looked up once per process."""
    built_in = {kind_of(shape) for shape in _BUILT_IN}
    known = Registry("twinct.parts", PartKind, {}, taken=built_in)
    known.keep(lambda kind: complete(kind.settings), "the settings of {name}")
    return known


def _shapes() -> Any:
    return Annotated[
        Union[(*_BUILT_IN, *(kind.settings for kind in part_kinds().values()))],  # noqa: UP007
        Field(discriminator="kind"),
    ]


if TYPE_CHECKING:
    Shape = (
        Skull
        | Head
        | Brain
        | Sphere
        | Ellipsoid
        | Cylinder
        | Box
        | BallHelix
        | MeshFile
        | CtVolume
        | GreyVolume
    )
else:
    Shape = Annotated[Section, OneOf(_shapes)]


GREY = (GreyVolume,)
"""Shapes of grey voxels."""


class Part(Section):
    """One body of one material, or of grey voxels. Where parts overlap, the later one wins."""

    name: str = setting("", "Name in messages; empty: the kind of its shape.")
    shape: Annotated[Shape, ReadBy("surface")] = Field(description="Shape of the part.")
    material: str | Composition = setting(
        "bone",
        "A name, or a composition with its density. Figures of a grey part are relative to it.",
        source="attenuation: xraylib",
        read_by="images",
    )
    position_mm: Vector = setting(
        (0.0, 0.0, 0.0), "Origin in the specimen's frame.", read_by="surface"
    )
    rotation_deg: Vector = setting(
        (0.0, 0.0, 0.0), "Extrinsic rotations about x, y, z.", read_by="surface"
    )

    @property
    def specimen_from_part(self) -> Pose:
        """Pose of the part in the specimen's frame."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)

    @property
    def homogeneous(self) -> bool:
        """True for a body of one material, False for voxels of several."""
        if isinstance(self.shape, GREY):
            return False
        kind = part_kinds().get(self.shape.kind)
        return kind is None or kind.voxels is None

    @property
    def own_rays(self) -> bool:
        """True if it is cast by rays of its own, False if X-ray engines render its surface."""
        kind = part_kinds().get(self.shape.kind)
        return not self.homogeneous or (kind is not None and kind.solid is not None)

    @property
    def made_of(self) -> str:
        """Name of what it is made of."""
        if not self.homogeneous:
            return "grey voxels"
        return self.material if isinstance(self.material, str) else "own material"

    @property
    def label(self) -> str:
        """Name of the part in messages."""
        return self.name or self.shape.kind


class OpenNames(list[str]):
    """Names of parts and labels where files of labels state further names: any name may be one."""

    def __contains__(self, _: object) -> bool:
        """Return True: the built specimen checks names."""
        return True


class Specimen(Section):
    """Specimen and its pose."""

    parts: tuple[Part, ...] = setting(
        (), "Bodies, each of one material or of grey voxels; at least one."
    )
    reference: str = setting(
        "",
        "Name of the part, or of the label of a grey part, to whose attenuation figures are "
        "relative; empty: the largest part.",
        read_by="volume",
    )
    position_mm: Vector = setting((0.0, 0.0, 0.0), "Origin in the world.", read_by="plan")
    rotation_deg: Vector = setting(
        (0.0, 0.0, 0.0), "Extrinsic rotations about x, y, z.", read_by="plan"
    )

    safety_mm: NonNegative = setting(
        0.0,
        "Gap that the arms keep from the specimen's convex bodies in addition to "
        "motion.clearance_mm, as from a patient's skin. Clearances in reports leave it out.",
        read_by="plan",
    )
    motion: BodyMotion | None = setting(
        None, "Motion of a grey part, such as breathing; null: it stands still.", read_by="surface"
    )

    @model_validator(mode="after")
    def _some_parts(self) -> Specimen:
        if not self.parts:
            raise ConflictError(Conflict("parts must have at least 1 entry", ("parts",)))
        return self

    @model_validator(mode="after")
    def _reference_is_a_part(self) -> Specimen:
        names = self.names
        if self.reference and self.reference not in names:
            names_in_words = quoted(self.reference), quoted(names, 300)
            message = "reference: no part is called {}; the parts are {}".format(*names_in_words)
            raise ConflictError(Conflict(message, ("reference",)))
        return self

    @model_validator(mode="after")
    def _motion_has_a_part(self) -> Specimen:
        if self.motion is None:
            return self
        greys = [part for part in self.parts if not part.homogeneous]
        named = [part for part in greys if self.motion.part in ("", part.label)]
        if len(named) != 1:
            message = "motion.part: {} is not the name of one grey part; the grey parts are {}"
            names_in_words = quoted(self.motion.part), quoted([part.label for part in greys], 300)
            raise ConflictError(Conflict(message.format(*names_in_words), ("motion",)))
        shape = named[0].shape
        if self.motion.kind == "fields" and isinstance(shape, GreyVolume) and shape.centre:
            message = "motion: fields are in the frame of the CT, so that its part needs {}"
            raise ConflictError(Conflict(message.format("shape.centre: false"), ("motion",)))
        return self

    @property
    def moving_part(self) -> Part:
        """Part that moves, if there is a motion."""
        assert self.motion is not None
        name = self.motion.part
        return next(p for p in self.parts if not p.homogeneous and name in ("", p.label))

    @property
    def names(self) -> list[str]:
        """Names of all parts and labels; if files or a phantom state some, every name is in it."""
        greys = [part.shape for part in self.parts if isinstance(part.shape, GreyVolume)]
        sections = [grey.labels for grey in greys]
        labels = [part.label for part in self.parts]
        labels += [name for section in sections if section for name in section.names]
        is_open = any(grey.phantom or (grey.labels and not grey.labels.names) for grey in greys)
        return OpenNames(labels) if is_open else labels

    @property
    def world_from_specimen(self) -> Pose:
        """Pose of the specimen in the world."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)
