"""Circular scans of Nikon machines: the geometry of an .xtekct file and its files of angles.

Meaning of the keys as in CIL's reader (cil.io.NikonDataReader): the object turns clockwise by
AngularStep, columns run left and rows down, seen from the source; the axis is ObjectOffsetX left of
the line from the source to the panel's centre, and leans by ObjectRoll and ObjectTilt. CIL leaves
``_ctdata.txt`` and ``.ang`` unread; their meaning is that of CCPi's XtekReader and of TIGRE: angles
of the stage, those in ``.ang`` in the reverse order.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.settings import Section, setting
from twinct.geometry import Floats
from twinct.measured.angle_files import read_angles
from twinct.measured.circle import Angles, Circle
from twinct.measured.views import ImageFacts, StatedViews
from twinct.measured.xtekct import Xtekct, read_xtekct

APART = 0.5
"""Pixels by which two statements on the axis may differ."""


class Nikon(Section):
    """File of a Nikon machine."""

    kind: Literal["nikon"]
    path: Path = Field(description="The .xtekct file.")
    ignore: tuple[str, ...] = setting((), "Keys of the file that are treated as absent.")
    angles: Literal["files", "steps"] = setting(
        "files",
        "Angles from _ctdata.txt or the .ang file beside it, if there is one, or from AngularStep.",
    )

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: a key or an angle is missing, or does not fit the images.
        """
        file = read_xtekct(self.path, self.ignore)
        keys, where = file.numbers, f"{self.path}"
        panel = facts.panel((keys["DetectorPixelSizeX"], keys["DetectorPixelSizeY"]))
        stated = int(keys["DetectorPixelsY"]), int(keys["DetectorPixelsX"])
        if stated != panel.shape:
            raise InputError(
                f"{where}: states {stated[0]} x {stated[1]} pixels (rows x columns), but the "
                f"images have {panel.rows} x {panel.columns}"
            )
        facts.require(where, int(keys["Projections"]))
        axis, doubts = _axis(file, panel.rows)
        angles, of_angles, of_steps = self._angles(file)
        circle = Circle(
            kind="circle",
            sod_mm=keys["SrcToObject"],
            sdd_mm=keys["SrcToDetector"],
            pitch_mm=(panel.pitch_u, panel.pitch_v),
            angles=Angles(values=tuple(angles.tolist())),
            rotates="object",
            direction="clockwise",
            columns="left",
            axis_offset_mm=-axis[0],
            axis_roll_deg=axis[1],
            axis_tilt_deg=keys.get("ObjectTilt", 0.0),
        )
        views = circle.views(facts)
        notes = where, *file.notes, *of_angles, *views.notes
        flips = views.flip_rows, views.flip_columns
        return StatedViews(views.geometry, *flips, notes=notes, doubts=(*doubts, *of_steps))

    def _angles(self, file: Xtekct) -> tuple[Floats, list[str], list[str]]:
        """Return the angle of each view, deg, and notes and doubts on them."""
        first, step = file.numbers.get("InitialAngle", 0.0), file.numbers["AngularStep"]
        steps = np.asarray(first + step * np.arange(int(file.numbers["Projections"])), np.float64)
        path = _file_of_angles(file) if self.angles == "files" else None
        if path is None:
            return steps, [], []
        angles, how = _in_order(path, read_angles(path, "", len(steps), f"{path}: angles"), steps)
        if abs(_wrapped(angles[0])) < abs(_wrapped(angles[0] - first)):
            angles, how = angles + first, f"{how}, counted from InitialAngle ({first:g} deg)"
        off = np.abs(_wrapped(angles - angles[0] - steps + first)).max()
        sentence = (
            f"{path.name}: angles {angles[0]:.6g} to {angles[-1]:.6g} deg{how}; they depart from "
            f"AngularStep ({step:g} deg) by up to {off:.3g} deg"
        )
        if off <= abs(step):
            return angles, [sentence], []
        return angles, [], [f"{sentence}: geometry.angles: steps takes AngularStep instead"]


def _file_of_angles(file: Xtekct) -> Path | None:
    """Return the file of angles beside an .xtekct file: _ctdata.txt, else an .ang file."""
    folder = file.path.parent
    names = {file.name.lower(), file.path.stem.lower(), ""}
    alone = sum(other.suffix.lower() == ".xtekct" for other in folder.iterdir()) == 1
    for ending in ("_ctdata.txt", ".ang"):
        files = sorted(f for f in folder.iterdir() if f.name.lower().endswith(ending))
        own = [f for f in files if f.name[: -len(ending)].lower() in names]
        if len(own := own or (files if alone else [])) == 1:
            return own[0]
        if own:
            raise InputError(
                f"{file.path}: which file has its angles, {' or '.join(f.name for f in own)}? Move "
                "the others away, or state geometry.angles: steps in a YAML file"
            )
    return None


def _in_order(path: Path, angles: Floats, steps: Floats) -> tuple[Floats, str]:
    """Return angles that run the way of the steps, and what was done to them in words.

    Raises:
        InputError: there are more or fewer than steps, or they run the other way.
    """
    if len(angles) != len(steps):
        raise InputError(
            f"{path}: {len(angles)} angles, but the .xtekct file states {len(steps)} projections: "
            "remove the file, or state geometry.angles: steps in a YAML file"
        )
    if len(angles) < 2:
        return angles, ""
    step = steps[1] - steps[0]
    way = float(np.median(_wrapped(np.diff(angles))))
    if way * step >= 0:
        return angles, ""
    if path.suffix.lower() != ".ang":
        raise InputError(
            f"{path}: the angles change by {way:.4g} deg from view to view, but AngularStep is "
            f"{step:g} deg: state geometry.angles: steps in a YAML file, or correct one of them"
        )
    ways = {", in the reverse order": angles[::-1], ", negated": -angles}
    how = min(ways, key=lambda one: np.abs(_wrapped(ways[one][0] - [0.0, steps[0]])).min())
    return ways[how], how


def _axis(file: Xtekct, rows: int) -> tuple[tuple[float, float], list[str]]:
    """Return the axis' offset to the left, mm, and its roll, deg, and doubts on them."""
    keys = file.numbers
    scale = keys["SrcToObject"] / keys["SrcToDetector"]
    pitch, height = keys["DetectorPixelSizeX"], rows * keys["DetectorPixelSizeY"]
    top, bottom = (keys.get(f"CentreOfRotation{end}", 0.0) for end in ("Top", "Bottom"))
    offset, roll = (top + bottom) / 2 * scale, -math.degrees(math.atan2(top - bottom, height))
    axis = keys.get("ObjectOffsetX", offset), keys.get("ObjectRoll", roll)
    doubts: list[str] = []
    centres = f"CentreOfRotationTop and CentreOfRotationBottom ({top:g} and {bottom:g} mm"
    use = "is used; to use the others, name it in geometry.ignore in a YAML file"
    if (top or bottom) and abs(axis[0] - offset) > APART * pitch * scale:
        doubts.append(
            f"{file.path}: two centres: the axis is {axis[0]:g} mm from the beam's middle by "
            f"ObjectOffsetX, but {offset:.4g} mm by {centres} on the panel); ObjectOffsetX {use}"
        )
    if (top or bottom) and abs(math.radians(axis[1] - roll)) * height > APART * pitch:
        doubts.append(
            f"{file.path}: two rolls of the axis: {axis[1]:g} deg by ObjectRoll, but {roll:.4g} "
            f"deg by {centres}); ObjectRoll {use}"
        )
    return axis, doubts


def _wrapped(degrees: Floats | float) -> Floats:
    """Return angles in [-180, 180), deg."""
    return np.asarray((np.asarray(degrees) + 180) % 360 - 180, np.float64)
