"""A file in another unit shows in its size beside the field of view and the voxels."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from twinct.geometry import Panel, VolumeGrid
from twinct.scenario import Specimen
from twinct.specimen import build_specimen, specimen_size
from twinct.trajectory import CircleTrajectory, commanded_views

PANEL = Panel(480, 640, 0.5, 0.5)


def size_of(*parts, position_mm=(0, 0, 0), voxel=0.5):
    section = Specimen.model_validate({"parts": list(parts), "position_mm": position_mm})
    orbit = CircleTrajectory(kind="circle", views=8, sod_mm=300, sdd_mm=600)
    built = build_specimen(section)
    grid = VolumeGrid((100, 200, 300), (voxel,) * 3, built.world_from_specimen)
    return specimen_size(section, built, commanded_views(orbit, PANEL), grid)


@pytest.fixture
def block(tmp_path):
    """An STL of a block, its edges in some unit."""

    def make(*edges):
        trimesh.creation.box(edges).export(tmp_path / "block.stl")
        return {"name": "block", "shape": {"kind": "mesh", "path": tmp_path / "block.stl"}}

    return make


def test_specimen_field_of_view_and_grid_stand_side_by_side(block):
    size = size_of(block(80, 60, 40))
    assert size.specimen_mm == pytest.approx((80, 60, 40))
    assert size.field_mm == pytest.approx((160, 120))
    assert size.grid_mm == pytest.approx((150, 100, 50))
    assert str(size) == "80 x 60 x 40 mm; field of view 160 x 120 mm, grid 150 x 100 x 50 mm"
    assert not size.warnings


def test_the_field_of_view_is_that_of_the_narrowest_view(block):
    size = size_of(block(80, 60, 40), position_mm=(100, 0, 0))
    np.testing.assert_allclose(size.field_mm, np.array([160, 120]) * 200 / 300, rtol=1e-6)


@pytest.mark.parametrize(
    ("edge", "unit"),
    [(0.08, "1000 (metres)"), (3.2, "25.4 (inches)"), (80_000, "0.001 (micrometres)")],
)
def test_a_mesh_in_another_unit_is_told_with_the_unit_that_fits(block, edge, unit):
    (warning,) = size_of(block(edge, edge, edge / 2), voxel=1.0).warnings
    assert warning.startswith(f"part 'block' measures {edge:.3g} x {edge:.3g} x {edge / 2:.3g} mm")
    assert f"specimen.parts.0.shape.unit_mm is 1; {unit} would make it 8" in warning


def test_a_table_larger_than_the_beam_is_no_mistake(block):
    table = {"shape": {"kind": "box", "size_mm": [300, 4, 600]}, "position_mm": [0, -60, 0]}
    assert not size_of(block(80, 60, 40), table).warnings


def test_a_tiny_part_beside_others_is_told_and_a_thin_one_is_not(block):
    ball = {"shape": {"kind": "sphere", "radius_mm": 0.2}, "position_mm": [50, 0, 0]}
    foil = {"shape": {"kind": "box", "size_mm": [0.01, 40, 40]}, "position_mm": [60, 0, 0]}
    (warning,) = size_of(block(80, 60, 40), ball, foil).warnings
    assert warning.startswith("part 'sphere' measures 0.4 x 0.4 x 0.4 mm, less than 4 voxels")
    assert "unit_mm" not in warning
