"""NIfTI volumes: upright and in place for any reader."""

from __future__ import annotations

import nibabel
import numpy as np
import pytest

from twinct.errors import InputError
from twinct.geometry import Pose, VolumeGrid
from twinct.volume import Volume


def test_voxels_lie_where_the_grid_says(tmp_path) -> None:
    grid = VolumeGrid((3, 4, 5), (1.0, 2.0, 3.0), Pose.from_euler([10, 20, 30], [0, 0, 90]))
    volume = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
    Volume(volume, grid).write(tmp_path / "v.nii", "note")
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
    back = Volume.read(tmp_path / "v.nii")
    np.testing.assert_array_equal(back, volume)
    np.testing.assert_allclose(back.grid.affine, grid.affine, atol=1e-5)
    assert back.extras["note"] == "note"
    assert [p.name for p in tmp_path.iterdir()] == ["v.nii"]


def test_upright_grid_is_ras(tmp_path) -> None:
    Volume(np.zeros((2, 2, 2)), VolumeGrid((2, 2, 2), 1.0)).write(tmp_path / "v.nii")
    assert nibabel.aff2axcodes(nibabel.load(tmp_path / "v.nii").affine) == ("R", "A", "S")


def test_what_is_no_volume_is_named(tmp_path) -> None:
    (tmp_path / "v.nii").write_text("no")
    with pytest.raises(InputError, match="not a readable NIfTI"):
        Volume.read(tmp_path / "v.nii")


def test_numpy_takes_it_and_nobody_changes_it() -> None:
    given = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    volume = Volume(given, VolumeGrid((2, 3, 4), 1.0), {"circle": 7})
    assert np.shares_memory(np.asarray(volume), given)
    assert np.mean(volume) == 11.5
    with pytest.raises(ValueError, match="read-only"):
        volume.array[0] = 1
    with pytest.raises(TypeError):
        volume.extras["circle"] = 8
    assert repr(volume) == "Volume(4 x 3 x 2 voxels of 1 x 1 x 1 mm, 0 to 23, extras circle)"


def test_another_shape_than_the_grid_is_refused() -> None:
    with pytest.raises(InputError, match=r"shape \(2, 3\): its grid needs \(2, 3, 4\)"):
        Volume(np.zeros((2, 3)), VolumeGrid((2, 3, 4), 1.0))


def test_a_notebook_shows_three_sections(monkeypatch) -> None:
    from matplotlib.axes import Axes

    shown, labels = [], []
    monkeypatch.setattr(
        Axes, "imshow", lambda self, image, **how: shown.append((np.array(image), how["extent"]))
    )
    monkeypatch.setattr(Axes, "set", lambda self, **words: labels.append(words))
    array = np.random.default_rng(0).random((4, 5, 6), np.float32)
    png = Volume(array, VolumeGrid((4, 5, 6), (1.0, 2.0, 3.0)))._repr_png_()
    assert png.startswith(b"\x89PNG")
    for (image, extent), section, edges in zip(
        shown,
        (array[2], array[:, 2], array[:, :, 3]),
        ((-3, 3, -5, 5), (-3, 3, -6, 6), (-5, 5, -6, 6)),
        strict=True,
    ):
        np.testing.assert_array_equal(image, section)
        np.testing.assert_allclose(extent, edges)
    assert [words["xlabel"] + words["ylabel"] for words in labels] == [
        "x / mmy / mm",
        "x / mmz / mm",
        "y / mmz / mm",
    ]
    assert labels[2]["title"] == "x = 0.5 mm"
