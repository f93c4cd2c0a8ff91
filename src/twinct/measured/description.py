"""Description of a measured scan: one YAML file that states images, geometry and conventions."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from twinct.core.files.boundary import library_errors
from twinct.core.settings import Finite, Positive, Section, setting
from twinct.measured.circle import Circle
from twinct.measured.joints import Joints
from twinct.measured.matrices import Matrices, Poses
from twinct.measured.nikon import Nikon
from twinct.measured.toolkits import Astra, Cil, Ctsimu, Leap, OpenCt, Rtk, Tigre
from twinct.measured.views import ImageFacts, StatedViews
from twinct.recon.sections.reconstruction import Grid
from twinct.scenario.messages import refusal
from twinct.scenario.reading import Draft, read_yaml

Axis = Literal["view", "row", "column"]
Range = tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=1)]]


class Files(Section):
    """Images in a file, in all files of a folder, or in those of a pattern such as ``a/*.tif``."""

    path: str = Field(description="File, folder, or pattern with * in its last part.")
    array: str = setting("", "Name of the array in an .npz, HDF5 or Zarr file.")
    series: str | int | None = setting(
        None, "Series in a folder of DICOM files: its number, description or UID."
    )
    axes: tuple[Axis, Axis, Axis] = setting(
        ("view", "row", "column"), "Order of the axes in an array, the slowest first."
    )
    dtype: str = setting("", "Number type of raw files, as numpy calls it, such as <u2 or <f4.")
    rows: int = setting(0, "Rows of an image in raw files.", ge=0)
    columns: int = setting(0, "Columns of an image in raw files.", ge=0)
    header_bytes: int = setting(0, "Bytes before the first number of each raw file.", ge=0)


class FieldImages(Files):
    """Flat or dark images; several are averaged."""

    view: Finite | None = setting(
        None, "View at which they were taken; between several, images are interpolated."
    )


class Air(Section):
    """Region of the stored images that no ray reaches through the object."""

    rows: Range = Field(description="First row, and the row after the last.")
    columns: Range = Field(description="First column, and the column after the last.")
    fall_off: bool = setting(
        False, "Divide by the beam's fall-off from the geometry first: flats or white lack it."
    )


class BadPixels(Section):
    """Pixels that do not count: filled by their neighbours' mean, and left out of the volume."""

    path: str | None = setting(None, "Image that is not 0 where a pixel is bad.")
    find: bool = setting(
        False, "Find them: pixels of the flat image, or of the mean image, unlike their neighbours."
    )


class Rings(Section):
    """Removal of rings: gains of single pixels, alike in all views of a turn.

    The mean line integral of all views, minus its median over ``width`` pixels along a row, is
    subtracted from each view (Boin and Haibel, Opt. Express 14 (2006) 12071). Details closer to the
    axis than half of ``width`` are lost.
    """

    width: int = setting(
        9, "Pixels of the moving median along a row, with which the mean view is compared.",
        ge=3, le=999,
    )  # fmt: skip

    @model_validator(mode="after")
    def _odd(self) -> Rings:
        if self.width % 2 == 0:
            raise ValueError(f"width: {self.width} must be odd, so that it has a middle")
        return self


class Lines(Section):
    """Evening of rows or columns, each by its own air in each view, if off by 4 standard errors."""

    along: Literal["rows", "columns"] = Field(description="Lines that differ.")
    kind: Literal["gain", "offset"] = setting(
        "gain", "Whether a line is too bright by a factor, or by a number added to all its pixels."
    )


class Crop(Section):
    """Pixels cut off the turned image at each side."""

    top: int = setting(0, "First rows.", ge=0)
    bottom: int = setting(0, "Last rows.", ge=0)
    left: int = setting(0, "First columns.", ge=0)
    right: int = setting(0, "Last columns.", ge=0)


class Images(Files):
    """Projections, and the way from the stored numbers to transmissions."""

    values: Literal["intensities", "transmissions", "line_integrals"] = Field(
        description="Quantity in the files."
    )
    flats: tuple[FieldImages, ...] = setting((), "Images without object.")
    darks: tuple[FieldImages, ...] = setting((), "Images without radiation.")
    white: Positive | None = setting(None, "Intensity without object, in place of flats.")
    black: Finite | None = setting(None, "Intensity without radiation, in place of darks.")
    air: Air | Literal["auto", "fall_off"] | None = setting(
        None, "Scale each view so that the mean transmission here is 1; auto: where all views are "
        "brightest, divided by the beam's fall-off if they show it; fall_off: divide by it only.",
    )  # fmt: skip
    dark_noise: Positive | None = setting(
        None, "Standard deviation of the dark image, in numbers of the files; null: from darks, or "
        "from values below 0.",
    )  # fmt: skip
    lag: float = setting(
        0.0, "Part of the image before that the detector still shows in each view (ghost).",
        ge=0, lt=0.5,
    )  # fmt: skip
    bad_pixels: BadPixels = setting(BadPixels(), "Bad pixels.")
    single_pixels: bool = setting(
        True, "Repair pixels that differ from all neighbours in row, column and view."
    )
    lines: Lines | None = setting(
        None, "Even rows or columns of the stored image, by their air in each view."
    )
    rings: Rings | None = setting(None, "Remove rings; the views must cover a turn.")
    transpose: bool = setting(False, "Exchange rows and columns first.")
    turn_deg: Literal[0, 90, 180, 270] = setting(0, "Then turn the image counterclockwise.")
    flip_rows: bool = setting(False, "Then reverse the order of rows.")
    flip_columns: bool = setting(False, "Then reverse the order of columns.")
    crop: Crop = setting(Crop(), "Then cut off pixels; the panel becomes smaller.")
    bin: int = setting(1, "Then average blocks of this many pixels along each axis.", ge=1, le=64)
    every: int = setting(1, "Take every nth view, n being this number.", ge=1)

    @model_validator(mode="after")
    def _corrections_fit(self) -> Images:
        given = [k for k in ("flats", "darks", "white", "black") if getattr(self, k)]
        if self.values == "line_integrals" and self.lag:
            raise ValueError("lag: not allowed with values: line_integrals, which do not add up")
        if self.values != "intensities" and given:
            raise ValueError(f"{', '.join(given)}: allowed only with values: intensities")
        if self.flats and self.white is not None:
            raise ValueError("flats and white: give one of them")
        if self.darks and self.black is not None:
            raise ValueError("darks and black: give one of them")
        if self.white is not None and self.black is not None and self.white <= self.black:
            raise ValueError(f"white: {self.white:g} must exceed black, {self.black:g}")
        if self.values == "intensities" and not (
            self.flats or self.white or self.air not in (None, "fall_off")
        ):
            raise ValueError(
                "values: intensities need flats (images without object), white (their intensity) "
                "or air (a region beside the object)"
            )
        for name, several in (("flats", self.flats), ("darks", self.darks)):
            if len(several) > 1 and any(one.view is None for one in several):
                raise ValueError(f"{name}: several entries need a view each")
        return self


AnyGeometry = Annotated[
    Circle | Matrices | Poses | Joints | Nikon | Rtk | Astra | Leap | Cil | Tigre | OpenCt | Ctsimu,
    Field(discriminator="kind"),
]


class Measured(Section):
    """A measured scan."""

    name: str = setting("measured", "Name of the scan in reports and messages.", min_length=1)
    description: str = setting("", "Origin of the scan; its report shows it.")
    images: Images = Field(description="Projections.")
    geometry: AnyGeometry = Field(description="Source and panel of each view.")
    grid: Grid | None = setting(
        None, "Voxels of the reconstruction; null: all that the views see, in voxels of a pixel."
    )
    scenario: dict[str, Any] = setting(
        {}, "Further sections of the scenario that are known, such as source and reconstruction."
    )

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views of all images.

        Raises:
            InputError: the geometry cannot be read, or does not fit the images.
        """
        with library_errors(f"{getattr(self.geometry, 'path', 'geometry')}: the geometry"):
            return self.geometry.views(facts)


def read_description(source: str | Path | Mapping[str, Any]) -> Measured:
    """Read and validate the description of a measured scan.

    Args:
        source: YAML file, or plain data. Paths in a file are relative to it.

    Raises:
        ScenarioError: with one sentence for each problem.
    """
    if isinstance(source, Mapping):
        draft = Draft(dict(source))
    else:
        draft = read_yaml(Path(source).expanduser(), "description of a measured scan")
    try:
        return Measured.model_validate_json(json.dumps(draft.data, default=str), strict=True)
    except ValidationError as error:
        raise refusal(draft, error, Measured) from None
