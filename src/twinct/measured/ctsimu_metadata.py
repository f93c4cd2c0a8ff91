"""CTSimU's ``NAME_metadata.json``: images, fields and scenario of a scan, as a description."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.files.boundary import library_errors, read_text
from twinct.core.files.plain_json import json_of

KIND = "CTSimU Metadata"

MOST_BYTES = 50_000_000
"""Largest scenario that is read."""

_RAW = (".raw", ".bin")

_TYPES = {"uint8": "u1", "uint16": "u2", "uint32": "u4", "int8": "i1", "int16": "i2", "int32": "i4"}
_TYPES |= {"float32": "f4", "float64": "f8"}
"""Number types of raw files, as numpy names them."""

_NUMBER = re.compile(r"%0?[0-9]*d")


def is_metadata(data: Mapping[str, Any]) -> bool:
    """Return True if a JSON object is CTSimU's metadata."""
    about = data.get("file")
    return isinstance(about, Mapping) and about.get("file_type") == KIND


def read_metadata(path: Path, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the description of a scan from its metadata.

    Images that are corrected already are divided by ``max_intensity``; others by their flat images,
    less the dark ones. Without flat images, the brightest pixel of the free beam has
    ``max_intensity``, and the others follow the beam's fall-off. Without dark images, the scenario
    states the grey value in the dark.

    Args:
        path: the file; its paths are relative to it.
        data: its contents.

    Raises:
        InputError: a needed entry is missing, or the fields cannot be used.
    """
    try:
        projections = data["output"]["projections"]
        filename, scenario = (
            projections["filename"],
            data["acquisition_geometry"]["path_to_CTSimU_JSON"],
        )
        if not (isinstance(filename, str) and filename):
            raise KeyError("output.projections.filename")
        if not (isinstance(scenario, str) and scenario):
            raise KeyError("acquisition_geometry.path_to_CTSimU_JSON")
        images = {
            **_files(path, filename, projections),
            "values": "intensities",
            **_fields(path, projections, _black(data, path.parent / scenario)),
        }
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: CTSimU metadata without {error}: state images and geometry in a YAML file "
            "(docs/measured.md)"
        ) from None
    return {
        "name": str(data["file"].get("name") or path.stem),
        "description": f"Imported from {path.name}.",
        "images": images,
        "geometry": {"kind": "ctsimu", "path": str((path.parent / scenario).resolve())},
    }


def _files(path: Path, filename: str, projections: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of files; %04d in their name becomes a pattern that digits match."""
    results: dict[str, Any] = {"path": str(path.parent / _NUMBER.sub("[0-9]*", filename))}
    if Path(filename).suffix.lower() not in _RAW:
        return results
    kind, header = projections["datatype"], projections.get("headersize") or {}
    if kind not in _TYPES:
        raise InputError(
            f"{path}: output.projections.datatype: {kind}; known are {', '.join(_TYPES)}"
        )
    if header.get("image"):
        raise InputError(
            f"{path}: output.projections.headersize.image: {header['image']}: a header before each "
            "image in one file is not read"
        )
    sizes = projections["dimensions"]
    return {
        **results,
        "dtype": (">" if projections.get("byteorder") == "big" else "<") + _TYPES[kind],
        "rows": int(sizes["y"]["value"]),
        "columns": int(sizes["x"]["value"]),
        "header_bytes": int(header.get("file") or 0),
    }


def _black(data: Mapping[str, Any], scenario: Path) -> float | None:
    """Return the grey value without radiation that the scenario states, or None.

    It is ``offset`` or ``imin``: the grey value of no energy. A file of grey values counts before.

    Raises:
        InputError: the scenario cannot be read.
    """
    text = read_text(scenario, f"{scenario}", MOST_BYTES)
    with library_errors(f"{scenario}"):
        grey = (json_of(text).get("detector") or {}).get("gray_value") or {}
    told = {name: _value(grey.get(name)) for name in ("factor", "offset", "imin")}
    if _value(grey.get("intensity_characteristics_file")) is not None:
        return None
    black = told["imin"] if told["factor"] is None else told["offset"]
    return float(black) if isinstance(black, (int, float)) else None


def _value(quantity: Any) -> Any:
    return quantity.get("value") if isinstance(quantity, Mapping) else None


def _fields(path: Path, projections: Mapping[str, Any], black: float | None) -> dict[str, Any]:
    """Return the keys of dark and flat fields and of bad pixels."""
    names = "dark_field", "flat_field", "bad_pixel_map"
    dark, flat, bad = (projections.get(name) or {} for name in names)
    # Names may stand beside a number of 0: there are no such files.
    dark, flat = (
        one if one.get("number", 1) else {**one, "filename": None} for one in (dark, flat)
    )
    results: dict[str, Any] = {}
    if bad.get("filename"):
        results["bad_pixels"] = {"path": str(path.parent / bad["filename"])}
    if not flat.get("projections_corrected"):
        if dark.get("projections_corrected") and flat.get("filename"):
            raise InputError(
                f"{path}: projections are corrected by the dark images, but not by the flat ones: "
                "which of these hold the dark signal is not stated; describe them in a YAML file"
            )
        if dark.get("filename") and not dark.get("projections_corrected"):
            results["darks"] = [_files(path, dark["filename"], projections)]
        elif black and not dark.get("projections_corrected"):
            results["black"] = black
        if flat.get("filename"):
            return {**results, "flats": [_files(path, flat["filename"], projections)]}
        results["air"] = "fall_off"
    white = projections.get("max_intensity")
    if not (isinstance(white, (int, float)) and white > 0):
        raise InputError(
            f"{path}: output.projections.max_intensity: {white}: it must be the intensity without "
            "object, where there are no flat images"
        )
    if dark.get("projections_corrected") and not flat.get("projections_corrected"):
        white -= black or 0.0
    return {**results, "white": float(white)}
