"""The command that takes an arm from its vendor's description."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.progress import say
from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.robots.cell.vendor import write_arm
from twinct.robots.programs import check_absent

_SUPPLY = {
    "joint_torque_nm": ("no torque limit", "manual of the arm: rated or maximum torques"),
    "joint_speed_deg_s": ("no speed limit", "data sheet of the arm: maximum speeds"),
    "link_density_kg_m3": (
        "no inertia",
        "data sheet: mass of the arm, over the volume of its links",
    ),
}
"""What a file may lack, and where to look it up, by the key that supplies it."""


def arm(
    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")],
    arguments: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME:=VALUE ...]")
    ] = (),
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    srdf: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    collide_visuals: bool = False,
    concave: bool = False,
) -> None:
    """Write the URDF of a vendor's arm into a folder of its own, with all meshes.

    Macros are expanded by xacro, which evaluates expressions of the file: use files that you trust.
    Packages are searched from the file upwards, in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH.

    Args:
        file: URDF or xacro.
        arguments: Values of xacro's arguments.
        out: Folder to write, which must not exist.
        srdf: SRDF of the arm (MoveIt): pairs of links that it disables are not checked.
        collide_visuals: Let links without collision shapes collide by their pictures: decimated,
            convex.
        concave: Cut hollow links into convex parts (CoACD), instead of taking their hulls.
    """
    given = dict(_pair(text) for text in arguments)
    check_absent(out)
    written = write_arm(
        file, given, out, srdf=srdf, collide_visuals=collide_visuals, concave=concave
    )
    say(f"wrote {written.file}: {len(written.links)} links, {written.meshes} meshes")
    for link, parts in written.parts.items():
        say(f"{link}: collides as {parts} convex parts")
    if written.holed:
        say(f"not cut, because their meshes have holes: {', '.join(written.holed)}")
    if written.pictures:
        say(f"collides by its pictures: {', '.join(written.pictures)}")
    if written.disabled:
        say(f"pairs of links that {srdf} disables, and that are not checked: {written.disabled}")
    for key, names in written.lacking.items():
        lacks, source = _SUPPLY[key]
        say(f"{lacks}: {', '.join(names)}: set {key} in the scenario (look it up: {source})")
    say(f"in the scenario: cell: {{source_arm: {{model: null, file: {written.file.resolve()}}}}}")


def _pair(text: str) -> tuple[str, str]:
    name, separator, value = text.partition(":=")
    if not separator or not name:
        raise InputError(f"arguments have the form NAME:=VALUE, but one is {quoted(text)}")
    return name, value
