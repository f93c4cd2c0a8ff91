"""NIfTI volumes: upright and in place for any reader."""

from __future__ import annotations

import copy
import operator
import pickle

import nibabel
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.core.errors import InputError, StorageError
from twinct.geometry import Pose, VolumeGrid
from twinct.recon.volume import Volume


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


def test_a_volume_needs_a_folder_that_exists(tmp_path) -> None:
    volume = Volume(np.zeros((1, 2, 3), dtype=np.float32), VolumeGrid((1, 2, 3), 1.0))
    with pytest.raises(StorageError, match="cannot be written: there is no folder .*none"):
        volume.write(tmp_path / "none" / "x.nii")


def test_upright_grid_is_ras(tmp_path) -> None:
    Volume(np.zeros((2, 2, 2)), VolumeGrid((2, 2, 2), 1.0)).write(tmp_path / "v.nii")
    assert nibabel.aff2axcodes(nibabel.load(tmp_path / "v.nii").affine) == ("R", "A", "S")


def test_what_is_no_volume_is_named(tmp_path) -> None:
    (tmp_path / "v.nii").write_text("no")
    with pytest.raises(InputError, match="the NIfTI volume cannot be read"):
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
    with pytest.raises(InputError, match=r"shape \(2, 3\), but its grid needs \(2, 3, 4\)"):
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


@pytest.fixture
def pair() -> tuple[Volume, Volume]:
    grid = VolumeGrid((2, 3, 4), (1.0, 2.0, 3.0), Pose.from_euler([1, 2, 3], [0, 0, 30]))
    rng = np.random.default_rng(0)
    return Volume(rng.random((2, 3, 4)), grid, {"circle": 7}), Volume(rng.random((2, 3, 4)), grid)


def test_a_volume_is_used_like_an_array(pair) -> None:
    v, w = pair
    assert (v.shape, v.ndim, v.dtype, len(v)) == ((2, 3, 4), 3, np.float32, 2)
    assert v[1, 2, 3] == v.array[1, 2, 3]
    np.testing.assert_array_equal(v[:, 1], v.array[:, 1])
    for apply in (operator.sub, operator.add, operator.mul, operator.truediv, np.maximum):
        made = apply(v, w)
        assert isinstance(made, Volume) and made.grid == v.grid and not made.extras
        np.testing.assert_array_equal(made, apply(v.array, w.array))
    for made in (2 * v, v * w.array, w.array * v, -v, np.exp(v)):
        assert isinstance(made, Volume)
    np.testing.assert_array_equal(1 - v, 1 - v.array)
    assert type(v > 0.5) is np.ndarray and (v > 0.5).dtype == bool
    assert type(v + np.zeros((5, 1, 1, 1))) is np.ndarray
    assert (v.min(), v.max(), v.mean()) == (v.array.min(), v.array.max(), v.array.mean())
    assert np.max(v) == v.array.max() and v.max(axis=0).shape == (3, 4)
    assert np.sum(v) == v.array.sum() and np.add.reduce(v, axis=0).shape == (3, 4)
    assert v == v and v != w and len({v, w}) == 2
    with pytest.raises(TypeError):
        np.add(v, 1, out=w)


def test_volumes_on_different_grids_do_not_mix(pair, tmp_path) -> None:
    v, w = pair
    v.write(tmp_path / "v.nii")
    assert isinstance(v - Volume.read(tmp_path / "v.nii"), Volume), "its grid was stored in float32"
    place = w.grid.world_from_grid
    for grid in (
        VolumeGrid((2, 3, 4), (1.0, 2.0, 3.1), place),
        VolumeGrid((2, 3, 4), (1.0, 2.0, 3.0), Pose.from_euler([0, 0, 0.01], [0, 0, 0]) @ place),
        VolumeGrid((2, 3, 4), (1.0, 2.0, 3.0), place @ Pose.from_euler([0, 0, 0], [180, 0, 0])),
    ):
        with pytest.raises(InputError, match="different grids"):
            v - Volume(w.array, grid)


def test_a_grid_turned_about_its_diagonal_is_another() -> None:
    """Its first and its last voxel stay where they were."""
    third = Rotation.from_rotvec(np.full(3, np.pi * 2 / 3 / np.sqrt(3)))
    plain, turned = (
        Volume(np.ones((3, 3, 3)), VolumeGrid((3, 3, 3), 1.0, pose))
        for pose in (Pose.identity(), Pose(np.zeros(3), third.as_quat()))
    )
    with pytest.raises(InputError, match="different grids"):
        plain - turned


def test_copies_are_whole_and_locked(pair) -> None:
    v, _ = pair
    for made in (pickle.loads(pickle.dumps(v)), copy.copy(v), copy.deepcopy(v)):
        np.testing.assert_array_equal(made, v)
        assert made.grid == v.grid and made.extras == {"circle": 7}
        assert not made.array.flags.writeable


def test_files_are_named_by_text_and_end_as_a_format_does(pair, tmp_path) -> None:
    v, _ = pair
    for name in ("v.nii", "v.nii.gz"):
        v.write(str(tmp_path / name))
        np.testing.assert_array_equal(Volume.read(str(tmp_path / name)), v)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["v.nii", "v.nii.gz"]
    for name in ("v.dcm", "v", "v.gz"):
        with pytest.raises(InputError, match=rf"{name}: .* end in \.nii, \.nii\.gz, \.mha"):
            v.write(tmp_path / name)


def test_a_volume_is_shown_in_a_file(pair, tmp_path) -> None:
    v, _ = pair
    v.show(str(tmp_path / "v.png"))
    assert (tmp_path / "v.png").read_bytes().startswith(b"\x89PNG")
    assert v._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(InputError, match=r"v\.xyz: the name of a picture must end in .*\.png"):
        v.show(tmp_path / "v.xyz")
    with pytest.raises(InputError, match="no window .* name a file"):
        v.show()
