from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.geometry import Pose, VolumeGrid
from twinct.recon.volume import Volume
from twinct.viewer.slices import Plane, differences, greys, index_at, release

GRID = VolumeGrid(
    (5, 7, 9),
    (1.0, 2.0, 3.0),
    Pose(np.array([10.0, -20.0, 30.0]), Rotation.from_euler("xyz", (0.3, -0.5, 0.7)).as_quat()),
)


def ramp() -> np.ndarray:
    """x + 100 y + 10000 z of the world at each voxel."""
    k, j, i = np.indices(GRID.shape)
    local = GRID.first_voxel_mm + np.stack([i, j, k], axis=-1) * GRID.voxel
    world = GRID.world_from_grid.apply(local.reshape(-1, 3))
    return (world @ (1, 100, 10000)).reshape(GRID.shape)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_plane_lies_where_its_voxels_are(axis: int) -> None:
    plane = Plane.of(GRID, axis, 2)
    values = plane.values(ramp())
    rows, columns = values.shape
    width, height = plane.size_mm
    for row, column in ((0, 0), (rows - 1, 1), (2, columns - 1)):
        # As the page draws it: columns along x of the plane, rows along y, from the middle.
        x = ((column + 0.5) / columns - 0.5) * width
        y = ((row + 0.5) / rows - 0.5) * height
        world = plane.world_from_plane.apply(np.array([[x, y, 0.0]]))[0]
        assert world @ (1, 100, 10000) == pytest.approx(values[row, column], abs=1e-6)


def test_what_is_read_of_a_file_does_not_stay_in_memory(tmp_path: Path) -> None:
    file = tmp_path / "volume.nii"
    Volume(
        np.random.default_rng(0).normal(size=(64, 512, 512)), VolumeGrid((64, 512, 512), 1.0)
    ).write(file)
    volume = Volume.read(file)
    values = Plane.of(volume.grid, 0, 100).values(volume.array)
    assert np.array_equal(values, np.asarray(volume.array)[:, :, 100])  # which maps it again
    assert mapped_kb(file) > 30_000  # else this test says nothing
    release(volume.array)
    assert mapped_kb(file) < 5_000
    assert np.array_equal(values, np.asarray(volume.array)[:, :, 100])


def mapped_kb(file: Path) -> int:
    """Memory of this process that stands for a file."""
    maps = Path("/proc/self/smaps").read_text(encoding="utf-8")
    _, found, rest = maps.partition(f" {file}\n")
    return int(rest.partition("Rss:")[2].split()[0]) if found else 0


def test_an_index_beyond_the_grid_is_its_last_plane() -> None:
    assert Plane.of(GRID, 0, 99).index == 8
    assert Plane.of(GRID, 2, -5).index == 0


def test_a_point_is_in_the_voxel_about_it() -> None:
    k, j, i = 3, 1, 7
    centre = GRID.first_voxel_mm + np.array([i, j, k]) * GRID.voxel
    within = centre + 0.49 * GRID.voxel * (1, -1, 1)
    assert index_at(GRID, GRID.world_from_grid.apply(within[None])[0]) == (k, j, i)
    beyond = GRID.size_mm * (0.51, 0, 0)
    assert index_at(GRID, GRID.world_from_grid.apply(beyond[None])[0]) is None


def test_a_window_spreads_its_values_over_all_greys() -> None:
    found = greys(np.array([[-1.0, 0.0, 0.5, 1.0, 9.0]]), (0.0, 1.0))
    assert found[0, :, 0].tolist() == [0, 0, 127, 255, 255]


def test_differences_are_blue_below_and_red_above() -> None:
    below, none, above = differences(np.array([[-2.0, 0.0, 1.0]], np.float32), 1.0)[0]
    assert below.tolist() == [0, 0, 255]
    assert none.tolist() == [255, 255, 255]
    assert above.tolist() == [255, 0, 0]
