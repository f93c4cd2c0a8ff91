"""Grey parts: CT volumes whose voxels are mixtures, and the calibration of their values."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from twinct.core.settings import (
    Finite,
    NonNegative,
    Positive,
    Section,
    setting,
)
from twinct.specimen.sections.composition import Composition


class HuLine(Section):
    """Conversion of a file's values to HU: slope times value plus intercept."""

    slope: Finite = setting(1.0, "HU per unit of the file's values, not 0.")
    intercept: Finite = setting(0.0, "HU of the value 0.")

    @field_validator("slope")
    @classmethod
    def _rises_or_falls(cls, slope: float) -> float:
        if slope == 0:
            raise ValueError("must not be 0, which makes all values equal")
        return slope


class Tissues(Section):
    """HU are converted to tissues, from lung to cortical bone, for the scanner's tube voltage."""

    kind: Literal["tissues"]
    kv: Literal[80, 100, 120, 140] = setting(
        120,
        "Tube voltage of the CT scanner.",
        source="tissues: Schneider et al., Phys. Med. Biol. 45 (2000) 459",
    )
    energy_kev: Annotated[Positive, Field(ge=30, le=150)] | None = setting(
        None,
        "Photon energy at which HU are defined relative to water; null: the effective energy of "
        "the tube voltage.",
    )


class TableRow(Section):
    """One material at one density, and its HU."""

    hu: Finite = Field(description="HU on the scanner.")
    density_g_cm3: NonNegative = Field(description="Density; 0: no attenuation.")
    material: str | Composition = Field(description="A name, or a composition.")


class TissueTable(Section):
    """A table of your own; between two rows, voxels are mixtures by volume."""

    kind: Literal["table"]
    rows: tuple[TableRow, ...] = Field(
        min_length=2, max_length=200, description="Rows with rising HU; the first is for air."
    )

    @field_validator("rows")
    @classmethod
    def _rises(cls, rows: tuple[TableRow, ...]) -> tuple[TableRow, ...]:
        for i, (one, following) in enumerate(pairwise(rows)):
            if not one.hu < following.hu:
                raise ValueError(
                    f"row {i + 1} has {following.hu:g} HU after {one.hu:g}; HU must rise"
                )
        if rows[-1].density_g_cm3 == 0:
            raise ValueError("the last row must have a density above 0")
        if rows[-1].hu <= -1000:
            raise ValueError("the last row must have more than -1000 HU")
        return rows


class ElectronDensities(Section):
    """Measured curve of a scanner's electron density; the kind ``tissues`` supplies the tissues."""

    kind: Literal["electron_density"]
    points: tuple[tuple[Finite, NonNegative], ...] = Field(
        min_length=2,
        max_length=200,
        description="Pairs of HU and electron density relative to water, both rising.",
    )

    @field_validator("points")
    @classmethod
    def _rises(cls, points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for one, following in pairwise(points):
            if not (one[0] < following[0] and one[1] < following[1]):
                raise ValueError(f"{list(following)} follows {list(one)}; both must rise")
        return points


class AttenuationValues(Section):
    """The file's values are attenuation, not HU; the kind ``tissues`` supplies the tissues."""

    kind: Literal["attenuation"]
    energy_kev: Annotated[Positive, Field(ge=30, le=150)] = Field(
        description="Photon energy of the values."
    )
    unit: Literal["1/mm", "1/cm"] = setting("1/mm", "Unit of the values.")


Calibration = Tissues | TissueTable | ElectronDensities | AttenuationValues


class Labels(Section):
    """Named labels of voxels, on the grid of the CT, as TotalSegmentator writes them."""

    path: Path = Field(
        description="NIfTI file of whole numbers, or a folder of one NIfTI mask for each name."
    )
    names: dict[str, Annotated[int, Field(ge=1, le=65535)]] = setting(
        {}, "Number of each name; {}: the file's own names, or else label_1, label_2, ..."
    )


class Mask(Section):
    """Voxels that count, on the grid of the CT."""

    path: Path = Field(description="NIfTI file; values above 0 count.")


class GreyVolume(Section):
    """Grey values of a CT or of the phantom: every voxel is a mixture of a few basis materials."""

    kind: Literal["volume"]
    path: Path | None = setting(
        None,
        "NIfTI or MetaImage file, folder of one DICOM series, or InVesalius .inv3 file; null: the "
        "phantom.",
    )
    phantom: Literal["head", "trunk"] | None = setting(
        None, "Instead of path: the built-in grey phantom, with its labels."
    )
    voxel_mm: Annotated[float, Field(ge=0.3, le=20)] = setting(1.0, "Voxel edge of the phantom.")
    seed: int = setting(
        0, "Seed of the phantom's texture, lesions and branches of vessels.", ge=0, lt=2**63
    )
    hu: HuLine | None = setting(
        None,
        "Linear conversion of the file's values, after the file's own rescaling, to HU; null: the "
        "values are HU, and a file whose values cannot be HU is refused.",
    )
    calibration: Annotated[Calibration, Field(discriminator="kind")] = setting(
        Tissues(kind="tissues"), "Meaning of the values."
    )
    edges: Literal["soft", "sharp"] = setting(
        "soft",
        "Material between voxel centres. soft: linear interpolation. sharp: the volume fractions "
        "of the rows of a table are interpolated, and each point has the material of the row with "
        "the largest fraction.",
    )
    above_hu: Finite | None = setting(
        None, "Voxels up to this value are left out; null: only those without attenuation."
    )
    keep: Literal["all", "body", "labelled"] = setting(
        "all",
        "Voxels that count: all; the largest connected body above surface_hu with its cavities, "
        "without couch and head rest; or those with a label.",
    )
    mask: Mask | None = setting(None, "File of the voxels that count.")
    labels: Labels | None = setting(None, "File of named labels, for regions and figures.")
    surface_hu: Finite = setting(
        -300.0, "Value on the skin: the surface for pictures, sizes and collisions."
    )
    interpolate_slices: bool = setting(
        False,
        "Interpolate unevenly spaced slices of a DICOM series; otherwise such a series is refused.",
    )
    extend_mm: NonNegative = setting(
        0.0, "Length by which the first and the last slice are repeated beyond the ends of the CT."
    )
    centre: bool = setting(True, "Move the centre of the skin's bounding box to the part's origin.")

    @model_validator(mode="after")
    def _consistent(self) -> GreyVolume:
        if (self.path is None) == (self.phantom is None):
            problem = "are both null" if self.path is None else "exclude each other"
            raise ValueError(f"path and phantom {problem}: give one")
        if self.phantom:
            self._fits_a_phantom()
        elif wrong := [n for n in ("seed", "voxel_mm") if getattr(self, n) != _default(n)]:
            raise ValueError(f"{' and '.join(wrong)}: only allowed with phantom")
        if self.edges == "sharp" and self.calibration.kind != "table":
            raise ValueError("edges: sharp needs a calibration of kind table, whose rows are pure")
        if self.keep == "labelled" and not self.labelled:
            raise ValueError("keep: labelled needs labels")
        if self.hu is not None and self.calibration.kind == "attenuation":
            raise ValueError("hu is a line to HU, but the calibration states attenuation values")
        return self

    def _fits_a_phantom(self) -> None:
        """Raise if a key describes a file."""
        given = {"hu": self.hu, "mask": self.mask, "labels": self.labels}
        wrong = [name for name, value in given.items() if value is not None]
        if self.interpolate_slices:
            wrong.append("interpolate_slices")
        if wrong:
            raise ValueError(f"{' and '.join(wrong)}: only allowed with path, not with a phantom")
        if self.calibration.kind == "attenuation":
            raise ValueError("the phantom's values are HU, but the calibration states attenuation")

    @property
    def labelled(self) -> bool:
        """True if voxels have labels."""
        return self.labels is not None or self.phantom is not None

    @property
    def source(self) -> str:
        """File or phantom, for messages."""
        return f"the {self.phantom} phantom" if self.phantom else f"CT volume {self.path}"


def _default(key: str) -> object:
    return GreyVolume.model_fields[key].default
