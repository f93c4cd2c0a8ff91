"""Image figures against numbers worked out by hand, and against direct whole-array computations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

import twinct.evaluation.image
from twinct.core.errors import InputError, TwinctError
from twinct.evaluation import ImageFigures, ImageReference, image_figures
from twinct.geometry import VolumeGrid

MU = 0.043

FLOAT32 = 1e-5
"""Relative: float32 attenuation values, summed in float64."""

SSIM_FLOAT32 = 1e-4
"""Absolute: scikit-image filters float32 input in float32."""


def scene(shape, seed=0):
    """Asymmetric body with partial voxels, noise, and a crooked region."""
    rng = np.random.default_rng(seed)
    z, y, x = np.indices(shape) / np.array(shape)[:, None, None, None]
    fraction = np.clip(
        6 * (0.3 - np.hypot(np.hypot(z - 0.4, 1.3 * (y - 0.55)), 0.7 * (x - 0.35))), 0, 1
    )
    fraction = np.round(fraction * 64) / 64  # as 4^3 supersampling gives it
    truth = (fraction * MU).astype(np.float32)
    noise = 0.1 * MU * rng.standard_normal(shape)
    roi = (z + 0.4 * y + 0.2 * x > 0.35) & (0.2 * z + y + x < 1.6)
    return (truth + noise).astype(np.float32), truth, roi


def flat(figures):
    told = figures.as_dict()
    return told | {f"zero.{name}": value for name, value in told.pop("zero").items()}


def test_by_hand():
    """A line of ten voxels of 2 mm: one full voxel, one half, the region all but one."""
    grid = VolumeGrid((1, 1, 10), 2.0)
    mu = 0.5
    truth = np.array([0, 0, 0, 0, 0.5, 0.25, 0, 0, 0, 0]).reshape(1, 1, 10)
    error = np.array([0.01, 0, 0.02, 0, -0.01, 0, 0, 0.03, 0, 9.0]).reshape(1, 1, 10)
    roi = np.ones((1, 1, 10), dtype=bool)
    roi[..., 9] = False
    figures = image_figures(truth + error, truth, roi, mu, grid, near_mm=4.0)
    # Squares in the region: (1 + 4 + 1 + 9) 1e-4 = 0.0015 over 9 voxels.
    assert figures.rmse_rel == pytest.approx(math.sqrt(0.0015 / 9) / 0.5)
    # Reference: voxels 4 and 5 (half counts). Within 4 mm: 2 to 7, 0.0004 + 0.0001 + 0.0009 over 6.
    assert figures.rmse_near_rel == pytest.approx(math.sqrt(0.0014 / 6) / 0.5)
    assert figures.psnr_db == pytest.approx(20 * math.log10(0.5 / math.sqrt(0.0015 / 9)))
    assert figures.mean_reference_rel == pytest.approx((0.5 - 0.01) / 0.5), (
        "only the voxel that is full"
    )
    assert figures.roi_fraction == pytest.approx(0.9)
    assert figures.roi_reference_fraction == pytest.approx(2 / 9)
    assert math.isnan(figures.ssim), "no 7^3 window fits"


@pytest.mark.parametrize("shape", [(30, 21, 26), (49, 20, 18)], ids=["slabs", "more slabs"])
def test_against_whole_arrays(shape):
    volume, truth, roi = scene(shape)
    grid = VolumeGrid(shape, (1.0, 1.4, 0.8))
    figures = image_figures(volume, truth, roi, MU, grid)
    error = volume.astype(float) - truth
    assert figures.rmse_rel == pytest.approx(np.sqrt((error[roi] ** 2).mean()) / MU, rel=FLOAT32)
    distance = ndimage.distance_transform_edt(truth < 0.5 * MU, sampling=grid.voxel[::-1])
    near = roi & (distance <= 3.0)
    assert 0.05 < near.sum() / roi.sum() < 0.9, "the case must tell near from far"
    assert figures.rmse_near_rel == pytest.approx(
        np.sqrt((error[near] ** 2).mean()) / MU, rel=FLOAT32
    )
    pure = roi & (truth == np.float32(MU))
    assert figures.mean_reference_rel == pytest.approx(
        volume[pure].mean(dtype=float) / MU, rel=FLOAT32
    )
    assert figures.roi_reference_fraction == pytest.approx((truth[roi] >= 0.5 * MU).mean())
    whole = ndimage.binary_erosion(roi, np.ones((7, 7, 7)), border_value=0)
    assert whole.sum() > 100
    _, similarity = structural_similarity(
        truth.astype(float), volume.astype(float), data_range=MU, full=True
    )
    assert figures.ssim == pytest.approx(similarity[whole].mean(), abs=SSIM_FLOAT32)
    assert 0.1 < (whole & near).sum() / whole.sum() < 0.9
    assert figures.ssim_near == pytest.approx(similarity[whole & near].mean(), abs=SSIM_FLOAT32)


def test_zeros_are_the_baseline():
    volume, truth, roi = scene((30, 21, 26))
    grid = VolumeGrid(truth.shape, 1.0)
    of_zeros = image_figures(np.zeros_like(truth), truth, roi, MU, grid)
    figures = image_figures(volume, truth, roi, MU, grid)
    assert set(figures.zero) == {"rmse_rel", "rmse_near_rel", "psnr_db", "ssim", "ssim_near"}
    told = {name: getattr(of_zeros, name) for name in ("rmse_rel", "rmse_near_rel", "psnr_db")}
    assert {name: figures.zero[name] for name in told} == pytest.approx(told, rel=1e-6)
    zeros = np.zeros(truth.shape)
    similarity = structural_similarity(truth.astype(float), zeros, data_range=MU, full=True)[1]
    whole = ndimage.binary_erosion(roi, np.ones((7, 7, 7)), border_value=0)
    assert figures.zero["ssim"] == pytest.approx(similarity[whole].mean(), rel=1e-6)
    assert math.isnan(of_zeros.ssim) and math.isnan(of_zeros.ssim_near) and not of_zeros.signal_rel
    assert figures.zero["ssim"] < 1 and figures.zero["rmse_rel"] != figures.rmse_rel


def test_what_was_told_is_read_again():
    volume, truth, roi = scene((20, 21, 22))
    figures = image_figures(volume, truth, roi, MU, VolumeGrid(truth.shape, 1.0))
    further = replace(figures, further={"edge_width_mm": 1.5, "nps": {"a": {"noise_rel": 0.1}}})
    assert ImageFigures.of(further.as_dict()) == further
    older = {name: 1.0 for name in list(figures.as_dict())[:7]}
    assert math.isnan(ImageFigures.of(older).ssim_near) and not ImageFigures.of(older).zero


def test_whole_grid_gives_what_scikit_image_says():
    volume, truth, _ = scene((27, 15, 19))
    figures = image_figures(
        volume, truth, np.ones(truth.shape, bool), MU, VolumeGrid(truth.shape, 1)
    )
    assert figures.psnr_db == pytest.approx(
        peak_signal_noise_ratio(truth.astype(float), volume.astype(float), data_range=MU),
        rel=FLOAT32,
    )
    assert figures.ssim == pytest.approx(
        structural_similarity(truth.astype(float), volume.astype(float), data_range=MU),
        abs=SSIM_FLOAT32,
    )


def test_similarity_is_that_of_scikit_image_in_double_precision():
    volume, truth, _ = scene((20, 15, 75))  # rows of two words
    everywhere = np.ones(truth.shape, bool)
    figures = image_figures(volume, truth, everywhere, MU, VolumeGrid(truth.shape, 1))
    double = truth.astype(float), volume.astype(float)
    similarity = structural_similarity(*double, data_range=MU, full=True)[1]
    assert figures.ssim == pytest.approx(similarity[3:-3, 3:-3, 3:-3].mean(), rel=1e-9)


@pytest.mark.parametrize("full", [(23, 4, 8), (25, 4, 8)], ids=["slab below", "slab above"])
@pytest.mark.parametrize("distance", [0.0, 1.9, 2.0, 2.5, 40.0])
def test_distance_to_the_reference_is_euclidean(distance, full):
    """A single full voxel off centre, voxels of unequal edges, distances on and between nodes."""
    shape, edges = (29, 14, 11), (0.5, 1.0, 2.0)
    grid = VolumeGrid(shape, edges)
    truth = np.zeros(shape)
    truth[full] = 1.0
    k, j, i = np.indices(shape)
    apart = np.sqrt(
        (2.0 * (k - full[0])) ** 2 + (1.0 * (j - full[1])) ** 2 + (0.5 * (i - full[2])) ** 2
    )
    # An error in one voxel too far or too near changes the figure: all values differ.
    error = 1.0 + np.arange(truth.size).reshape(shape) / 2**13  # numbers of float32
    figures = image_figures(truth + error, truth, np.ones(shape, bool), 1.0, grid, distance)
    expected = np.sqrt((error[apart <= distance] ** 2).mean())
    assert figures.rmse_near_rel == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    "side", [slice(None, 10), slice(11, None)], ids=["full above", "full below"]
)
def test_reference_outside_the_region_counts_for_the_distance(axis, side):
    """The region's box ends beside the full voxel, on either side of it."""
    shape = (21, 21, 21)
    truth, roi = np.zeros(shape), np.zeros(shape, bool)
    truth[10, 10, 10] = 1.0
    np.moveaxis(roi, axis, 0)[side] = True
    apart = np.sqrt(((np.indices(shape) - 10) ** 2).sum(axis=0))
    error = 1.0 + np.arange(truth.size).reshape(shape) / 2**14
    figures = image_figures(truth + error, truth, roi, 1.0, VolumeGrid(shape, 1.0), 3.0)
    expected = np.sqrt((error[roi & (apart <= 3.0)] ** 2).mean())
    assert figures.rmse_near_rel == pytest.approx(expected, rel=1e-9)


def test_nothing_outside_the_region_counts():
    volume, truth, roi = scene((30, 21, 26))
    grid = VolumeGrid(truth.shape, 1.0)
    spoilt = np.where(roi, volume, np.float32(np.nan))
    assert image_figures(spoilt, truth, roi, MU, grid) == image_figures(
        volume, truth, roi, MU, grid
    )


def test_strips_do_not_show(monkeypatch):
    volume, truth, roi = scene((30, 21, 26))
    grid = VolumeGrid(truth.shape, 1.0)
    one = image_figures(volume, truth, roi, MU, grid)
    monkeypatch.setattr(twinct.evaluation.image, "_STRIP", 4)
    many = image_figures(volume, truth, roi, MU, grid)
    assert flat(many) == pytest.approx(flat(one), rel=1e-12)


def test_masks_are_computed_once_for_any_number_of_volumes(monkeypatch):
    volume, truth, roi = scene((20, 21, 22))
    grid, calls = VolumeGrid(truth.shape, 1.0), []
    for name in ("near", "whole_windows"):
        made = getattr(twinct.evaluation.image, name)
        monkeypatch.setattr(
            twinct.evaluation.image,
            name,
            lambda *a, name=name, made=made: calls.append(name) or made(*a),
        )
    reference = ImageReference(truth, roi, MU, grid)
    found = [reference.figures(one) for one in (volume, truth, volume)]
    assert sorted(calls) == ["near", "whole_windows"]
    assert found[0] == found[2] == image_figures(volume, truth, roi, MU, grid) != found[1]


def test_each_axis_counts():
    """Turning volume, truth, region and grid together changes nothing; turning one alone does."""
    volume, truth, roi = scene((30, 21, 26))
    edges = np.array([1.0, 1.4, 0.8])
    straight = image_figures(volume, truth, roi, MU, VolumeGrid(truth.shape, edges))
    order = (2, 0, 1)
    turned = [array.transpose(order) for array in (volume, truth, roi)]
    turned_edges = edges[::-1][list(order)][::-1]
    again = image_figures(*turned, MU, VolumeGrid(turned[0].shape, turned_edges))
    assert flat(again) == pytest.approx(flat(straight), rel=1e-5)
    swapped = image_figures(volume, truth, roi, MU, VolumeGrid(truth.shape, edges[::-1]))
    assert swapped.rmse_near_rel != pytest.approx(straight.rmse_near_rel, rel=1e-4)


def test_perfect_volume():
    _, truth, roi = scene((20, 21, 22))
    figures = image_figures(truth, truth, roi, MU, VolumeGrid(truth.shape, 1.0))
    assert figures.rmse_rel == figures.rmse_near_rel == 0
    assert figures.psnr_db == math.inf
    assert figures.ssim == pytest.approx(1.0)
    assert figures.mean_reference_rel == pytest.approx(1.0, rel=FLOAT32)


def test_no_reference_in_the_region():
    grid = VolumeGrid((8, 9, 10), 1.0)
    figures = image_figures(
        np.ones(grid.shape), np.zeros(grid.shape), np.ones(grid.shape), 2.0, grid
    )
    assert figures.rmse_rel == pytest.approx(0.5)
    assert math.isnan(figures.rmse_near_rel) and math.isnan(figures.mean_reference_rel)
    assert figures.roi_reference_fraction == 0


def test_refusals():
    grid = VolumeGrid((8, 9, 10), 1.0)
    ones, none = np.ones(grid.shape), np.zeros(grid.shape, bool)
    with pytest.raises(InputError, match="seen by a view"):
        image_figures(ones, ones, none, 1.0, grid)
    with pytest.raises(TwinctError, match="not finite"):
        image_figures(np.where(none, 0, np.nan), ones, ~none, 1.0, grid)
    with pytest.raises(ValueError, match="truth has shape"):
        image_figures(ones, ones.T, ~none, 1.0, grid)
    with pytest.raises(ValueError, match="mu_reference"):
        image_figures(ones, ones, ~none, 0.0, grid)
