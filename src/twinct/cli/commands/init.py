"""``twinct init``: a scenario to start from."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.progress import say
from twinct.core.errors import InputError
from twinct.core.files.writing import storage_errors, write_text
from twinct.scenario.commented import commented_scenario
from twinct.scenario.starting import Start, start_from_ct, start_from_mesh

_QUESTIONS = {
    "stl": "The file of your part's surface (STL, PLY, OBJ or OFF)",
    "ct": "Your CT (NIfTI, MetaImage, or the folder of a DICOM series)",
    "arm": "The file of your robot arm (URDF or MJCF)",
}
_File = Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="(optional)")]


def init(
    file: Annotated[
        tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE", help="Scenario file to write.")
    ] = Path("scenario.yaml"),
    *,
    stl: _File = None,
    ct: _File = None,
    arm: _File = None,
    unit_mm: float = 1.0,
    from_: Annotated[
        str | None,
        tyro.conf.arg(name="from", metavar="NAME", help_behavior_hint="(default: demo)"),
    ] = None,
) -> None:
    """Write a scenario to start from, with a comment on each key.

    In a terminal and without options, it asks for your part, your CT and your arms.

    Args:
        stl: Closed surface of your part; pixels and voxels fit its size.
        ct: CT to scan, such as a patient's: NIfTI, MetaImage, or the folder of a DICOM series.
        arm: URDF or MJCF file of the robot that carries source and panel.
        unit_mm: Length of one unit of the surface's file, which STL does not state; 25.4: inches.
        from_: Built-in scenario to copy, such as circle_gantry, head or patient_spine.
    """
    if file.suffix not in (".yaml", ".yml"):
        raise InputError(f"{file}: a scenario file must end in .yaml")
    if file.exists():
        raise InputError(f"{file} exists already; choose another name, or remove it")
    asked = not (stl or ct or arm or from_) and sys.stdin.isatty()
    own = _answers() if asked else {"stl": stl, "ct": ct, "arm": arm}
    start = _start(from_, unit_mm=unit_mm, **own)
    text = commented_scenario(start, file)
    with storage_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, text)
    if start.size_mm is not None:
        size = " x ".join(f"{edge:.3g}" for edge in start.size_mm)
        hint = "; if its file is in inches: --unit-mm 25.4" if unit_mm == 1 else ""
        say(f"the part measures {size} mm{hint}")
    say(f"wrote {file}; 'twinct check {file}' says whether it can be run")


def _start(
    from_: str | None, stl: Path | None, ct: Path | None, arm: Path | None, unit_mm: float
) -> Start:
    objects = {"--stl": stl, "--ct": ct, "--from": from_}
    given = [name for name, value in objects.items() if value is not None]
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)} exclude each other: each chooses the object")
    for path in (stl, ct, arm):
        if path is not None and not path.exists():
            raise InputError(f"no file at {path}")
    if not (math.isfinite(unit_mm) and unit_mm > 0):
        raise InputError(f"--unit-mm: must be above 0 mm, but is {unit_mm}")
    if unit_mm != 1 and stl is None:
        raise InputError("--unit-mm: states the unit of a surface's file; name it by --stl")
    start = Start(from_ or "demo")
    if stl:
        start = start_from_mesh(stl, unit_mm)
    elif ct:
        start = start_from_ct(ct)
    return start.with_arms(arm) if arm else start


def _answers() -> dict[str, Path | None]:
    """Ask for the user's files; an empty answer is none, and a part needs no CT."""
    say("Three questions; press Enter where you have no file of your own.")
    answers: dict[str, Path | None] = {}
    for name, question in _QUESTIONS.items():
        skipped = name == "ct" and answers["stl"] is not None
        answers[name] = None if skipped else _answer(question)
    return answers


def _answer(question: str) -> Path | None:
    while text := input(f"{question}: ").strip().strip("'\""):
        if (path := Path(text).expanduser()).exists():
            return path
        say(f"no file at {path}")
    return None
