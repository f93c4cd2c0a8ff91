"""Sources of measured scans: a description, a folder of ``twinct export``, or a machine's file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.core.files.boundary import library_errors, no_file, read_text
from twinct.core.files.plain_json import json_of
from twinct.core.foreign_text import quoted
from twinct.measured.ctsimu_metadata import is_metadata, read_metadata
from twinct.measured.description import Measured, read_description
from twinct.measured.stack import NO_ZEISS, ZEISS
from twinct.measured.toolkits import MOST_BYTES, read_openct
from twinct.measured.xtekct import read_xtekct

_DESCRIPTIONS = (".yaml", ".yml")
_SUFFIXES = (*_DESCRIPTIONS, ".xtekct", ".json", *ZEISS)

_KINDS = {
    "vectors": "astra",
    "sourcePositions": "leap",
    "source_position_set": "cil",
    "offOrigin": "tigre",
}
"""Toolkits by an array that only their geometry.npz has."""


def is_measured(path: Path) -> bool:
    """Return True if a path is a source of a measured scan, by its ending or as a folder."""
    return path.suffix.lower() in _SUFFIXES or path.is_dir()


def description_of(path: Path) -> Measured:
    """Return the description of a source.

    Raises:
        InputError: the source is none, or does not state images and geometry.
    """
    if why := no_file(path, folder=True):
        raise InputError(f"{path} {why}")
    path = path.resolve()
    suffix = path.suffix.lower()
    if suffix in _DESCRIPTIONS and not path.is_dir():
        return read_description(path)
    if suffix in ZEISS:
        raise InputError(f"{path}: {NO_ZEISS}")
    with library_errors(str(path)):
        if path.is_dir():
            return read_description(_exported(path))
        return read_description(_nikon(path) if suffix == ".xtekct" else _json(path))


def _exported(folder: Path) -> dict[str, Any]:
    """Return the description of a folder of ``twinct export``."""
    facts = folder / "export.json"
    if no_file(facts):
        there = sorted(p.name for p in folder.iterdir())[:8]
        raise InputError(
            f"{folder}: images without geometry: it has no export.json, only {', '.join(there)}: "
            "state images and geometry in a YAML file (docs/measured.md)"
        )
    facts_read = _read_json(facts)
    try:
        grid = facts_read["volume"]
        voxels, edges = grid["shape_z_y_x"][::-1], grid["voxel_x_y_z_mm"]
        transmission = str(facts_read["values"]).startswith("transmission")
        name = str(facts_read.get("scan", folder.name))
    except (KeyError, TypeError) as error:
        raise InputError(f"{facts}: not from twinct export: {error!r} is missing") from None
    values = "transmissions" if transmission else "line_integrals"
    results = {
        "name": name,
        "description": f"Imported from {folder.name}.",
        "grid": {"voxels": voxels, "voxel_mm": edges},
    }
    if not no_file(folder / "openct.json"):
        return {**_openct(folder / "openct.json"), **results}
    if not no_file(folder / "geometry.xml"):
        images, geometry = "projections.mha", {"kind": "rtk", "path": str(folder / "geometry.xml")}
    else:
        file = folder / "geometry.npz"
        arrays = read_npz(file, f"{file}: geometry", MOST_BYTES)
        kinds = [kind for name, kind in _KINDS.items() if name in arrays]
        if len(kinds) != 1:
            raise InputError(f"{file}: of no known toolkit; it holds {', '.join(sorted(arrays))}")
        images, geometry = "projections.npy", {"kind": kinds[0], "path": str(file)}
    return {
        **results,
        "images": {"path": str(folder / images), "values": values},
        "geometry": geometry,
    }


def _openct(path: Path) -> dict[str, Any]:
    description = read_openct(path)
    files: list[Path] = description["files"]
    if not files:
        raise InputError(f"{path}: it names no image")
    folder, suffix = files[0].parent, files[0].suffix
    there = sorted(file.name for file in folder.glob(f"*{suffix}"))
    if there != [file.name for file in files]:
        raise InputError(
            f"{path}: names {len(files)} images in the order {files[0].name} to {files[-1].name}; "
            f"{folder} holds {len(there)} files {suffix}"
        )
    panel = description["panel"]
    raw = {"dtype": "<f4", "rows": panel.rows, "columns": panel.columns}
    images: dict[str, Any] = {
        "path": str(folder / f"*{suffix}"),
        "values": "transmissions" if description["transmission"] else "line_integrals",
        **(raw if suffix == ".raw" else {}),
    }
    return {
        "name": path.stem,
        "images": images,
        "geometry": {"kind": "openct", "path": str(path)},
    }


def _json(path: Path) -> dict[str, Any]:
    data = _read_json(path)
    if "OpenCTJSON" in data:
        return _openct(path)
    if is_metadata(data):
        return read_metadata(path, data)
    folder = path.parent / "projections"
    if "geometry" not in data or not folder.is_dir():
        raise InputError(
            f"{path}: neither an OpenCT free trajectory, nor a CTSimU scenario with its images in "
            f"{folder}: state images and geometry in a YAML file (docs/measured.md)"
        )
    return {
        "name": path.stem,
        "images": {"path": str(folder / f"{path.stem}_*.tif"), "values": "transmissions"},
        "geometry": {"kind": "ctsimu", "path": str(path)},
    }


def _nikon(path: Path) -> dict[str, Any]:
    file = read_xtekct(path)
    if "WhiteLevel" not in file.numbers:
        raise InputError(f"{path}: the key WhiteLevel is missing; state images in a YAML file")
    return {
        "name": file.name,
        "description": f"Imported from {path.name}.",
        "images": {
            "path": str(file.images()),
            "values": "intensities",
            "white": file.numbers["WhiteLevel"],
        },
        "geometry": {"kind": "nikon", "path": str(path)},
    }


def _read_json(path: Path) -> dict[str, Any]:
    try:
        data = json_of(read_text(path, f"{path}", MOST_BYTES))
    except ValueError as error:
        raise InputError(f"{path}: not JSON: {error}") from None
    if not isinstance(data, dict):
        raise InputError(f"{path}: {quoted(str(data), 40)} is no JSON object")
    return data
