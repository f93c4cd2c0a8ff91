"""NIfTI volumes: upright and in place for any reader."""

from __future__ import annotations

import nibabel
import numpy as np
import pytest

from twinct.errors import InputError
from twinct.geometry import Pose, VolumeGrid
from twinct.volume import read_volume, write_volume


def test_voxels_lie_where_the_grid_says(tmp_path) -> None:
    grid = VolumeGrid((3, 4, 5), (1.0, 2.0, 3.0), Pose.from_euler([10, 20, 30], [0, 0, 90]))
    volume = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
    write_volume(tmp_path / "v.nii", volume, grid, "note")
    image = nibabel.load(tmp_path / "v.nii")
    i, j, k = 4, 1, 2
    assert image.get_fdata()[i, j, k] == volume[k, j, i]
    x, y, z = grid.axes()
    np.testing.assert_allclose(
        image.affine @ [i, j, k, 1],
        [*grid.world_from_grid.apply([x[i], y[j], z[k]]), 1],
        atol=1e-5,  # the header holds float32
    )
    assert image.header.get_xyzt_units()[0] == "mm"
    back, note = read_volume(tmp_path / "v.nii")
    np.testing.assert_array_equal(back, volume)
    assert note == "note"
    assert [p.name for p in tmp_path.iterdir()] == ["v.nii"]


def test_upright_grid_is_ras(tmp_path) -> None:
    write_volume(tmp_path / "v.nii", np.zeros((2, 2, 2), np.float32), VolumeGrid((2, 2, 2), 1.0))
    assert nibabel.aff2axcodes(nibabel.load(tmp_path / "v.nii").affine) == ("R", "A", "S")


def test_what_is_no_volume_is_named(tmp_path) -> None:
    (tmp_path / "v.nii").write_text("no")
    with pytest.raises(InputError, match="not a readable NIfTI"):
        read_volume(tmp_path / "v.nii")
