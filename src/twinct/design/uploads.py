"""Specimens that a page receives: kept in the folder of the draft, and read as every file is.

A file becomes a part of the specimen only if the readers of meshes and volumes accept it.
"""

from __future__ import annotations

import io
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar

import numpy as np

from twinct.core.errors import InputError
from twinct.core.files.packed import unpacked_limit
from twinct.core.files.writing import complete, storage_errors
from twinct.core.foreign_text import quoted
from twinct.design.bench import Bench
from twinct.design.choices import with_parts
from twinct.design.edits import Edit
from twinct.design.own_folder import relative_to_file, room_in
from twinct.design.questions import Question
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

LARGEST_UPLOAD = 2**29
"""Largest upload, bytes: a CT of 512^3 voxels of 16 bits has half of it."""

MOST_FILES = 10_000
"""Most files in a ZIP file: a DICOM series has one for each slice."""

MESHES = (".stl", ".ply", ".obj", ".off")
VOLUMES = (".nii", ".nii.gz", ".mha", ".inv3")

SURFACE, VOXELS = "bone surface", "grey voxels"
KINDS = (SURFACE, VOXELS)
"""What a CT becomes: a closed surface at a threshold, or every voxel a mixture of materials."""

UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
"""Units of mesh files, mm."""

_STEP = 2**20


def kept(file: Path, name: str, content: bytes) -> Path:
    """Write an upload to the folder of a scenario file.

    Args:
        file: the scenario file.
        name: name that the sender gives it; only its ending is used, and its letters and digits.
        content: its bytes; the files of a ZIP file are unpacked.

    Returns:
        The file, or the folder of the unpacked files.

    Raises:
        InputError: it is too large, empty, of no known kind, or a damaged ZIP file.
        StorageError: the folder cannot be written.
    """
    if len(content) > LARGEST_UPLOAD:
        raise InputError(f"{quoted(name)} has {len(content)} bytes; the limit is {LARGEST_UPLOAD}")
    if not content:
        raise InputError(f"{quoted(name)} is empty")
    ending = ending_of(name)
    if not ending:
        known = ", ".join((*MESHES, *VOLUMES, ".zip"))
        raise InputError(f"{quoted(name)}: expected a file of a specimen: {known}")
    stem = plain_name(name)
    if ending != ".zip":
        return _written(room_in(file, stem, ending), content)
    members = _members(name, content)
    if len(members) == 1 and (inner := ending_of(members[0].filename)) not in ("", ".zip"):
        path = room_in(file, stem, inner)
        with zipfile.ZipFile(io.BytesIO(content)) as archive, storage_errors(path):
            _unpack(archive, members[0], path, name)
        return path
    folder = room_in(file, stem)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive, storage_errors(folder):
            folder.mkdir()
            for number, member in enumerate(members):
                _unpack(archive, member, folder / f"{number:05d}.dcm", name)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def ending_of(name: str) -> str:
    """Return the ending of a name in lower case; empty if it is of no specimen."""
    lower = name.lower()
    return next((e for e in (*MESHES, *VOLUMES, ".zip") if lower.endswith(e)), "")


def plain_name(name: str) -> str:
    """Return the letters and digits of a name without folder and ending, for a new file."""
    last = PurePosixPath(name.replace("\\", "/")).name
    last = last[: len(last) - len(ending_of(last))]
    kept_letters = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in last)
    return kept_letters.strip("-")[:60] or "specimen"


def _written(path: Path, content: bytes) -> Path:
    with storage_errors(path), complete(path) as draft:
        draft.write_bytes(content)
    return path


def _members(name: str, content: bytes) -> list[zipfile.ZipInfo]:
    """Return the files in a ZIP file.

    Raises:
        InputError: it is damaged, has no files, too many, or too much in them.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [one for one in archive.infolist() if not one.is_dir()]
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError) as error:
        raise InputError(f"{quoted(name)} is no ZIP file that can be read: {error}") from None
    if not 1 <= len(members) <= MOST_FILES:
        raise InputError(
            f"{quoted(name)} holds {len(members)} files; expected 1 to {MOST_FILES}, such as the "
            "slices of one DICOM series"
        )
    total, most = sum(one.file_size for one in members), unpacked_limit(len(content))
    if total > most:
        raise InputError(f"{quoted(name)} holds {total} bytes; the limit is {most}")
    return members


def _unpack(archive: zipfile.ZipFile, member: zipfile.ZipInfo, path: Path, name: str) -> None:
    """Write one file; a ZIP file whose directory states too small a size is refused."""
    try:
        with complete(path) as draft, draft.open("wb") as out:
            for part in _parts(archive, member):
                out.write(part)
    except (zipfile.BadZipFile, zlib.error, RuntimeError, NotImplementedError, EOFError) as error:
        raise InputError(f"{quoted(name)} cannot be unpacked: {error}") from None


def _parts(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Iterator[bytes]:
    left = member.file_size
    with archive.open(member) as stream:
        while part := stream.read(_STEP):
            left -= len(part)
            if left < 0:
                raise zipfile.BadZipFile(f"{quoted(member.filename)} is larger than stated")
            yield part


@dataclass(frozen=True)
class Received:
    """A specimen that can be used.

    Attributes:
        edit: the edit that makes it the specimen.
        words: its size, and whether it fits into the volume, one sentence each.
    """

    edit: Edit
    words: tuple[str, ...]


@dataclass(frozen=True)
class ReceivedSpecimen(Question):
    """Question for the edit that makes a file of ``kept`` the specimen.

    Attributes:
        path: the file or folder.
        kind: what a CT becomes; see ``KINDS``.
        unit_mm: unit of a mesh file, mm.
    """

    path: Path = Path()
    kind: str = SURFACE
    unit_mm: float = 1.0
    subject: ClassVar[str] = "upload"

    def answered(self, bench: Bench) -> Received:
        """Return the edit.

        Raises:
            InputError: the readers refuse the file; says why.
        """
        now = bench.scenario(self.source)
        edit = Edit(with_parts(now, [self._part]))
        scenario = load_scenario(edit.on(self.source))
        # A builder of its own: the bench would keep a specimen that may be refused.
        specimen = SimulationBuilder(scenario).specimen
        size = np.asarray(specimen.bounds[1] - specimen.bounds[0])
        words = [f"{self.path.name}: {' x '.join(f'{edge:.1f}' for edge in size)} mm"]
        room = np.asarray(scenario.reconstruction.volume_grid.size_mm)
        if (size > room).any():
            has = " x ".join(f"{edge:.0f}" for edge in room)
            words.append(f"it is larger than the volume, {has} mm: see reconstruction.grid")
        return Received(edit, tuple(words))

    @property
    def _part(self) -> dict[str, Any]:
        path = relative_to_file(self.path, self.source.path)
        shape: dict[str, Any] = {"kind": "mesh", "path": path, "centre": True}
        if ending_of(self.path.name) in MESHES:
            if self.unit_mm != 1:
                shape["unit_mm"] = self.unit_mm
        else:
            shape["kind"] = "ct" if self.kind == SURFACE else "volume"
        name = plain_name(self.path.name)
        return {"name": name, "shape": shape, "material": "bone"}


def forget(path: Path) -> None:
    """Remove a file or folder that ``kept`` has written and that the readers have refused."""
    with storage_errors(path):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
