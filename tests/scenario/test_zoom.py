"""A zoom's voxels, and how much of the grid lies around them."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from twinct.core.errors import InputError
from twinct.recon.sections.reconstruction import Grid, Reconstruction
from twinct.scenario import parse_scenario

TURNED = {
    "voxels": [40, 30, 20],
    "voxel_mm": 2,
    "centre_mm": [10, 0, 5],
    "rotation_deg": [0, 0, 90],
}
REST = {
    "trajectory": {"kind": "circle", "views": 4},
    "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 5}}]},
}


def made(**keys: object) -> Reconstruction:
    return parse_scenario({**REST, "reconstruction": {"grid": TURNED, **keys}}).reconstruction


def section(**zoom: object) -> Reconstruction:
    return made(zoom=zoom)


def test_its_voxels_fill_the_region_and_turn_with_the_grid() -> None:
    found = section(centre_mm=(10, 20, 0), size_mm=(12, 10, 9), voxel_mm=0.7)
    grid = found.volume_grid
    np.testing.assert_allclose(grid.size_mm, (12, 10, 9))
    assert grid.shape_xyz == (17, 14, 13)
    np.testing.assert_allclose(grid.world_from_grid.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    assert "zoom with voxels of 0.692 mm" in found.in_words


def test_what_is_taken_out_reaches_to_the_ends_of_the_grid() -> None:
    found = section(centre_mm=(10, 20, 0), size_mm=(12, 10, 9), voxel_mm=0.7).around
    assert found is not None
    # Along its own x, the world's y, the zoom lies 20 mm up; along z 5 mm down.
    below, above = np.array(found.margin_mm)
    np.testing.assert_allclose(below, (40 + 20 - 6, 30 - 5, 20 - 5 - 4.5), atol=1e-9)
    np.testing.assert_allclose(above, (40 - 20 - 6, 30 - 5, 20 + 5 - 4.5), atol=1e-9)
    assert found.voxel_mm == 2
    wide = {"margin_mm": 8, "voxel_mm": 5}
    more = made(
        surroundings=wide, zoom={"centre_mm": (10, 20, 0), "size_mm": 12, "voxel_mm": 1}
    ).around
    assert more is not None and np.array(more.margin_mm).min() == pytest.approx(8 + 9)
    plain = made(surroundings=wide).around
    assert plain is not None and plain.margin_mm == 8


def test_nothing_is_around_the_whole_grid() -> None:
    assert section(centre_mm=(10, 0, 5), size_mm=(80, 60, 40), voxel_mm=1).around is None


def test_a_zoom_beyond_the_grid_is_refused() -> None:
    with pytest.raises(InputError, match=r"zoom reaches 2.0 mm beyond the grid"):
        section(centre_mm=(10, 36, 5), size_mm=12, voxel_mm=1)


def test_a_grid_has_no_more_voxels_along_an_axis_than_numbers_hold() -> None:
    """Found by fuzzing: what no array holds ended in NumPy."""
    for voxels in ((2, 2, 10**30), (2, 1, 2)):
        with pytest.raises(ValidationError, match="must be 2 to 65536 along each axis"):
            Grid(voxels=voxels)
