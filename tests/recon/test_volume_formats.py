"""Volumes in the formats of other programs: every voxel lies where the grid says, for any reader.

The values have no symmetry, and the grid is turned about all axes with three different edges: a
swapped or mirrored axis moves voxels.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import nibabel
import numpy as np
import pydicom
import pytest
import SimpleITK
import tifffile
import zarr

from twinct.core.errors import InputError, ScanExistsError
from twinct.geometry import Pose, VolumeGrid
from twinct.recon.volume import Volume
from twinct.recon.volume_formats import VolumeFacts, volume_formats
from twinct.recon.volume_formats.dicom_volume import rescale_step
from twinct.scenario import HuLine
from twinct.specimen.volumes import read_ct

GRID = VolumeGrid((6, 9, 12), (1.0, 1.25, 0.7), Pose.from_euler([10, -20, 33], [20, 30, 40]))
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
WATER = 0.02


@pytest.fixture(scope="module")
def volume() -> Volume:
    return Volume(np.random.default_rng(1).uniform(0, 0.05, GRID.shape).astype(np.float32), GRID)


def off(values, affine, ref: Volume) -> tuple[float, float]:
    """Largest difference of values, and of places in mm, if the nearest voxels are compared.

    ``values`` has the axes (i, j, k) of ``affine``, which leads to RAS, mm.
    """
    k, j, i = np.indices(ref.shape).reshape(3, -1)
    world = np.stack([i, j, k, np.ones(i.size)], axis=1) @ ref.grid.affine.T
    at = np.rint(world @ np.linalg.inv(affine).T)
    far = np.abs(at @ np.asarray(affine).T - world).max()
    there = np.asarray(values)[tuple(at[:, :3].astype(int).T)]
    return float(np.abs(there - ref.array.ravel()).max()), float(far)


def of_itk(image) -> tuple[np.ndarray, np.ndarray]:
    affine = np.eye(4)
    affine[:3, :3] = np.reshape(image.GetDirection(), (3, 3)) * np.array(image.GetSpacing())
    affine[:3, 3] = image.GetOrigin()
    return SimpleITK.GetArrayFromImage(image).T, LPS @ affine


def hu_series(volume: Volume, folder: Path) -> Volume:
    hu = volume.in_hu(WATER)
    hu.write(folder, to="dicom", facts=VolumeFacts(unit="HU", scan="demo", kvp=120))
    return hu


def test_metaimage_by_itk_and_by_our_reader(volume, tmp_path) -> None:
    path = tmp_path / "v.mha"
    volume.write(path, "a note")
    assert off(*of_itk(SimpleITK.ReadImage(str(path))), volume) == (0, pytest.approx(0, abs=1e-9))
    image = read_ct(path, "here", HuLine())
    assert off(image.values, image.affine, volume) == (0, pytest.approx(0, abs=1e-9))


@pytest.mark.parametrize("unit", ["HU", "1/mm"])
def test_dicom_series_by_itk_pydicom_and_our_reader(volume, tmp_path, unit) -> None:
    folder = tmp_path / "series"
    ref = hu_series(volume, folder) if unit == "HU" else volume
    if unit == "1/mm":
        volume.write(folder, to="dicom")
    step = rescale_step(ref.array, VolumeFacts(unit=unit))
    reader = SimpleITK.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
    found = [off(*of_itk(reader.Execute()), ref)]
    image = read_ct(folder, "here", None if unit == "HU" else HuLine())
    found.append(off(image.values, image.affine, ref))
    found.append(off(*of_pydicom(folder), ref))
    for values, place in found:
        assert values <= 0.51 * step and place < 1e-6
    assert step == 1 if unit == "HU" else 1e-6 <= step <= 2e-6


def of_pydicom(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    slices = [pydicom.dcmread(path) for path in sorted(folder.iterdir())]
    first, last = (np.array(slices[k].ImagePositionPatient, float) for k in (0, -1))
    axes = np.array(slices[0].ImageOrientationPatient, float).reshape(2, 3)
    affine = np.eye(4)
    affine[:3, 0] = axes[0] * float(slices[0].PixelSpacing[1])
    affine[:3, 1] = axes[1] * float(slices[0].PixelSpacing[0])
    affine[:3, 2], affine[:3, 3] = (last - first) / (len(slices) - 1), first
    values = [float(s.RescaleSlope) * s.pixel_array + float(s.RescaleIntercept) for s in slices]
    return np.stack(values).transpose(2, 1, 0), LPS @ affine


def test_dicom_names_no_patient_and_is_the_same_each_time(volume, tmp_path) -> None:
    for name in ("one", "two"):
        hu_series(volume, tmp_path / name)
    one, two = (sorted((tmp_path / name).iterdir()) for name in ("one", "two"))
    assert [p.read_bytes() for p in one] == [p.read_bytes() for p in two]
    slices = [pydicom.dcmread(path) for path in one]
    assert len({s.SOPInstanceUID for s in slices}) == len(slices) == 6
    assert len({(s.SeriesInstanceUID, s.StudyInstanceUID) for s in slices}) == 1
    first = slices[0]
    assert str(first.PatientName) == "Phantom^Anonymous" and first.KVP == 120
    assert not (first.PatientBirthDate or first.PatientSex or first.StudyDate)
    upright = Volume(volume.array, VolumeGrid(GRID.shape, 1.0)).in_hu(WATER)
    upright.write(tmp_path / "upright", to="dicom", facts=VolumeFacts(unit="HU"))
    image = pydicom.dcmread(tmp_path / "upright" / "slice_0001.dcm")
    assert list(image.ImageOrientationPatient) == [1, 0, 0, 0, 1, 0]
    assert image.StudyInstanceUID != first.StudyInstanceUID


@pytest.mark.process
def test_dicom_series_passes_dciodvfy(volume, tmp_path) -> None:
    if not shutil.which("dciodvfy"):
        pytest.skip("needs dciodvfy of Debian's dicom3tools")
    hu_series(volume, tmp_path / "hu")
    volume.write(tmp_path / "mu", to="dicom")
    for path in (*(tmp_path / "hu").iterdir(), *(tmp_path / "mu").iterdir()):
        told = subprocess.run(["dciodvfy", "-new", path], capture_output=True, text=True).stderr
        assert "CTImage" in told and "Error" not in told, told


@pytest.mark.process
def test_dicom_series_through_dcm2niix(volume, tmp_path) -> None:
    if not shutil.which("dcm2niix"):
        pytest.skip("needs dcm2niix")
    hu = hu_series(volume, tmp_path / "series")
    subprocess.run(["dcm2niix", "-f", "x", "-o", tmp_path, tmp_path / "series"], check=True)
    image = nibabel.load(tmp_path / "x.nii")
    values, place = off(image.get_fdata(), image.affine, hu)
    assert values <= 0.51 and place < 0.01


def test_tiff_stack_and_zarr_hold_voxels_edges_and_place(volume, tmp_path) -> None:
    volume.write(tmp_path / "v.tif")
    with tifffile.TiffFile(tmp_path / "v.tif") as file:
        assert len(file.pages) == 6
        np.testing.assert_array_equal(file.asarray(), volume.array)
        across, down = (np.divide(*file.pages[0].tags[n].value) for n in (282, 283))
        told = file.imagej_metadata
    assert (1 / across, 1 / down, told["spacing"]) == pytest.approx((1.0, 1.25, 0.7), rel=1e-6)
    volume.write(tmp_path / "v.zarr")
    group = zarr.open_group(tmp_path / "v.zarr", mode="r")
    np.testing.assert_array_equal(group["0"][:], volume.array)
    data = group.attrs["ome"]["multiscales"][0]["datasets"][0]
    scale, shift = data["coordinateTransformations"]
    assert scale["scale"] == [0.7, 1.25, 1.0]
    assert shift["translation"] == pytest.approx(GRID.affine[2::-1, 3])
    np.testing.assert_array_equal(group.attrs["twinct"]["world_from_voxel"], GRID.affine)


def test_water_is_zero_and_air_is_minus_a_thousand(volume) -> None:
    found = Volume(np.full(GRID.shape, 0.021, np.float32), GRID).in_hu(0.021, 0.001)
    np.testing.assert_allclose(found.array, 0, atol=1e-3)
    np.testing.assert_allclose((volume * 0 + 0.001).in_hu(0.021, 0.001).array, -1000, atol=1e-3)
    with pytest.raises(InputError, match="attenuates more than air"):
        volume.in_hu(0.0)


@pytest.mark.parametrize("top", [1e-9, 0.0499, 3.0, 32767.0, 32768.0, 1e9])
def test_steps_reach_all_values_and_fit_in_a_decimal_text(top: float) -> None:
    for unit in ("HU", "1/mm"):
        step = rescale_step(np.array([-top, top], np.float32), VolumeFacts(unit=unit))
        assert top / step <= 32767 * (1 + 1e-6)
        assert step == float(f"{step:.0e}") and (unit == "1/mm" or step >= 1)


def test_unknown_names_and_folders_that_exist_are_refused(volume, tmp_path) -> None:
    with pytest.raises(InputError, match=r"must end in \.nii, \.nii\.gz, \.mha.*to='dicom'"):
        volume.write(tmp_path / "v.raw")
    with pytest.raises(InputError, match="volume format vtk: unknown; choose from dicom"):
        volume.write(tmp_path / "v", to="vtk")
    (tmp_path / "there").mkdir()
    with pytest.raises(ScanExistsError, match="there exists already"):
        volume.write(tmp_path / "there", to="dicom")
    assert set(volume_formats()) >= {"dicom", "nifti", "metaimage", "tiff", "zarr"}


def test_a_write_that_fails_leaves_nothing(volume, tmp_path, monkeypatch) -> None:
    count = iter(range(100))

    def full(*_args, **_keys) -> None:
        if next(count) == 3:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(pydicom.dataset.Dataset, "save_as", full)
    with pytest.raises(Exception, match="disk is full"):
        volume.write(tmp_path / "series", to="dicom")
    assert not list(tmp_path.iterdir())
