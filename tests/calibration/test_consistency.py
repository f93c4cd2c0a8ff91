"""Geometry from projections alone: what was wrong with it is found, but for what no ray can see."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.calibration.consistency import Round, self_calibrated
from twinct.calibration.freedom import PosePrior
from twinct.calibration.modes import aligned
from twinct.calibration.resection import moved
from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector
from twinct.trajectory import ArcTrajectory, on_sphere
from twinct.trajectory.orbit import orbit_views

PRIOR = PosePrior(sigma_mm=1.0, sigma_deg=0.3)
VIEWS = 24


def body(grid):
    """Balls of no symmetry."""
    rng = np.random.default_rng(3)
    z, y, x = np.meshgrid(*[np.arange(48.0)] * 3, indexing="ij")
    found = np.zeros(grid.shape, np.float32)
    for _ in range(25):
        at, radius = rng.uniform(12, 36, 3), rng.uniform(2, 5)
        found[(z - at[0]) ** 2 + (y - at[1]) ** 2 + (x - at[2]) ** 2 < radius**2] = 0.04
    return found


@pytest.fixture(scope="module")
def scanned():
    """A grid, the geometry that made the projections of a body, and those."""
    grid = VolumeGrid((48, 48, 48), (3.0, 3.0, 3.0), Pose.identity())
    section = ArcTrajectory(kind="arc", views=VIEWS, sod_mm=300.0, sdd_mm=600.0)
    longitude = np.linspace(-1.8, 1.8, VIEWS)
    source = on_sphere(longitude, 0.5 * np.sin(longitude), 300.0)
    geometry = orbit_views(section, Panel(96, 112, 3.0, 3.0), source)
    return grid, geometry, Projector(geometry, grid)(body(grid))


def off_px(geometry, executed):
    points = np.array([[0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20.0]])
    return aligned(geometry, executed, points).after_px


def test_errors_of_each_view_are_found(scanned):
    grid, executed, p = scanned
    rng = np.random.default_rng(5)
    sigma = np.array([PRIOR.sigma_mm] * 6 + [np.radians(PRIOR.sigma_deg)] * 3)
    believed = moved(executed, sigma * rng.normal(size=(VIEWS, 9)))
    found = self_calibrated(p, believed, grid, PRIOR, rounds=[Round(2)] * 3)
    # 0.22; without momentum 0.41, with a volume of three passes of SART 0.29
    assert off_px(found.geometry, executed) < 0.25 * off_px(believed, executed)
    assert found.residuals[-1] < 0.95 * found.residuals[0]


def test_a_geometry_without_errors_stays(scanned):
    grid, executed, p = scanned
    found = self_calibrated(p, executed, grid, PRIOR, rounds=[Round(2)])
    assert off_px(found.geometry, executed) < 0.05


def test_a_patient_who_nods_is_followed(scanned):
    grid, still, p = scanned
    share = np.linspace(0, 1, VIEWS)
    nod = np.sin(np.pi * share)[:, None] * [2.0, -1.0, 1.5, 0.02, 0.03, -0.015]
    nod[16:] += [1.0, 1.0, 0.0, 0.0, 0.01, 0.0]
    executed = ScanGeometry.joined(
        [Pose.exp(one) @ view for one, view in zip(nod, still, strict=True)]
    )
    seen = Projector(executed, grid)(body(grid))
    prior = PosePrior(sigma_mm=2.0, sigma_deg=1.5, correlation_views=6)
    rounds = [Round(2)] * 4
    found = self_calibrated(seen, still, grid, prior, what="patient", rounds=rounds)
    assert found.change.shape == (VIEWS, 6)
    assert off_px(found.geometry, executed) < 0.4 * off_px(still, executed)
    # source and panel stand to each other as they were believed to
    apart = np.linalg.norm(found.geometry.source - found.geometry.detector, axis=1)
    np.testing.assert_allclose(apart, 600, atol=1e-9)


def test_it_goes_on_from_a_start(scanned):
    grid, executed, p = scanned
    rng = np.random.default_rng(5)
    sigma = np.array([PRIOR.sigma_mm] * 6 + [np.radians(PRIOR.sigma_deg)] * 3)
    change = sigma * rng.normal(size=(VIEWS, 9))
    believed = moved(executed, change)
    # In the panel's own axes a small change is undone by its negative.
    found = self_calibrated(p, believed, grid, PRIOR, start=-change, rounds=[Round(2)])
    assert off_px(found.geometry, executed) < 0.05 * off_px(believed, executed)
    with pytest.raises(InputError, match=r"start has shape \(24, 6\); it must be \(24, 9\)"):
        self_calibrated(p, believed, grid, PRIOR, start=change[:, :6])
