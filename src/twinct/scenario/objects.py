"""Meshes, volumes and views that a program holds, in place of the files that a scenario names.

They are written as files of this process, named by their content. So a scenario is plain data at
all times. What lasts longer than the process, such as a run's folder, takes these files along.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from twinct.core.arguments import came
from twinct.core.errors import ScenarioError
from twinct.core.files.links import own_folder
from twinct.core.files.meshes import read_mesh, write_ply
from twinct.core.files.private import temporary_folder
from twinct.core.files.writing import complete
from twinct.core.settings import FILE_KEYS
from twinct.geometry import ScanGeometry
from twinct.recon.volume import Volume
from twinct.scenario.scenario import Scenario
from twinct.trajectory import rows_of_views, write_rows


def as_settings(key: str, value: Any) -> Any:
    """Return an object of a program as the section that names its file, else the value itself.

    Args:
        key: last step of the value's key. A closed mesh, such as ``trimesh.Trimesh``, in mm, may be
            a ``shape``, or the whole ``specimen`` of bone; so may a ``Volume`` of HU be, whose
            voxels stay grey. ``trajectory`` may be a ``ScanGeometry``
            or what ``rows_of_views`` takes.
        value: the value of the key.

    Raises:
        ScenarioError: the views are invalid, or the specimen is a path or an array.
        SpecimenError: the mesh is not closed.
    """
    if key in ("shape", "specimen") and hasattr(value, "vertices") and hasattr(value, "faces"):
        path = _file("mesh", ".ply", lambda draft: write_ply(draft, value.vertices, value.faces))
        read_mesh(path, f"{key}: the mesh")
        shape = {"kind": "mesh", "path": str(path)}
        return shape if key == "shape" else {"parts": [{"shape": shape}]}
    if key in ("shape", "specimen") and _is_volume(value):
        path = _file("volume", ".nii", lambda draft: value.write(draft, "HU"))
        shape = {"kind": "volume", "path": str(path)}
        return shape if key == "shape" else {"parts": [{"shape": shape}]}
    if key == "specimen" and isinstance(value, str | os.PathLike | np.ndarray):
        raise ScenarioError(
            "specimen: must be a closed mesh, such as trimesh.load('part.stl'), a Volume of HU, or "
            "the keys of the section, such as {'parts': [{'shape': {'kind': 'mesh', 'path': "
            f"'part.stl'}}, 'material': 'bone'}}]}}, but is {came(value)}"
        )
    if key == "trajectory" and _views(value):
        try:
            rows = rows_of_views(value)
        except ValueError as error:
            raise ScenarioError(f"trajectory: {error}") from None
        path = _file("views", ".csv", lambda draft: write_rows(draft, rows))
        return {"kind": "file", "path": str(path)}
    return value


def _is_volume(value: object) -> bool:
    if isinstance(value, Mapping | str):
        return False
    return isinstance(value, Volume)


def _views(value: object) -> bool:
    """Return True for a geometry, an array, or a tuple with arrays."""
    parts = cast("tuple[object, ...]", value) if isinstance(value, tuple) else (value,)
    return any(isinstance(part, ScanGeometry | np.ndarray) for part in parts)


def with_files_in(scenario: Scenario, folder: Path) -> Scenario:
    """Copy the files of this process that a scenario names to a folder, and name them there.

    A scenario that names no such file is returned as it is, and no folder is made.

    Args:
        scenario: the scenario.
        folder: folder for the files, whose names state their content; made if it is missing.

    Raises:
        OSError: a file cannot be written.
        InputError: the folder is a link.
    """
    own = {path for path in scenario.files().values() if path.parent == _own().resolve()}
    if not own:
        return scenario
    folder = own_folder(folder).resolve()
    for path in own:
        if not (folder / path.name).exists():
            with complete(folder / path.name) as draft:
                shutil.copyfile(path, draft)

    def copied(path: Path) -> Path:
        return folder / path.name if path in own else path

    data = with_paths(scenario.model_dump(mode="json"), copied)
    return Scenario.model_validate_json(json.dumps(data), strict=True)


def with_paths(data: Any, new: Callable[[Path], Path]) -> Any:
    """Return a scenario's plain data with other paths of its input files."""
    if isinstance(data, list):
        return [with_paths(item, new) for item in cast("list[Any]", data)]
    if not isinstance(data, Mapping):
        return data
    pairs = cast("Mapping[str, Any]", data).items()
    return {
        key: str(new(Path(value)))
        if key in FILE_KEYS and isinstance(value, str)
        else with_paths(value, new)
        for key, value in pairs
    }


@cache
def _own() -> Path:
    """Return the folder for the files of this process, which is removed when it ends."""
    stack = contextlib.ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(temporary_folder())


def _file(name: str, suffix: str, write: Callable[[Path], None]) -> Path:
    """Write a file of this process and name it by its content."""
    handle, draft = tempfile.mkstemp(suffix, dir=_own())
    os.close(handle)
    write(Path(draft))
    with open(draft, "rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return Path(draft).replace(_own() / f"{name}-{digest[:16]}{suffix}")
