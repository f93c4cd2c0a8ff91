"""Voxel truth and disjoint parts, against what geometry says."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from twinct.core.errors import SpecimenError
from twinct.geometry import Pose, VolumeGrid
from twinct.scenario import Specimen
from twinct.specimen import build_specimen, material, volume_fractions

ENERGY = 80.0
MESH_REL = 1e-3
"""Tessellation may miss the analytic volume by this much."""
SAMPLED_REL = 1e-3
"""4 x 4 lines per voxel over thousands of voxels: the surface's sampling noise averages out."""
EXACT = 1e-5
"""float32 rounding of a voxel value."""


def build(*parts, **pose):
    return build_specimen(Specimen.model_validate({"parts": list(parts), **pose}))


def part(kind, material="bone", position=(0, 0, 0), rotation=(0, 0, 0), **shape):
    return {
        "name": f"{kind} of {material}",
        "shape": {"kind": kind, **shape},
        "material": material,
        "position_mm": position,
        "rotation_deg": rotation,
    }


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        ({"kind": "sphere", "radius_mm": 20}, 4 / 3 * math.pi * 20**3),
        ({"kind": "ellipsoid", "semi_axes_mm": (10, 20, 30)}, 4 / 3 * math.pi * 6000),
        ({"kind": "cylinder", "radius_mm": 8, "height_mm": 30}, math.pi * 64 * 30),
        ({"kind": "box", "size_mm": (10, 20, 30)}, 6000),
    ],
)
def test_primitives_enclose_their_volume_in_mesh_and_truth(shape, volume):
    built = build(part(**shape))
    mesh = built.parts[0].mesh
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(volume, rel=MESH_REL)
    grid = VolumeGrid((70, 60, 50), 1.0)
    truth = built.truth(grid, ENERGY)
    assert truth.dtype == np.float32 and truth.shape == grid.shape
    assert truth.sum() / built.reference_mu(ENERGY) == pytest.approx(volume, rel=2 * SAMPLED_REL)
    size = np.ptp(built.bounds, axis=0)
    wanted = shape.get("size_mm") or [
        2 * r for r in shape.get("semi_axes_mm", [shape.get("radius_mm")] * 3)
    ]
    if "height_mm" in shape:
        wanted[2] = shape["height_mm"]
    assert size == pytest.approx(wanted, rel=MESH_REL)


def test_each_voxel_of_a_sphere_has_its_volume_fraction():
    """Against brute force: 16^3 points a voxel."""
    radius, grid = 5.0, VolumeGrid((13, 12, 11), 1.0, Pose.identity())
    truth = build(part("sphere", radius_mm=radius)).truth(grid, ENERGY)
    fine = (np.arange(16) + 0.5) / 16 - 0.5
    x, y, z = (np.add.outer(axis, fine).ravel() for axis in grid.axes())
    inside = x[None, None] ** 2 + y[None, :, None] ** 2 + z[:, None, None] ** 2 < radius**2
    fractions = inside.reshape(13, 16, 12, 16, 11, 16).mean(axis=(1, 3, 5))
    found = truth / material("bone").mu_per_mm(ENERGY)
    # 16 lines a voxel: a voxel that the surface cuts edge-on may be off by one or two of them.
    assert np.abs(found - fractions).max() < 2 / 16
    assert np.sqrt(np.mean((found - fractions) ** 2)) < 0.01
    assert (found[fractions == 0] < 0.02).all()


def test_a_box_on_voxel_borders_fills_its_voxels_and_no_other():
    """Faces exactly on voxel borders; no two axes alike, so they cannot be mixed up."""
    built = build(part("box", size_mm=(2, 4, 6), position=(3, -2, 5)))
    truth = built.truth(VolumeGrid((20, 18, 16), 1.0), ENERGY)
    wanted = np.zeros((20, 18, 16))
    wanted[12:18, 5:9, 10:12] = built.reference_mu(ENERGY)
    assert truth == pytest.approx(wanted, rel=EXACT, abs=0)


def test_sample_lines_through_edges_and_vertices_leave_no_streak():
    """Faces exactly on the sample lines (multiples of 1/8 voxel), edges and vertices among them."""
    for offset in (0.125, 0.375):
        built = build(part("box", size_mm=(4, 4, 4), position=(0, offset, offset)))
        truth = built.truth(VolumeGrid((12, 12, 12), 1.0), ENERGY) / built.reference_mu(ENERGY)
        assert truth.sum() == pytest.approx(64, rel=EXACT)
        assert truth.max() <= 1 + EXACT and truth.min() >= 0
        assert not truth[:, :, 8:].any() and not truth[:, :, :4].any()
    octahedron = trimesh.Trimesh(
        [(3, 0, 0), (-3, 0, 0), (0, 3, 0), (0, -3, 0), (0, 0, 3), (0, 0, -3)],
        [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)],
        process=False,
    )
    grid = VolumeGrid((9, 9, 9), 1.0)
    pose = Pose(np.array([0.0, 0.125, -0.125]), np.array([0.0, 0.0, 0.0, 1.0]))
    fractions = volume_fractions(octahedron.vertices, octahedron.faces, grid, pose)
    assert fractions.sum() == pytest.approx(octahedron.volume, rel=0.01)
    assert not fractions[..., -1].any()


def test_grid_shifted_and_rotated_sees_the_specimen_where_it_stands():
    built = build(
        part("box", size_mm=(6, 10, 16)), position_mm=(30, -20, 10), rotation_deg=(0, 0, 90)
    )
    mu = built.reference_mu(ENERGY)
    shifted = VolumeGrid((20, 20, 20), 1.0, Pose.from_euler((30, -20, 10), (0, 0, 0)))
    turned = VolumeGrid((20, 20, 20), 1.0, Pose.from_euler((30, -20, 10), (0, 0, 90)))
    along_world = built.truth(shifted, ENERGY) / mu
    along_box = built.truth(turned, ENERGY) / mu

    def extent(a):
        return [int(n) for n in np.ptp(np.argwhere(a > 0.5), axis=0) + 1]

    assert extent(along_world) == [16, 6, 10]
    assert extent(along_box) == [16, 10, 6]
    centre = np.argwhere(along_world > 0.5).mean(axis=0)
    assert centre == pytest.approx([9.5] * 3, abs=1e-6)
    moved = built.truth(shifted, ENERGY, Pose.from_euler((32, -20, 10), (0, 0, 90))) / mu
    assert np.argwhere(moved > 0.5).mean(axis=0) == pytest.approx([9.5, 9.5, 11.5], abs=1e-6)


@pytest.mark.parametrize("rotation", [(0, 0, 0), (20, -35, 50)])
def test_volume_is_conserved_on_any_grid(rotation):
    built = build(part("ellipsoid", semi_axes_mm=(9, 14, 20)))
    grid = VolumeGrid((80, 60, 64), (0.9, 1.1, 0.7), Pose.from_euler((1.3, -2.2, 0.4), rotation))
    total = built.truth(grid, ENERGY).sum(dtype=float) * np.prod(grid.voxel)
    wanted = built.parts[0].mesh.volume * built.reference_mu(ENERGY)
    assert total == pytest.approx(wanted, rel=SAMPLED_REL)


def test_a_grid_that_cuts_the_specimen_equals_the_middle_of_a_larger_one():
    built = build(part("sphere", radius_mm=20))
    large = built.truth(VolumeGrid((50, 50, 50), 1.0), ENERGY)
    small = built.truth(VolumeGrid((20, 18, 16), 1.0), ENERGY)
    assert np.array_equal(small, large[15:35, 16:34, 17:33])


def test_the_later_part_wins_and_volumes_add_up():
    bone = part("sphere", radius_mm=20)
    screw = part("cylinder", "titanium", (0, 5, 0), (0, 90, 0), radius_mm=3, height_mm=60)
    built = build(bone, screw)
    alone = build(bone)
    rod = built.parts[1].mesh
    common = trimesh.boolean.intersection([alone.parts[0].mesh, rod], engine="manifold")
    assert built.parts[1].volume_mm3 == pytest.approx(math.pi * 9 * 60, rel=MESH_REL)
    assert built.parts[0].volume_mm3 == pytest.approx(
        alone.parts[0].volume_mm3 - common.volume, rel=1e-6
    )
    assert all(p.mesh.is_watertight and p.mesh.volume > 0 for p in built.parts)
    truth = built.truth(VolumeGrid((64, 64, 64), 1.0), ENERGY)
    mu_bone, mu_ti = (material(name).mu_per_mm(ENERGY) for name in ("bone", "titanium"))
    assert truth.max() == pytest.approx(mu_ti, rel=EXACT)
    assert truth[32, 37, 32] == pytest.approx(mu_ti, rel=EXACT)
    assert truth[32, 25, 32] == pytest.approx(mu_bone, rel=EXACT)
    wanted = sum(p.volume_mm3 * p.material.mu_per_mm(ENERGY) for p in built.parts)
    assert truth.sum(dtype=float) == pytest.approx(wanted, rel=2 * SAMPLED_REL)
    assert built.reference_mu(ENERGY) == pytest.approx(mu_bone)


def test_a_void_in_a_part_is_empty():
    shell = build(part("sphere", radius_mm=20), part("sphere", "air", radius_mm=17))
    outer = shell.parts[0]
    assert outer.volume_mm3 == pytest.approx(4 / 3 * math.pi * (20**3 - 17**3), rel=5 * MESH_REL)
    truth = shell.truth(VolumeGrid((44, 44, 44), 1.0), ENERGY)
    assert truth[22, 22, 22] == pytest.approx(material("air").mu_per_mm(ENERGY), rel=EXACT)


def test_hull_and_bounds_cover_all_parts(inside):
    built = build(part("sphere", radius_mm=5), part("box", size_mm=(2, 2, 2), position=(30, 0, 0)))
    assert built.bounds == pytest.approx(np.array([(-5, -5, -5), (31, 5, 5)]), rel=MESH_REL)
    hull = built.hull
    assert hull.is_watertight and hull.bounds == pytest.approx(built.bounds)
    assert inside(hull, [(20, 0, 0)])[0]


def test_a_part_that_later_ones_swallow_is_refused():
    with pytest.raises(SpecimenError, match="'box of bone' is empty"):
        build(part("box", size_mm=(2, 2, 2)), part("sphere", "titanium", radius_mm=9))


def test_every_problem_is_named_at_once():
    with pytest.raises(SpecimenError) as caught:
        build(part("sphere", "bonne", radius_mm=5), part("mesh", path="no-such.stl"))
    assert len(caught.value.problems) == 2
    assert "bonne" in caught.value.problems[0] and "no-such.stl" in caught.value.problems[1]


def test_full_size_truth_has_the_bodys_volume():
    """512^3 with 500 k triangles; seconds: benchmarks/bench_truth.py."""
    ball = trimesh.creation.icosphere(subdivisions=7, radius=75.0)
    grid = VolumeGrid((512, 512, 512), 0.31)
    volume = volume_fractions(ball.vertices, ball.faces, grid, Pose.identity())
    assert volume.sum(dtype=float) * 0.31**3 == pytest.approx(ball.volume, rel=1e-4)
