"""A sketch keeps the extent and the look of a surface, with few faces."""

from __future__ import annotations

import numpy as np
import trimesh

from twinct.specimen.sketch import CELLS, sketch


def test_a_sketch_is_near_the_surface_and_smaller() -> None:
    mesh = trimesh.creation.icosphere(7, 90.0)
    coarse = sketch(mesh)
    assert len(coarse.faces) < len(mesh.faces) / 3
    radii = np.linalg.norm(coarse.vertices, axis=1)
    assert np.abs(radii - 90).max() < 180 / CELLS
    assert np.allclose(coarse.bounds, mesh.bounds, atol=180 / CELLS)


def test_a_small_mesh_stays_as_it_is() -> None:
    mesh = trimesh.creation.box((10, 20, 30))
    coarse = sketch(mesh)
    assert len(coarse.faces) == 12
    assert np.allclose(coarse.bounds, mesh.bounds)
