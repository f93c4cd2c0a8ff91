"""The built-in grey phantom: what is where, and how a grid samples it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twinct.geometry import Pose, VolumeGrid
from twinct.scenario import Specimen, load_scenario
from twinct.specimen import build_specimen, material
from twinct.specimen.implicit import ball
from twinct.specimen.organs import CELLS_PER_WAVE, TILE, Organ, random_field
from twinct.specimen.phantom import Phantom, phantom
from twinct.specimen.skull import skull_surface

SCENARIOS = Path(__file__).parents[2] / "scenarios"


@pytest.fixture(scope="module")
def head():
    return phantom("head", 1)


@pytest.fixture(scope="module")
def trunk():
    return phantom("trunk", 1)


def centres(grid: VolumeGrid, shift=(0.0, 0.0, 0.0)):
    """Voxel centres (nz, ny, nx, 3), shifted by a share of a voxel."""
    z, y, x = np.indices(grid.shape)
    index = np.stack([x, y, z], axis=-1) + np.asarray(shift)
    return index @ grid.affine[:3, :3].T + grid.affine[:3, 3]


@pytest.mark.parametrize("name", ["head", "trunk"])
def test_a_grid_holds_the_values_at_its_points_in_any_order(name, head, trunk):
    """Blocks of voxels look up few bodies, points in random order many: the values are the same."""
    body = {"head": head, "trunk": trunk}[name]
    turned = VolumeGrid((30, 24, 27), 5.7, Pose.from_euler((8, -3, 5), (20, -35, 50)))
    volume, points = body.on(turned, samples=1), centres(turned).reshape(-1, 3)
    shuffled = np.random.default_rng(0).permutation(len(points))
    hu, labels = body.at(points[shuffled])
    assert np.array_equal(labels, volume.labels.ravel()[shuffled])
    assert np.abs(hu - volume.hu.ravel()[shuffled]).max() < 0.01
    assert len(np.unique(labels)) > 15


def test_voxels_at_surfaces_hold_means_and_others_hardly_differ(head):
    grid = VolumeGrid((36, 36, 36), 1.5, Pose.from_euler((40, 30, 10), (0, 0, 0)))
    shifts = [(a, b, c) for a in (-0.25, 0.25) for b in (-0.25, 0.25) for c in (-0.25, 0.25)]
    means = np.mean([head.at(centres(grid, shift))[0] for shift in shifts], axis=0)
    found, single = head.on(grid).hu, head.on(grid, samples=1).hu
    assert np.sqrt(np.mean((found - means) ** 2)) < 0.02 * np.sqrt(np.mean((single - means) ** 2))
    assert np.abs(found - means).max() < 25


def test_a_ball_has_its_volume():
    radius, hu = 9.3, 250.0
    body = Phantom((Organ("ball", hu, (ball((1, 2, 3), radius),), edge_mm=0),))
    volume = body.on(VolumeGrid((24, 24, 24), 1.0), samples=4)
    share = (volume.hu + 1000) / (hu + 1000)
    assert share.sum() == pytest.approx(4 / 3 * np.pi * radius**3, rel=2e-3)
    assert volume.names == ("background", "ball")
    assert body.bounds == pytest.approx(np.add([[1, 2, 3]], [[-radius], [radius]]), abs=4)


def test_the_skull_is_the_built_in_one_at_its_place(head):
    mesh = skull_surface(1.0, 2.0)
    labels = head.on(head.grid(2.5), samples=1).labels
    bone = np.isin(labels, [head.names.index(name) for name in ("skull", "teeth")])
    assert bone.sum() * 2.5**3 == pytest.approx(mesh.volume, rel=0.02)
    inside = mesh.triangles_center - 1.2 * mesh.face_normals
    told = head.at(inside)[1]
    assert np.mean([head.names[i] in ("skull", "teeth") for i in told]) > 0.95


@pytest.mark.parametrize(
    ("name", "point", "label", "low", "high"),
    [
        ("head", (20, -20, 45), "brain", 20, 45),
        ("head", (9, 6, 19), "ventricles", 0, 14),
        ("head", (31, 68, 5), "eye", 0, 14),
        ("head", (0, 6, -70), "airways", -1000, -970),
        ("head", (0, 300, 0), "background", -1000, -1000),
        ("trunk", (75, 0, 60), "lung_right", -950, -740),
        ("trunk", (70, 20, -92), "liver", 75, 125),
        ("trunk", (-38, 26, -6), "heart_chambers", 170, 190),
        ("trunk", (-56, 48, -88), "stomach_gas", -1000, -940),
        ("trunk", (0, -44.8, -196), "vertebrae_L4", -60, 520),
        ("trunk", (0, -108, 0), "fat", -160, -40),
    ],
)
def test_tissues_lie_where_they_should(name, point, label, low, high, head, trunk):
    body = {"head": head, "trunk": trunk}[name]
    hu, index = body.at(point)
    assert body.names[index] == label
    assert low <= hu <= high


def test_every_organ_is_somewhere(head, trunk):
    for body in (head, trunk):
        seen = np.unique(body.on(body.grid(3.0), samples=1).labels)
        assert [body.names[i] for i in range(len(body.names)) if i not in seen] == []


def test_bone_is_a_continuous_texture_between_hard_walls(trunk):
    """No piecewise constant body: half a voxel away the density is similar, but not the same."""
    grid = VolumeGrid((60, 90, 110), 0.5, Pose.from_euler((0, -45, -196), (0, 0, 0)))
    volume = trunk.on(grid, samples=1)
    bone = volume.labels == trunk.names.index("vertebrae_L4")
    values = volume.hu[bone]
    assert len(np.unique(values)) > 0.99 * len(values)
    assert np.quantile(values, 0.99) > 600 > 350 > np.median(values) > 130
    core = volume.hu[24:-24, 35:-35, 45:-45]
    steps = np.diff(core, axis=2).std() / core.std()
    assert 0.2 < steps < 1.0


def test_the_texture_has_its_band_and_its_seed():
    field = random_field(3)
    assert np.array_equal(field, random_field(3))
    assert not np.allclose(field, random_field(4), atol=0.5)
    assert field.std() == pytest.approx(1, abs=1e-4)
    power = np.abs(np.fft.fftn(field)) ** 2
    waves = np.sqrt(sum(f * f for f in np.meshgrid(*[np.fft.fftfreq(TILE)] * 3, indexing="ij")))
    short, long = CELLS_PER_WAVE
    assert power[(waves > 1.001 / short) | (waves < 0.999 / long)].sum() < 1e-6 * power.sum()


def test_a_seed_changes_lesions_and_texture_but_no_anatomy(head):
    other, grid = phantom("head", 2), head.grid(3.0)
    one, two = head.on(grid, samples=1), other.on(grid, samples=1)
    lesions = [i for i, name in enumerate(head.names) if name.startswith("lesion")]
    same = ~np.isin(one.labels, lesions) & ~np.isin(two.labels, lesions)
    assert np.array_equal(one.labels[same], two.labels[same])
    assert not np.array_equal(one.labels, two.labels)
    bone = one.labels == head.names.index("skull")
    assert 20 < (one.hu - two.hu)[bone].std() < 400


def test_a_scenario_scans_the_phantom_with_its_labels(trunk):
    told = {"kind": "volume", "phantom": "trunk", "voxel_mm": 4, "seed": 1, "centre": False}
    section = Specimen.model_validate({"parts": [{"shape": told}], "reference": "vertebrae_L1"})
    specimen = build_specimen(section)
    (part,) = specimen.mixtures
    grid = part.field.grid
    hu, labels = trunk.at(centres(grid))
    assert part.labels is not None
    names = np.array(["background", *part.labels.names])
    assert np.array_equal(names[part.labels.values], np.array(trunk.names)[labels])
    water = material("water").mu_per_mm(70)
    found = part.field.mu_per_mm(70) / water * 1000 - 1000
    lung = labels == trunk.names.index("lung_left")
    assert found[lung].mean() == pytest.approx(hu[lung].mean(), abs=30)  # hu are at centres
    assert part.mesh.bounds == pytest.approx(trunk.bounds, abs=4)
    assert not part.cuts
    assert specimen.reference_mu(70) > 1.1 * water


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "path and phantom are both null"),
        ({"phantom": "head", "path": "a.nii"}, "path and phantom exclude each other"),
        ({"path": "a.nii", "seed": 3}, "seed: only allowed with phantom"),
        ({"phantom": "head", "interpolate_slices": True}, "interpolate_slices: only allowed"),
        ({"phantom": "head", "labels": {"path": "b.nii"}}, "labels: only allowed with path"),
        ({"phantom": "leg"}, "head"),
        ({"phantom": "head", "voxel_mm": 0.01}, "0.3"),
        (
            {"phantom": "head", "calibration": {"kind": "attenuation", "energy_kev": 60}},
            "values are HU",
        ),
    ],
)
def test_keys_that_do_not_fit_are_refused(keys, message):
    with pytest.raises(ValueError, match=message):
        Specimen.model_validate({"parts": [{"shape": {"kind": "volume", **keys}}]})


def test_the_obstacle_keeps_the_safety_distance_on_all_sides():
    ball = {"kind": "ellipsoid", "semi_axes_mm": [30, 20, 10], "mesh_resolution_mm": 3}
    specimen = build_specimen(Specimen.model_validate({"parts": [{"shape": ball}]}))
    assert specimen.hulls == specimen.obstacles(0.0) == (specimen.hull,)
    (grown,) = specimen.obstacles(25.0)
    gaps = -np.array(
        [
            (grown.face_normals * (point - grown.triangles_center)).sum(1).max()
            for point in specimen.hull.vertices
        ]
    )
    assert gaps.min() > 24.8
    assert np.abs(grown.bounds).max(axis=0) == pytest.approx([55, 45, 35], abs=1.2)


def beyond(hull, points):
    """Return how far points (n, 3) are outside a convex body; negative inside."""
    heights = np.einsum("ij,ij->i", hull.face_normals, hull.triangles[:, 0])
    return (points @ hull.face_normals.T - heights).max(axis=1)


def test_skin_and_plate_are_bodies_of_their_own():
    """The arms may go beside the neck, and under the plate, where the hull of all is closed."""
    told = load_scenario(SCENARIOS / "patient_head.yaml").specimen.model_dump(mode="json")
    told["parts"][0]["shape"] |= {"voxel_mm": 6}
    specimen = build_specimen(Specimen.model_validate(told))
    skin, plate = (np.asarray(part.mesh.vertices) for part in specimen.parts)
    *heads, table = specimen.hulls
    assert len(heads) > 1 and beyond(table, plate).max() < 1e-6
    # A hull of few corners cuts off less than a millimetre.
    assert np.min([beyond(hull, skin) for hull in heads], axis=0).max() < 1
    assert sum(hull.volume for hull in specimen.hulls) < 0.5 * specimen.hull.volume
    grown = specimen.obstacles(25.0)
    assert len(grown) == len(specimen.hulls)
    assert all(  # the margin's corners lie in 4,000 directions, 3 degrees apart
        beyond(big, hull.vertices).max() < -24.8
        for big, hull in zip(grown, specimen.hulls, strict=True)
    )


@pytest.mark.parametrize("name", ["patient_head", "patient_spine"])
def test_patients_lie_on_their_tables_with_a_safety_distance(name):
    scenario = load_scenario(SCENARIOS / f"{name}.yaml")
    assert scenario.trajectory.views == 200
    assert scenario.motion.clearance_mm + scenario.specimen.safety_mm >= 30
    told = scenario.specimen.model_dump(mode="json")
    told["parts"][0]["shape"] |= {"voxel_mm": 6}
    patient, table = build_specimen(Specimen.model_validate(told)).parts
    gap = patient.mesh.bounds[0, 1] - table.mesh.bounds[1, 1]
    assert 0 <= gap < 6
    assert table.material.mu_per_mm(80) * 4 > 0.1
    wide = np.ptp(table.mesh.bounds, axis=0)
    assert wide[0] > 0.9 * np.ptp(patient.mesh.bounds, axis=0)[0]
