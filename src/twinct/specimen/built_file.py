"""A built specimen in a file of arrays: its meshes, without materials, which the scenario names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct import scenario
from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.specimen.build import BuiltPart, BuiltSpecimen
from twinct.specimen.materials import material
from twinct.specimen.surface import surface

LARGEST_BYTES = 2**34
"""Largest total size of the arrays in a file; 20 million triangles have a twentieth of this."""

_HULL = "hull"
"""Name of the hull, also where ``cached_property`` keeps it."""


def save_built(specimen: BuiltSpecimen, path: Path) -> None:
    """Write the meshes of a specimen, and its hull if it is known, to a file."""
    meshes = {str(i): part.mesh for i, part in enumerate(specimen.parts)}
    if _HULL in vars(specimen):
        meshes[_HULL] = specimen.hull
    arrays: dict[str, NDArray[Any]] = {}
    for name, mesh in meshes.items():
        arrays[f"{name}.vertices"] = np.asarray(mesh.vertices, np.float64)
        arrays[f"{name}.faces"] = np.asarray(mesh.faces, np.int64)
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def load_built(section: scenario.Specimen, path: Path) -> BuiltSpecimen:
    """Read the file that ``save_built`` wrote for the specimen of a scenario.

    Raises:
        InputError: the file does not hold this specimen's meshes.
    """
    where = f"{path}: the cached specimen"
    arrays = read_npz(path, where, LARGEST_BYTES)
    parts = [
        BuiltPart(part.label, material(part.material), _mesh(arrays, str(i), where))
        for i, part in enumerate(section.parts)
    ]
    specimen = BuiltSpecimen(tuple(parts), section.world_from_specimen, section.reference)
    if any(name.startswith(f"{_HULL}.") for name in arrays):
        vars(specimen)[_HULL] = _mesh(arrays, _HULL, where)
    return specimen


def _mesh(arrays: Mapping[str, NDArray[Any]], name: str, where: str) -> Any:
    """Return a mesh whose corners exist, as compiled code does not check them."""
    vertices, faces = arrays.get(f"{name}.vertices"), arrays.get(f"{name}.faces")
    if vertices is None or faces is None:
        raise InputError(f"{where} has no mesh {name!r}")
    for array, dtype in ((vertices, np.float64), (faces, np.int64)):
        if array.dtype != dtype or array.ndim != 2 or array.shape[1] != 3 or not len(array):
            raise InputError(f"{where}: mesh {name!r} has {array.dtype} of {array.shape}")
    if not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{where}: mesh {name!r} has corners that do not exist")
    return surface(vertices, faces)
