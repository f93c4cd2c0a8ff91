"""What views leave unknown, against estimates from data that were drawn."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.recon import Projector
from twinct.trajectory import panel_axes
from twinct.view_planning import KnownShare, prior_covariance

GRID = VolumeGrid((4, 5, 6), 12.0)
DEVIATION = 0.01


@pytest.fixture(scope="module")
def operator() -> Projector:
    towards = np.random.default_rng(1).normal(size=(7, 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    panel = Panel(5, 6, 25.0, 25.0)
    geometry = ScanGeometry(300 * towards, -300 * towards, *panel_axes(towards), panel)
    return Projector(geometry, GRID, "plain")


@pytest.fixture(scope="module")
def region():
    inside = np.zeros(GRID.shape, np.bool_)
    inside[1:3, 1:4, :2] = True
    return inside


@pytest.fixture(scope="module")
def share(operator, region) -> KnownShare:
    photons = np.random.default_rng(2).uniform(0, 60, operator.range_shape)
    return KnownShare.of(operator, photons, prior_covariance(GRID, DEVIATION, 20.0), region)


def test_it_is_the_error_of_the_best_estimate(operator, region, share) -> None:
    rng = np.random.default_rng(3)
    covariance = prior_covariance(GRID, DEVIATION, 20.0)
    photons = np.random.default_rng(2).uniform(0, 60, operator.range_shape)
    exposures = np.array([0.3, 0, 0.6, 0, 0.1, 0, 0])
    taken = exposures > 0
    weights = (photons * exposures[:, None, None])[taken].ravel()
    draws = 400
    truth = np.linalg.cholesky(covariance) @ rng.normal(size=(len(covariance), draws))
    seen = np.stack([operator[taken](x.reshape(GRID.shape)).ravel() for x in truth.T], axis=1)
    seen += rng.normal(size=seen.shape) / np.sqrt(weights)[:, None]
    units = np.eye(len(covariance))
    columns = [operator[taken](one.reshape(GRID.shape)).ravel() for one in units]
    matrix = np.stack(columns, axis=1)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    stacked = np.vstack([np.sqrt(weights)[:, None] * matrix, whiten])
    data = np.vstack([np.sqrt(weights)[:, None] * seen, np.zeros_like(truth)])
    found = np.linalg.lstsq(stacked, data, rcond=None)[0]
    error = ((found - truth)[region.ravel()] ** 2).mean()
    left = 1 - share(exposures)
    # 12 voxels, at least 4 of them independent, of 400 draws: sqrt(2 / 1600) = 3.5 %, twice that.
    assert left == pytest.approx(error / DEVIATION**2, rel=0.07)
    assert 0.1 < left < 0.9


def test_one_more_view_is_what_it_is_with_it(share) -> None:
    found = share.added([0, 4], [1, 2, 6])
    for value, view in zip(found, [1, 2, 6], strict=True):
        exposures = np.zeros(7)
        exposures[[0, 4, view]] = 1
        assert value == pytest.approx(share(exposures), rel=1e-5)


def test_slopes_are_derivatives(share) -> None:
    exposures = np.linspace(0.5, 2, 7)
    for view, slope in enumerate(share.slopes(exposures)):
        step = 1e-3 * np.eye(7)[view]
        difference = (share(exposures + step) - share(exposures - step)) / 2e-3
        assert slope == pytest.approx(difference, rel=1e-3)


def test_no_views_tell_nothing(share) -> None:
    assert share(np.zeros(7)) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"region": np.zeros(GRID.shape, np.bool_)}, "region holds no voxel"),
        ({"region": np.ones((2, 2, 2), np.bool_)}, "region has shape"),
        ({"covariance": -np.eye(120)}, "not positive definite"),
        ({"photons": np.full((7, 5, 6), -1.0)}, "0 or more"),
    ],
)
def test_what_does_not_fit_is_refused(operator, region, change, says) -> None:
    given = {"photons": np.ones((7, 5, 6)), "covariance": np.eye(120), "region": region} | change
    with pytest.raises(InputError, match=says):
        KnownShare.of(operator, **given)


def test_a_fine_grid_is_refused() -> None:
    with pytest.raises(InputError, match="at most 5000"):
        prior_covariance(VolumeGrid((32, 32, 32), 1.0), 0.01, 5.0)
