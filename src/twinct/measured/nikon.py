"""Circular scans of Nikon machines: the numbers of an .xtekct file.

Meaning of the keys as in CIL's reader (cil.io.NikonDataReader): the object turns clockwise by
AngularStep, columns run left and rows down, seen from the source; the axis is ObjectOffsetX left of
the line from the source to the panel's centre, and leans by ObjectRoll and ObjectTilt.
"""

from __future__ import annotations

import configparser
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.files.boundary import read_text
from twinct.core.foreign_text import number, quoted, shortened
from twinct.core.settings import Section, setting
from twinct.measured.circle import Angles, Circle
from twinct.measured.views import ImageFacts, StatedViews

_NEEDED = ("SrcToObject", "SrcToDetector", "DetectorPixelSizeX", "DetectorPixelSizeY")
_NEEDED += ("DetectorPixelsX", "DetectorPixelsY", "Projections", "AngularStep")
_USED = (
    *_NEEDED,
    *("InitialAngle", "ObjectOffsetX", "ObjectRoll", "ObjectTilt"),
    *("CentreOfRotationTop", "CentreOfRotationBottom", "WhiteLevel"),
)
_WITHOUT_EFFECT = (
    "Voxel Offset MaskRadius Coef Scattering Region Units Scale Output Input Derivative Filter "
    "Cut MedianFilter Xray Intensity Blanking Order Interpolation Timing Auto CTPro Version "
    "Product Name Operator Import Median Automatic Convert Extended Increment Modifier Slice Angle "
    "Flux Use Dim Reference BlackLevel Hu Air Normalisation AngularStep Helical Modifier Exponent "
    "Scaling TIFFScaling LowPercentile HighPercentile"
).split()
"""Beginnings of keys on the volume, the beam hardening and the software."""

_MATTER = ("DetectorOffsetX", "DetectorOffsetY", "DetectorAngle", "DetectorTilt", "HelicalPitch")
"""Keys with an effect on the geometry, whose signs no public reader agrees on."""


class Nikon(Section):
    """File of a Nikon machine."""

    kind: Literal["nikon"]
    path: Path = Field(description="The .xtekct file.")
    ignore: tuple[str, ...] = setting((), "Keys of the file that may be ignored.")

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: a key is missing, unknown, or does not fit the images.
        """
        keys = read_xtekct(self.path, self.ignore)
        where = f"{self.path}"
        pixels = int(keys["DetectorPixelsY"]), int(keys["DetectorPixelsX"])
        panel = facts.panel((keys["DetectorPixelSizeX"], keys["DetectorPixelSizeY"]))
        if pixels != panel.shape:
            raise InputError(
                f"{where}: states {pixels[0]} x {pixels[1]} pixels (rows x columns), but the "
                f"images have {panel.rows} x {panel.columns}"
            )
        facts.require(where, int(keys["Projections"]))
        sod, sdd = keys["SrcToObject"], keys["SrcToDetector"]
        top, bottom = keys.get("CentreOfRotationTop", 0.0), keys.get("CentreOfRotationBottom", 0.0)
        roll = -math.degrees(math.atan2(top - bottom, pixels[0] * panel.pitch_v))
        step = keys["AngularStep"]
        circle = Circle(
            kind="circle",
            sod_mm=sod,
            sdd_mm=sdd,
            pitch_mm=(panel.pitch_u, panel.pitch_v),
            angles=Angles(
                values=tuple(keys.get("InitialAngle", 0) + step * np.arange(facts.views))
            ),
            rotates="object",
            direction="clockwise",
            columns="left",
            axis_offset_mm=-keys.get("ObjectOffsetX", (top + bottom) / 2 * sod / sdd),
            axis_roll_deg=keys.get("ObjectRoll", roll),
            axis_tilt_deg=keys.get("ObjectTilt", 0.0),
        )
        views = circle.views(facts)
        return StatedViews(
            views.geometry, views.flip_rows, views.flip_columns, notes=(where, *views.notes)
        )


def read_xtekct(path: Path, ignore: tuple[str, ...] = ()) -> dict[str, float]:
    """Return the numbers of an .xtekct file that matter, by key.

    Raises:
        InputError: a key is missing or no number, or one that may matter is not known.
    """
    text = read_text(path, f"{path}", 2**20)
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[method-assign, assignment]
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise InputError(f"{path}: not an .xtekct file: {str(error).splitlines()[0]}") from None
    if "XTekCT" not in parser:
        raise InputError(f"{path}: not an .xtekct file: it has no section [XTekCT]")
    section = dict(parser["XTekCT"])
    problems = [f"{path}: the key {key} is missing" for key in _NEEDED if key not in section]
    problems += [f"{path}: {what}" for what in _unknown(section, ignore)]
    numbers: dict[str, float] = {}
    for key in _USED:
        if key in section:
            try:
                numbers[key] = number(section[key])
                if not math.isfinite(numbers[key]):
                    raise ValueError
            except ValueError:
                problems.append(f"{path}: {key} is {quoted(section[key])}, not a finite number")
    if problems:
        raise InputError(problems)
    return numbers


def _unknown(section: Mapping[str, str], ignore: tuple[str, ...]) -> list[str]:
    """Return a sentence for each key that may matter and is not read."""
    unknown: list[str] = []
    for key, text in section.items():
        if key in _USED or key in ignore or _is_zero(text):
            continue
        if key in _MATTER or not key.startswith(tuple(_WITHOUT_EFFECT)):
            if key in _MATTER or _is_number(text):
                unknown.append(
                    f"{shortened(key, 80)} is {quoted(text)}, and may matter, but is not read: "
                    "state the geometry as kind: circle, or name the key in geometry.ignore"
                )
    return unknown


def _is_number(text: str) -> bool:
    try:
        number(text)
    except ValueError:
        return False
    return True


def _is_zero(text: str) -> bool:
    return _is_number(text) and number(text) == 0
