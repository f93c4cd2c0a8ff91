"""Meshes displace voxels: a titanium rod in a grey body against the same body as meshes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.scenario import Specimen
from twinct.specimen import BuiltPart, GreyField, GreyPart, build_specimen, volume_fractions
from twinct.specimen.grey_caster import GreyCaster
from twinct.xray.engine import SceneBody
from twinct.xray.mesh import MeshEngine

PANEL = Panel(96, 128, 2.5, 2.5)
KEV = 70.0
BODY = {"shape": {"kind": "cylinder", "radius_mm": 60, "height_mm": 100}, "material": "water"}
CORE = {
    "shape": {"kind": "ellipsoid", "semi_axes_mm": (25, 18, 30), "mesh_resolution_mm": 2},
    "material": "bone",
    "position_mm": (5, 3, 0),
}
ROD = {
    "shape": {"kind": "cylinder", "radius_mm": 3, "height_mm": 60},
    "material": "titanium",
    "position_mm": (20, 8, 3),
    "rotation_deg": (20, 30, 0),
}


@cache
def parts(rod: bool) -> tuple[BuiltPart, ...]:
    told = [BODY, CORE, ROD] if rod else [BODY, CORE]
    return build_specimen(Specimen.model_validate({"parts": told})).pure


def voxels(edge: float) -> GreyPart:
    """Body and core as voxels of their volume fractions, in which the rod lies."""
    grid = VolumeGrid([int(n / edge) + 4 for n in (104, 124, 124)], edge)
    solids = parts(rod=False)
    amounts = [
        volume_fractions(p.mesh.vertices, p.mesh.faces, grid, Pose.identity()) for p in solids
    ]
    field = GreyField(tuple(p.material for p in solids), np.stack(amounts, axis=-1), grid)
    body = GreyPart("body", solids[1].material, solids[0].mesh, field)
    return body.without([parts(rod=True)[2].mesh])


def lengths(view: ScanGeometry) -> np.ndarray:
    """Path lengths in body, core and rod by their meshes."""
    engine, images = MeshEngine(), np.empty((3, *PANEL.shape), np.float32)
    bodies = [(np.asarray(p.mesh.vertices), np.asarray(p.mesh.faces)) for p in parts(rod=True)]
    engine.acquire([SceneBody(*body, 1.0) for body in bodies], PANEL)
    for k, image in enumerate(images):
        engine.path_lengths(view, k, image)
    engine.release()
    return images


@pytest.mark.parametrize(("edge", "most"), [(2.0, 0.012), (1.0, 0.006)])
def test_a_rod_in_voxels_is_that_in_meshes(
    edge: float, most: float, figure: Callable[[str], None]
) -> None:
    """RMS over rays through the rod, over its largest line integral; 1 % is asked for at 1 mm."""
    rng, body = np.random.default_rng(37), voxels(edge)
    mu = np.array([p.material.mu_per_mm(KEV) for p in parts(rod=True)])
    squares, largest = [], 0.0
    caster = GreyCaster(body.field, PANEL)
    for _ in range(3):
        turn = Pose(np.zeros(3), Rotation.random(random_state=rng).as_quat())
        front = ScanGeometry([[600, 0, 0]], [[-300, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], PANEL)
        view = turn @ front
        through = lengths(view)
        grey = np.tensordot(mu[:2], caster.cast(view), 1) + mu[2] * through[2]
        error = grey - np.tensordot(mu, through, 1)
        squares.append(np.square(error[through[2] > 0]))
        largest = max(largest, float(mu[2] * through[2].max()))
    found = float(np.sqrt(np.concatenate(squares).mean())) / largest
    figure(f"voxels of {edge:g} mm: {100 * found:.2f} % of the rod's largest line integral")
    assert found <= most
