"""A motion plan under the joint names of the arms' drivers, and the folder with its files."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.writing import complete, storage_errors
from twinct.geometry import Floats
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.plan import MotionPlan

TRIGGERS = "triggers.csv"
"""File with the time of each view, and its commanded poses, beside every program."""


@dataclass(frozen=True, eq=False)
class Program:
    """A motion plan, for the drivers of both arms.

    Attributes:
        plan: the plan.
        names: joint names of each arm's driver, source first, from base to flange.
        origin: source of the plan, for comments in the files.
    """

    plan: MotionPlan
    names: tuple[tuple[str, ...], tuple[str, ...]]
    origin: str

    @property
    def arms(self) -> tuple[slice, slice]:
        """Columns of the joints of each arm."""
        first = len(self.names[0])
        return slice(0, first), slice(first, first + len(self.names[1]))

    def states(self, arm: int) -> Floats:
        """Return positions, velocities and accelerations of one arm, (waypoints, 3, joints)."""
        return self.plan.state[:, :, self.arms[arm]]


def program_of(plan: MotionPlan, origin: str, prefixes: tuple[str, str] = ("", "")) -> Program:
    """Return a plan under the names of the drivers: a prefix of each arm, and the joint's own name.

    Args:
        plan: the plan.
        origin: source of the plan, for comments in the files.
        prefixes: prefix of the joints of the source arm and of the detector arm.
    """
    source, detector = (
        tuple(
            prefix + name.removeprefix(f"{side}_")
            for name in plan.joint_names
            if name.startswith(f"{side}_")
        )
        for side, prefix in zip(SIDES, prefixes, strict=True)
    )
    return Program(plan, (source, detector), origin)


def triggers(program: Program) -> str:
    """Return the table of all views: time, s, and commanded poses, m and quaternions."""
    columns = [
        f"{side}_{axis}" for side in SIDES for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")
    ]
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(["view", "time_s", *columns])
    for view, (time_s, target) in enumerate(
        zip(program.plan.exposures_s.tolist(), program.plan.targets, strict=True)
    ):
        numbers = (number for pose in target[0] for number in pose.seven)
        rows.writerow([view, repr(time_s), *map(repr, numbers)])
    return stream.getvalue()


def check_absent(folder: Path) -> None:
    """Check that a folder can be made.

    Raises:
        InputError: the folder's parent is not a folder.
        ScanExistsError: the folder exists.
    """
    if folder.exists():
        raise ScanExistsError(f"{folder} exists already: choose another --out")
    if folder.parent.exists() and not folder.parent.is_dir():
        raise InputError(f"--out {folder}: {folder.parent} is not a folder")


def write_program(folder: Path, files: Mapping[str, str]) -> None:
    """Write the files of a program into a new folder, which appears only when it is complete.

    Raises:
        InputError: the folder's parent is not a folder.
        ScanExistsError: the folder exists.
        StorageError: the files cannot be written.
    """
    check_absent(folder)
    with storage_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with complete(folder) as draft:
            draft.mkdir()
            for name, text in files.items():
                (draft / name).write_text(text, encoding="utf-8")
