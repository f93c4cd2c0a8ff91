"""Geometries derived from a scan, each with a name, its provenance and a digest."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import storage_errors, write_text
from twinct.core.foreign_text import quoted
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.scenario.imported import STATED

OWN = ("commanded", "executed", "believed")
"""Names of the geometries that every scan of a scenario has."""

RELATIVE = "relative"
"""Executed poses relative to the specimen; equal to ``executed`` if it does not move."""

FORMAT = "twinct geometry 1"

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True, eq=False)
class NamedGeometry:
    """Source and panel poses of all views, under a name.

    Attributes:
        name: letters, digits, dots, hyphens and underscores.
        poses: poses of each view.
        made_by: the model or method behind the poses, with its settings, as plain data. Its
            ``executed`` is the digest of the executed poses that the geometry was made for.
    """

    name: str
    poses: PosePairs
    made_by: Mapping[str, Any]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the poses and ``made_by``, in hexadecimal."""
        data = {"made_by": self.made_by, **self._numbers()}
        return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()

    def _numbers(self) -> dict[str, list[list[float]]]:
        return {side: _rows(getattr(self.poses, side)) for side in ("source", "detector")}

    def write(self, folder: Path) -> Path:
        """Write ``NAME.json`` into a folder; positions in mm, quaternions (x, y, z, w).

        Raises:
            StorageError: the file cannot be written.
        """
        data = {"format": FORMAT, "made_by": self.made_by, "digest": self.digest}
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"{self.name}.json"
            write_text(path, json.dumps(data | self._numbers(), indent=1) + "\n")
        return path

    @classmethod
    def read(cls, path: Path) -> NamedGeometry:
        """Read a file that ``write`` wrote.

        Raises:
            InputError: the file has another format, or is damaged.
        """
        try:
            data = read_json(path)
            if data["format"] != FORMAT:
                raise ValueError(
                    f"its format is {quoted(data['format'])}; this twinct reads {FORMAT!r}"
                )
            sides = [_poses(data[side]) for side in ("source", "detector")]
            if len(sides[0]) != len(sides[1]):
                raise ValueError("source and detector differ in their number of views")
            geometry = cls(checked_name(path.stem), PosePairs(*sides), dict(data["made_by"]))
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise InputError(f"{path}: not a geometry file: {error}") from None
        if geometry.digest != data["digest"]:
            raise InputError(f"{path}: the geometry does not match its digest")
        return geometry


def named_geometries(folder: Path) -> dict[str, NamedGeometry]:
    """Return all geometries in a folder, by name; empty without a folder.

    Raises:
        InputError: a file is damaged.
    """
    # Remains of a killed write begin with a dot.
    paths = sorted(p for p in folder.glob("*.json") if not p.name.startswith("."))
    return {path.stem: NamedGeometry.read(path) for path in paths}


def store_geometries(kept: Iterable[tuple[NamedGeometry, Path]]) -> None:
    """Write each geometry into its folder, which keeps what it has.

    Raises:
        ScanExistsError: a folder has another geometry of this name; nothing is written.
        InputError: the geometry there is damaged; nothing is written.
        StorageError: a file cannot be written.
    """
    kept = list(kept)
    for geometry, folder in kept:
        there = folder / f"{geometry.name}.json"
        if there.exists() and NamedGeometry.read(there).digest != geometry.digest:
            raise ScanExistsError(f"{there} holds another geometry; choose another --as")
    for geometry, folder in kept:
        geometry.write(folder)


def checked_name(name: str) -> str:
    """Check that a name can name a file, and return it.

    Raises:
        InputError: the name is not valid.
    """
    if not _NAME.fullmatch(name):
        raise InputError(
            f"name {quoted(name)}: use at most 64 letters, digits, dots, hyphens and underscores, "
            "and begin with a letter or a digit"
        )
    return name


def free_geometry_name(name: str) -> str:
    """Check that a name can be that of a derived geometry, and return it.

    Raises:
        InputError: the name is not valid, or a scan comes with a geometry of this name.
    """
    if checked_name(name) in (*OWN, RELATIVE, STATED):
        own = ", ".join((*OWN, RELATIVE))
        raise InputError(
            f"name {quoted(name)} is reserved: every scan already has {own}, or {STATED}"
        )
    return name


def poses_digest(poses: PosePairs) -> str:
    """Return the SHA-256 of source and detector poses, in hexadecimal, to identify their scan."""
    digest = hashlib.sha256()
    for pose in (*poses.source, *poses.detector):
        digest.update(pose.position.tobytes() + pose.quat.tobytes())
    return digest.hexdigest()


def _rows(poses: Sequence[Pose]) -> list[list[float]]:
    return [[*pose.position.tolist(), *pose.quat.tolist()] for pose in poses]


def _poses(rows: Sequence[Sequence[float]]) -> tuple[Pose, ...]:
    if any(len(row) != 7 for row in rows):
        raise ValueError("a pose has seven numbers")
    return tuple(Pose(np.array(row[:3]), np.array(row[3:])) for row in rows)
