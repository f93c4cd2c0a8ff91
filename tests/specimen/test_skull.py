"""The built-in skull, measured as an anatomist would: calipers, wall thickness, openings."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import VolumeGrid
from twinct.scenario import Specimen
from twinct.specimen import build_specimen
from twinct.specimen.build import HULL_DIRECTIONS, _sphere_directions
from twinct.specimen.preview import preview_specimen, shaded
from twinct.specimen.surface import enclosed_volume, surface

SPECIMEN = Specimen.model_validate({"parts": [{"shape": {"kind": "skull"}}]})
STEP = 0.5
"""Grid of the measurements, mm: a length read from it is right within one step."""


@pytest.fixture(scope="module")
def skull():
    return build_specimen(SPECIMEN)


@pytest.fixture(scope="module")
def solid(skull):
    """(z, y, x) bool on half-millimetre voxels, with the coordinates of each axis."""
    grid = VolumeGrid((430, 390, 300), STEP)
    mu = skull.reference_mu(80.0)
    return skull.truth(grid, 80.0) > 0.5 * mu, grid.axes()


def along(solid, *, x=None, y=None, z=None):
    """The line of voxels through a point; the free coordinate is None."""
    volume, axes = solid
    index = [
        slice(None) if at is None else int(np.abs(axis - at).argmin())
        for axis, at in zip(axes, (x, y, z), strict=True)
    ]
    return volume[index[2], index[1], index[0]], axes[[x, y, z].index(None)]


def runs(line, axis):
    """Stretches of bone along a line: (start, end) in mm."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(int)))
    return [(axis[a], axis[b - 1]) for a, b in edge.reshape(-1, 2)]


def test_closed_and_consistent(skull):
    mesh = skull.parts[0].mesh
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume > 0
    assert len(mesh.faces) < 700_000


def test_adult_size_and_centred(skull):
    size = np.ptp(skull.bounds, axis=0)
    assert skull.bounds.mean(axis=0) == pytest.approx([0, 0, 0], abs=1e-6)
    assert 138 < size[0] < 150
    assert 178 < size[1] < 195
    assert 195 < size[2] < 225


def test_vault_is_180_by_145_by_135(solid):
    # Glabella to occiput, greatest breadth, vertex to the front edge of the foramen magnum.
    volume, (x, y, z) = solid
    above = volume[z > 20]
    rows, columns = above.any(axis=(0, 2)), above.any(axis=(0, 1))
    assert np.ptp(y[rows]) == pytest.approx(180, abs=8)
    assert np.ptp(x[columns]) == pytest.approx(145, abs=5)
    line, _ = along(solid, x=0, y=-5)
    skull_base = [start for start, _ in runs(line, z) if start < 0]
    assert z.max() > 100 > z[line].max() - 10
    assert z[line].max() - max(skull_base) == pytest.approx(135, abs=20)


def test_vault_wall_is_5_to_8_mm(solid, skull):
    """Along normals of the vault, away from ridges and sutures."""
    volume, (x, y, z) = solid
    middle = np.array([0.0, -14.0, 38.0])
    thickness = []
    for azimuth in np.radians(np.arange(10, 360, 20)):
        for height in np.radians([25, 45, 70]):
            ray = np.array(
                [np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)]
            )
            steps = np.arange(20, 110, 0.25)
            points = middle + steps[:, None] * ray
            i, j, k = (
                np.abs(axis[:, None] - points[:, d]).argmin(axis=0)
                for d, axis in enumerate((x, y, z))
            )
            bone = volume[k, j, i]
            if bone.any():
                thickness.append(bone.sum() * 0.25)
    assert len(thickness) == 54
    # The ray meets the wall at up to 35 degrees: it sees a little more than the thickness.
    assert 5.0 < np.median(thickness) < 8.0
    assert min(thickness) > 4.5 and max(thickness) < 10.5


def test_symmetric(solid):
    volume, _ = solid
    different = volume != volume[:, :, ::-1]
    assert different.sum() < 1e-3 * volume.sum()


def test_faces_y_and_stands_upright(solid):
    """Teeth and jaw are in front and below, the vault above and behind."""
    volume, (_, y, z) = solid
    assert np.average(y, weights=volume[z < -50].sum(axis=(0, 2))) > 30
    assert np.average(y, weights=volume[z > 50].sum(axis=(0, 2))) < 0


@pytest.mark.parametrize("side", [-1, 1])
def test_orbits_are_open_sockets_with_a_bridge_between(solid, side):
    line, y = along(solid, x=side * 33, z=4)
    first = max(end for _, end in runs(line, y))
    assert first < 60, "the ray into the socket must run deep before it meets bone"
    across, x = along(solid, y=60, z=4)
    width = [b - a for a, b in runs(~across, x) if a < side * 33 < b]
    assert width and 30 < width[0] < 44
    upright, z = along(solid, x=side * 33, y=68)
    height = [b - a for a, b in runs(~upright, z) if a < 4 < b]
    assert height and 30 < height[0] < 42
    bridge = [b - a for a, b in runs(along(solid, y=75, z=4)[0], x) if a < 0 < b]
    assert bridge and 20 < bridge[0] < 32, "there must be bone between the sockets"


def test_nasal_aperture_is_open_and_pear_shaped(solid):
    widths = []
    for height in (-10, -18, -27):
        line, x = along(solid, y=83, z=height)
        middle = [b - a for a, b in runs(~line, x) if a < 1 < b and b - a < 60]
        widths.append(middle[0] if middle else 0.0)
    assert 3 < widths[0] < widths[1] < widths[2] + STEP
    assert 18 < widths[2] < 30
    line, y = along(solid, x=6, z=-26)
    assert max(end for _, end in runs(line, y)) < 70


@pytest.mark.parametrize("side", [-1, 1])
def test_cheek_arch_stands_off_the_skull(solid, side):
    """Between the arch and the skull the jaw muscle's gap is open from top to bottom."""
    line, x = along(solid, y=20, z=-14)
    arch = [(a, b) for a, b in runs(line, x) if 55 < side * (a + b) / 2 < 70]
    assert len(arch) == 1 and 3 < arch[0][1] - arch[0][0] < 10
    inner = min(np.abs(arch[0]))
    gap = [b - a for a, b in runs(~line, x) if np.isclose(np.abs([a, b]), inner, atol=1).any()]
    assert gap and gap[0] > 10


def test_foramen_magnum_lets_a_ray_into_the_braincase(solid):
    line, z = along(solid, x=0, y=-27)
    pieces = runs(line, z)
    assert len(pieces) == 1 and pieces[0][0] > 80, "only the vertex lies on that ray"
    beside = runs(along(solid, x=25, y=-27)[0], z)
    base = sum(beside[0]) / 2
    assert base < -10, "beside the foramen there is the base"
    across, x = along(solid, y=-27, z=base)
    assert [b - a for a, b in runs(~across, x) if a < 0 < b] == [pytest.approx(30, abs=4)]
    lengthwise, y = along(solid, x=1, z=base)
    assert [b - a for a, b in runs(~lengthwise, y) if a < -27 < b] == [pytest.approx(36, abs=5)]


def test_teeth_are_individuals(solid):
    """Along the arch of the upper jaw bone and gap take turns, fourteen teeth in all."""
    volume, (x, y, z) = solid
    from scipy import ndimage

    level = np.abs(z + 61.5).argmin()
    front = volume[level].copy()
    front[y < 20] = False
    _, count = ndimage.label(front)
    assert count >= 10


def test_scale_and_resolution():
    section = {"kind": "skull", "scale": 0.5, "mesh_resolution_mm": 1.5}
    small = build_specimen(Specimen.model_validate({"parts": [{"shape": section}]}))
    mesh = small.parts[0].mesh
    assert mesh.is_watertight
    assert 97 < np.ptp(small.bounds, axis=0)[2] < 113
    assert len(mesh.faces) < 120_000


def test_deterministic(skull):
    from twinct.specimen import skull as module

    module._cached.cache_clear()
    again = build_specimen(SPECIMEN)
    assert np.array_equal(again.parts[0].mesh.vertices, skull.parts[0].mesh.vertices)
    assert np.array_equal(again.parts[0].mesh.faces, skull.parts[0].mesh.faces)


def test_preview_shows_the_face(skull, tmp_path):
    picture = shaded(skull, 0.0, 0.0, pixel_mm=1.0, margin_mm=5.0)
    rows, columns, _ = picture.shape
    assert picture[0, 0] == pytest.approx([1, 1, 1])
    middle = columns / 2

    def at(right, up):
        return picture[int(rows / 2 - up), int(middle + right)].mean()

    # Sockets are darker than the forehead: the picture is upright and shows the front.
    assert at(-33, 4) < 0.8 * at(0, 60) and at(33, 4) < 0.8 * at(0, 60)
    target = tmp_path / "skull.png"
    preview_specimen(skull, target, title="skull")
    assert target.read_bytes().startswith(b"\x89PNG")


def test_hull_is_small_and_holds_the_skull(skull):
    hull = skull.hull
    assert hull.is_watertight and len(hull.faces) < 8000
    assert hull.bounds == pytest.approx(skull.bounds, abs=1e-9)
    normals, offsets = (
        hull.face_normals,
        np.einsum("ij,ij->i", hull.face_normals, hull.triangles[:, 0]),
    )
    some = skull.parts[0].mesh.vertices[::37]
    out = max((block @ normals.T - offsets).max() for block in np.array_split(some, 20))
    assert out < 0.4, "mm by which a point may stick out"


def test_the_hull_touches_the_skull_in_each_of_its_directions(skull):
    directions = np.array_split(_sphere_directions(HULL_DIRECTIONS)[::7], 20)
    points = skull.parts[0].mesh.vertices
    reach, of_hull = (
        np.concatenate([(block @ corners.T).max(axis=1) for block in directions])
        for corners in (points, skull.hull.vertices)
    )
    assert of_hull == pytest.approx(reach, abs=1e-9)


def test_the_enclosed_volume_is_that_of_trimesh_and_negative_inside_out(skull):
    mesh = skull.parts[0].mesh
    assert skull.parts[0].volume_mm3 == pytest.approx(mesh.volume, rel=1e-12)
    turned = surface(mesh.vertices, mesh.faces[:, ::-1])
    assert enclosed_volume(turned) == pytest.approx(-mesh.volume, rel=1e-12)
