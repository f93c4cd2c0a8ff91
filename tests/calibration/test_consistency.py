"""Geometry from projections alone: what was wrong with it is found, but for what no ray can see."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.calibration.consistency import PosePrior, Round, all_moved, self_calibrated
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.recon import Projector
from twinct.trajectory import ArcTrajectory, on_sphere
from twinct.trajectory.orbit import orbit_views

PRIOR = PosePrior(sigma_mm=1.0, sigma_deg=0.3)
VIEWS = 24


@pytest.fixture(scope="module")
def scanned():
    """Bodies of no symmetry, the geometry that made their projections, and those."""
    grid = VolumeGrid((48, 48, 48), (3.0, 3.0, 3.0), Pose.identity())
    rng = np.random.default_rng(3)
    z, y, x = np.meshgrid(*[np.arange(48.0)] * 3, indexing="ij")
    body = np.zeros(grid.shape, np.float32)
    for _ in range(25):
        at, radius = rng.uniform(12, 36, 3), rng.uniform(2, 5)
        body[(z - at[0]) ** 2 + (y - at[1]) ** 2 + (x - at[2]) ** 2 < radius**2] = 0.04
    section = ArcTrajectory(kind="arc", views=VIEWS, sod_mm=300.0, sdd_mm=600.0)
    longitude = np.linspace(-1.8, 1.8, VIEWS)
    source = on_sphere(longitude, 0.5 * np.sin(longitude), 300.0)
    geometry = orbit_views(section, Panel(96, 112, 3.0, 3.0), source)
    return grid, geometry, Projector(geometry, grid)(body)


def off_px(geometry, executed):
    points = np.array([[0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20.0]])
    return float(np.sqrt(((geometry.project(points) - executed.project(points)) ** 2).mean()))


def test_errors_of_each_view_are_found(scanned):
    grid, executed, p = scanned
    rng = np.random.default_rng(5)
    sigma = np.array([PRIOR.sigma_mm] * 6 + [np.radians(PRIOR.sigma_deg)] * 3)
    believed = all_moved(executed, sigma * rng.normal(size=(VIEWS, 9)))
    found = self_calibrated(p, believed, grid, PRIOR, rounds=[Round(2)] * 3)
    assert off_px(found.geometry, executed) < 0.4 * off_px(believed, executed)
    assert found.residuals[-1] < 0.95 * found.residuals[0]


def test_a_geometry_without_errors_stays(scanned):
    grid, executed, p = scanned
    found = self_calibrated(p, executed, grid, PRIOR, rounds=[Round(2)])
    assert off_px(found.geometry, executed) < 0.05
