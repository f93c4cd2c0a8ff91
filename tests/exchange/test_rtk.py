"""RTK reads the files alone, and sees every point and every voxel where twinct sees them."""

from __future__ import annotations

import runpy
import sys

import numpy as np
import pytest

from twinct.exchange import write_bundle
from twinct.recon import Projector, sart

itk = pytest.importorskip("itk", reason="needs the extra rtk")
pytestmark = pytest.mark.tutorial  # loading RTK takes 10 s, once for all such tests

POINT_PX = 1e-9
"""Float64 on both sides; measured 1e-13."""
PROJECTION = 1e-5
"""RMS difference of two Joseph projectors, relative to the largest line integral; measured 3e-8.
Red beyond it: a flipped axis of the volume 0.16, images shifted by 0.001 pixels 2.9e-5."""
VOLUME = 0.02
"""RMS difference of the volumes, relative to the object; measured 0.010. RTK takes the views in a
random order. Red beyond it: a flipped axis 0.16."""


@pytest.fixture
def folder(bundle, tmp_path):
    write_bundle(tmp_path / "rtk", "rtk", bundle)
    return tmp_path / "rtk"


@pytest.fixture
def loaded(folder):
    return runpy.run_path(str(folder / "load.py"))


def test_points_reproject_through_rtks_own_matrices(loaded, bundle, points) -> None:
    geometry, stack = loaded["geometry"](), loaded["projections"]()
    ours = bundle.local.project(points)
    homogeneous = np.hstack([points, np.ones((len(points), 1))])
    for view in range(len(bundle.geometry)):
        matrix = itk.array_from_matrix(geometry.GetMatrix(view))
        seen = homogeneous @ matrix.T
        for point, pixel in zip(seen[:, :2] / seen[:, 2:], ours[view], strict=True):
            index = stack.TransformPhysicalPointToContinuousIndex([*point.tolist(), 0.0])
            np.testing.assert_allclose(np.array(index)[:2], pixel, rtol=0, atol=POINT_PX)


def test_rtk_projects_the_volume_to_the_images_of_the_files(
    loaded, bundle, grid, corner_object
) -> None:
    """Sizes, spacings, origins, and the order of all axes of images and volume."""
    from itk import RTK

    volume = loaded["volume"]()
    assert itk.array_view_from_image(volume).shape == grid.shape
    itk.array_view_from_image(volume)[:] = corner_object
    image_type = itk.Image[itk.F, 3]
    stack = loaded["projections"]()
    asked = itk.array_from_image(stack)
    np.testing.assert_array_equal(asked, bundle.images)
    itk.array_view_from_image(stack)[:] = 0
    projector = RTK.JosephForwardProjectionImageFilter[image_type, image_type].New()
    projector.SetInput(0, stack)
    projector.SetInput(1, volume)
    projector.SetGeometry(loaded["geometry"]())
    projector.Update()
    difference = itk.array_from_image(projector.GetOutput()) - asked
    assert np.sqrt(np.mean(difference**2)) < PROJECTION * asked.max()


def test_rtk_reconstructs_what_we_reconstruct(
    folder, bundle, grid, corner_object, monkeypatch, capsys
) -> None:
    """From the files, as a user's command does."""
    script, out = str(folder / "load.py"), folder.parent / "volume.npy"
    monkeypatch.setattr(sys, "argv", [script, "--iterations", "3", "--out", str(out)])
    runpy.run_path(script, run_name="__main__")
    assert "46 views" in capsys.readouterr().out
    theirs = np.load(out)
    ours = sart(Projector(bundle.geometry, grid), bundle.images, iterations=3, relaxation=0.3)
    scale = corner_object.max()
    assert np.sqrt(np.mean((theirs - ours) ** 2)) < VOLUME * scale
