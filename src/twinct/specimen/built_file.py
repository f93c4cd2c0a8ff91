"""A built specimen in a file of arrays: its meshes and voxels.

Materials of parts are those that the scenario names; basis materials of voxels are in the file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.geometry import Pose, VolumeGrid
from twinct.specimen import sections
from twinct.specimen.body_motion import body_motion
from twinct.specimen.build import BuiltPart, BuiltSpecimen
from twinct.specimen.cut_rays import CutFace
from twinct.specimen.grey import GreyField
from twinct.specimen.grey_part import GreyPart, VoxelLabels
from twinct.specimen.materials import Material, material
from twinct.specimen.own_parts import own_part
from twinct.specimen.part import Part
from twinct.specimen.surface import surface

LARGEST_BYTES = 2**34
"""Largest total size of the arrays in a file: 512^3 voxels of six basis materials have 13 GB."""

_HULL, _HULLS = "hull", "hulls"
"""Names of the hull and of the convex bodies, also where ``cached_property`` keeps them."""


def save_built(specimen: BuiltSpecimen, path: Path) -> None:
    """Write the parts of a specimen, and its hulls if they are known, to a file."""
    meshes = {str(i): part.mesh for i, part in enumerate(specimen.parts)}
    if _HULL in vars(specimen):
        meshes[_HULL] = specimen.hull
    if _HULLS in vars(specimen) and specimen.mixtures:
        meshes |= {f"{_HULLS}{i}": hull for i, hull in enumerate(specimen.hulls)}
    arrays: dict[str, NDArray[Any]] = {}
    for name, mesh in meshes.items():
        arrays[f"{name}.vertices"] = np.asarray(mesh.vertices, np.float64)
        arrays[f"{name}.faces"] = np.asarray(mesh.faces, np.int64)
    for i, part in enumerate(specimen.parts):
        if isinstance(part, GreyPart):
            arrays |= {f"{i}.{name}": array for name, array in _voxels(part).items()}
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def load_built(section: sections.Specimen, path: Path) -> BuiltSpecimen:
    """Read the file that ``save_built`` wrote for the specimen of a scenario.

    Raises:
        InputError: the file does not hold this specimen.
    """
    where = f"{path}: the cached specimen"
    arrays = read_npz(path, where, LARGEST_BYTES)
    parts = [_part(part, arrays, str(i), where) for i, part in enumerate(section.parts)]
    motion = None
    if section.motion is not None:
        motion = body_motion(section)
    specimen = BuiltSpecimen(tuple(parts), section.world_from_specimen, section.reference, motion)
    if any(name.startswith(f"{_HULL}.") for name in arrays):
        vars(specimen)[_HULL] = _mesh(arrays, _HULL, where)
    count = sum(name.startswith(_HULLS) and name.endswith(".faces") for name in arrays)
    if count:
        hulls = (_mesh(arrays, f"{_HULLS}{i}", where) for i in range(count))
        vars(specimen)[_HULLS] = tuple(hulls)
    return specimen


def _part(
    section: sections.Part, arrays: Mapping[str, NDArray[Any]], name: str, where: str
) -> Part:
    substance, mesh = material(section.material), _mesh(arrays, name, where)
    if section.own_rays and section.homogeneous:  # its formulas are in no file
        pose = section.specimen_from_part
        if (own := own_part(section.shape, section.label, substance, pose)) is not None:
            return own
    if f"{name}.amounts" not in arrays:
        return BuiltPart(section.label, substance, mesh)
    try:
        data = json.loads(arrays[f"{name}.told"].tobytes())
        pose = Pose(np.array(data["position"]), np.array(data["quat"]))
        amounts = arrays[f"{name}.amounts"]
        grid = VolumeGrid(amounts.shape[:3], data["voxel"], pose)
        basis = tuple(Material(*row) for row in data["materials"])
        labels = None
        if data["labels"]:
            labels = VoxelLabels(tuple(data["labels"]), arrays[f"{name}.labels"])
        cuts = tuple(
            CutFace(axis, high, arrays[f"{name}.cut{k}"])
            for k, (axis, high) in enumerate(data["cuts"])
        )
        field = GreyField(basis, amounts, grid, data["sharp"])
        return GreyPart(section.label, substance, mesh, field, labels, cuts)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{where}: part {name} is damaged: {error}") from None


def _voxels(part: GreyPart) -> dict[str, NDArray[Any]]:
    """Return the arrays of a grey part; ``data`` is JSON in bytes."""
    grid = part.field.grid
    data = {
        "position": grid.world_from_grid.position.tolist(),
        "quat": grid.world_from_grid.quat.tolist(),
        "voxel": grid.voxel.tolist(),
        "materials": [
            [m.name, m.density_g_cm3, dict(m.mass_fractions)] for m in part.field.materials
        ],
        "labels": part.label_names,
        "sharp": part.field.sharp,
        "cuts": [[cut.axis, cut.high] for cut in part.cuts],
    }
    arrays: dict[str, NDArray[Any]] = {f"cut{k}": cut.tissue for k, cut in enumerate(part.cuts)}
    arrays |= {"told": np.frombuffer(json.dumps(data).encode(), np.uint8)}
    arrays |= {"labels": part.labels.values} if part.labels else {}
    return arrays | {"amounts": part.field.amounts}


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
