"""Sections ``file`` and ``acquisition`` of a CTSimU file, which list the images to write."""

from __future__ import annotations

from dataclasses import dataclass

from twinct.ctsimu.drifts import short
from twinct.ctsimu.ranges import COUNT, FIELDS, PLACE
from twinct.ctsimu.reader import JsonSection
from twinct.ctsimu.scene import DarkOrFlatImages

FORMAT = (1, 2)
"""Newest supported version of the file format; older ones down to 1.0 are subsets."""


@dataclass(frozen=True, eq=False)
class Acquisition:
    """Numbers of projections, of frames averaged per projection, and of dark and flat images."""

    frames: int
    average: int
    dark: DarkOrFlatImages
    flat: DarkOrFlatImages


def check_header(section: JsonSection) -> None:
    """Check the kind and version of the file."""
    section.skip("name", "description", "contact", "date_created", "date_changed")
    version = section.section("version")
    version.skip("major", "minor")
    kind = section.text("file_type")
    section.require("file_type")
    if kind is not None and kind != "CTSimU Scenario":
        section.problem("file_type", f"{short(kind)} is not 'CTSimU Scenario'")
    stated = section.section("file_format_version", needed=True)
    number = stated.whole("major", 0), stated.whole("minor", 0)
    if stated.data and not (1, 0) <= number <= FORMAT:
        section.problem(
            "file_format_version", f"{number[0]}.{number[1]} is not a version from 1.0 to 1.2"
        )


def read_acquisition(section: JsonSection) -> Acquisition:
    """Return the numbers of images from the section ``acquisition``; 1 in place of invalid ones."""
    section.require("number_of_projections")
    frames = section.whole("number_of_projections", 1, "", COUNT)
    average = section.whole("frame_average", 1, "", COUNT)
    dark, flat = (_fields(section.section(f"{kind}_field")) for kind in ("dark", "flat"))
    if flat.correction and not flat.number:
        section.problem("flat_field.correction", "needs flat_field.number of at least 1")
    return Acquisition(frames, average, dark, flat)


def read_turn(section: JsonSection) -> float:
    """Return the stage's angle about its w, degrees, from the section ``acquisition``."""
    start = section.number("start_angle", "deg", PLACE) or 0.0
    stop = section.number("stop_angle", "deg", PLACE) or 0.0
    if stop < start:
        section.problem("stop_angle", f"{stop:g} deg is less than start_angle {start:g} deg")
    direction = section.text("direction", ("CCW", "CW")) or "CCW"
    moment = section.moment
    steps = moment.frames - 1 if section.flag("include_final_angle", True) else moment.frames
    section.text("scan_mode", ("stop+go",))
    if section.number("scan_speed", "deg/s"):
        section.problem("scan_speed", "is not supported: the stage stops for every frame")
    angle = start + (stop - start) * moment.frame / steps if steps else start
    return -angle if direction == "CW" else angle


def _fields(section: JsonSection) -> DarkOrFlatImages:
    return DarkOrFlatImages(
        section.whole("number", 0, "", FIELDS),
        section.whole("frame_average", 1, "", COUNT),
        section.flag("ideal", False),
        section.flag("correction", False),
    )
