"""Scenarios to start from: a built-in one around what the user has, an object or arms."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.files.meshes import read_mesh
from twinct.scenario.loading import load_scenario

BESIDE = 1.1
"""Smallest width of the field of view, in diameters of the part."""

ARMS = ("demo", "wide_panel")
"""Built-in scenarios with arms for a part, by increasing field of view."""

LEAST_PIXEL_MM = 0.1
"""Edge of a pixel below which a part is rather stated in a wrong unit."""


@dataclass(frozen=True)
class Start:
    """A built-in scenario, and what differs from it.

    Attributes:
        name: name of the built-in scenario.
        changes: values by dotted key.
        size_mm: lengths of a part from a file along x, y and z.
    """

    name: str = "demo"
    changes: dict[str, Any] = field(default_factory=dict[str, Any])
    size_mm: tuple[float, ...] | None = None

    def with_arms(self, file: Path) -> Start:
        """Return the start with two arms from an MJCF or URDF file."""
        arm = {"model": None, "file": str(file)}
        keys = {
            f"cell.{side}_arm.{key}": value
            for side in ("source", "detector")
            for key, value in arm.items()
        }
        return replace(self, changes=self.changes | keys)


def start_from_mesh(file: Path, unit_mm: float = 1.0) -> Start:
    """Return a scan of aluminium in the shape of a closed surface, in the middle of the beam.

    Pixels and voxels fit its size: with arms if the panel that they carry is large enough, else
    on a gantry that is larger by the factor that the part needs.

    Args:
        file: mesh file.
        unit_mm: length of one unit of the file.

    Raises:
        SpecimenError: the file holds no closed surface.
    """
    mesh = read_mesh(file, str(file))
    size = unit_mm * np.ptp(mesh.bounds, axis=0)
    size_mm, diameter = tuple(map(float, size)), BESIDE * float(np.linalg.norm(size))
    shape = {"kind": "mesh", "path": str(file), "centre": True}
    shape |= {} if unit_mm == 1 else {"unit_mm": unit_mm}
    part = {"name": file.stem, "shape": shape}
    changes: dict[str, Any] = {
        "name": file.stem,
        "description": f"A scan of {file.name}.",
        "specimen.parts": [part | {"material": "aluminium"}],
    }
    fields = {name: _field_mm(name) for name in ARMS}
    fitting = [name for name, width in fields.items() if width >= diameter]
    if fitting:
        scale = diameter / fields[fitting[0]]
        return Start(fitting[0], changes | _detail(fitting[0], scale), size_mm)
    name = "circle_gantry"
    path, scale = load_scenario(name).trajectory, diameter / _field_mm(name)
    distances = {
        f"trajectory.{key}": _round(scale * getattr(path, key)) for key in ("sod_mm", "sdd_mm")
    }
    return Start(name, changes | distances | _detail(name, scale), size_mm)


def start_from_ct(file: Path) -> Start:
    """Return a scan of a patient's CT, or of any other CT in HU, with all its grey values."""
    part = {"name": "patient", "shape": {"kind": "volume", "path": str(file)}, "material": "bone"}
    small = load_scenario("demo")
    panel, grid = small.detector.panel, small.reconstruction.volume_grid
    return Start(
        "patient_head",
        {
            "name": file.name.partition(".")[0],
            "description": f"A scan of {file.name}, in the vertical plane across the patient.",
            "specimen.parts": [part],
            "specimen.reference": "patient",
            "trajectory.views": 100,
            "detector.columns": panel.columns,
            "detector.rows": panel.rows,
            "detector.pixel_pitch_mm": small.detector.pixel_pitch_mm,
            "reconstruction.grid": {"voxels": grid.shape[0], "voxel_mm": float(grid.voxel[0])},
        },
    )


def _field_mm(name: str) -> float:
    """Return the width of the field of view of a built-in scenario."""
    scenario = load_scenario(name)
    path: Any = scenario.trajectory
    return min(scenario.detector.panel.size_mm) * path.sod_mm / path.sdd_mm


def _detail(name: str, scale: float) -> dict[str, float]:
    """Return pixels and voxels of a built-in scenario for another field of view."""
    scenario = load_scenario(name)
    pixel, voxel = scenario.detector.panel.pitch_u, scenario.reconstruction.volume_grid.voxel[0]
    scale = max(scale, LEAST_PIXEL_MM / pixel)
    return {
        "detector.pixel_pitch_mm": _round(scale * pixel),
        "reconstruction.grid.voxel_mm": _round(scale * float(voxel)),
    }


def _round(length: float) -> float:
    return float(f"{length:.3g}")
