"""Building blocks of CTSimU files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from trimesh import Trimesh

from twinct.core.errors import StorageError
from twinct.core.files.reading import reason
from twinct.core.files.writing import complete
from twinct.ctsimu.acquisition import FORMAT
from twinct.geometry import Floats
from twinct.specimen import Material

Json = dict[str, Any]


def quantity(value: float | None, unit: str | None = None) -> Json:
    """Return a parameter without drifts."""
    return {"value": value, "unit": unit} if unit else {"value": value}


def vector(values: ArrayLike, names: str = "xyz", unit: str | None = None) -> Json:
    """Return a vector by its components."""
    components = np.asarray(values, dtype=float).tolist()
    return {n: quantity(v, unit) for n, v in zip(names, components, strict=True)}


def placed(
    centre: ArrayLike, first: ArrayLike, third: ArrayLike, keys: Sequence[str] = "uw"
) -> Json:
    """Return a part in the world."""
    return {
        "center": vector(centre, unit="mm"),
        f"vector_{keys[0]}": vector(first),
        f"vector_{keys[1]}": vector(third),
        "deviations": [],
    }


def write_mesh(mesh: Trimesh, file: Path) -> Floats:
    """Write a mesh with its middle at the origin, and return the original middle, (3,), mm."""
    middle = np.asarray(mesh.bounds).mean(axis=0)
    # The single floats of STL would open the seams.
    with complete(file) as draft:
        mesh.copy().apply_translation(-middle).export(draft, digits=12)
    return middle


def sample(name: str, file: Path, material_id: str, position: Json) -> Json:
    """Return a sample whose mesh is in mm."""
    return {
        "name": name,
        "file": {"value": file.name},
        "unit": "mm",
        "scaling_factor": {axis: quantity(1.0) for axis in "rst"},
        "material_id": material_id,
        "position": position,
    }


def material_entry(name: str, density_g_cm3: float, shares: Mapping[str, float]) -> Json:
    """Return a material by mass fractions of formulas."""
    return {
        "id": name,
        "name": name,
        "density": quantity(density_g_cm3, "g/cm^3"),
        "composition": [
            {"formula": {"value": formula}, "mass_fraction": {"value": share}}
            for formula, share in shares.items()
        ],
    }


def as_material(of: Material) -> Json:
    """Return a twinct material as a CTSimU entry."""
    return material_entry(of.name, of.density_g_cm3, of.mass_fractions)


def header(name: str, description: str) -> Json:
    """Return the section ``file``."""
    return {
        "name": name,
        "description": description,
        "file_type": "CTSimU Scenario",
        "file_format_version": {"major": FORMAT[0], "minor": FORMAT[1]},
    }


def make_folder(folder: Path) -> None:
    """Create an output folder unless it exists; raise a ``StorageError`` if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise StorageError(f"{folder} is a file, not a folder") from None
    except OSError as error:
        raise StorageError(f"{folder}: the folder cannot be created: {reason(error)}") from None
