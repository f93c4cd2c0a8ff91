"""Scatter by Monte Carlo in a scan: units, interpolation between views, and settings."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.scenario import Detector, Source, Specimen
from twinct.specimen import BuiltSpecimen, build_specimen
from twinct.specimen.materials import material
from twinct.trajectory import CircleTrajectory, commanded_views
from twinct.transport import Beam, Simulation, VoxelBody
from twinct.transport import Detector as Scored
from twinct.xray import Imager

PIXELS = {"rows": 20, "columns": 24, "pixel_pitch_mm": 15.0}
PANEL = Panel(20, 24, 15.0, 15.0)
SOURCE = Source.model_validate({"energy_kev": 80.0, "current_ma": 20.0, "photons_per_mm2_mas": 1e4})


def _detector(**scatter: float) -> Detector:
    settings = {"kind": "monte_carlo", "pixel_mm": 30.0, **scatter} if scatter else None
    return Detector.model_validate({**PIXELS, "pixel_samples": 2, "scatter": settings})


def _circle(views: int) -> ScanGeometry:
    circle = CircleTrajectory(kind="circle", views=views, sod_mm=600, sdd_mm=1000)
    return commanded_views(circle, PANEL)


def _ball(radius_mm: float = 50.0, centre_mm: float = 0.0) -> BuiltSpecimen:
    ball = {"kind": "sphere", "radius_mm": radius_mm}
    part = {"shape": ball, "material": "water", "position_mm": [centre_mm, 0, 0]}
    return build_specimen(Specimen.model_validate({"parts": [part]}))


def _scatter(specimen: BuiltSpecimen, path: ScanGeometry, view: int, **scatter: float):
    """Return the scatter of a view, as a share of the free beam."""
    images = []
    for detector in (_detector(**scatter), _detector()):
        imager = Imager(SOURCE, detector, specimen, commanded=path, engine="mesh")
        with imager:
            images.append(imager.render(path[view], specimen.world_from_specimen, view))
    return images[0].astype(np.float64) - images[1]


def test_scatter_of_a_scan_is_that_of_the_transport() -> None:
    """An image has the scatter of a simulation of the ball, in units of the free beam."""
    views = _circle(4)
    found = _scatter(_ball(), views, 1, photons=400_000, voxel_mm=2.5)
    # The same ball by its own voxels, with a panel of its own.
    grid = VolumeGrid((80, 80, 80), 1.25)
    x, y, z = grid.axes()
    inside = x**2 + y[:, None] ** 2 + z[:, None, None] ** 2 < 50.0**2
    body = VoxelBody.of_densities(grid, inside * 0, inside * 1.0, [material("water")])
    simulation = Simulation(
        body, Beam.of_view(views, 1, 80.0), dose=False, detector=Scored(views, 1)
    )
    scatter, error = simulation.run(50_000, 16, seed=3).scatter()
    empty = VoxelBody.of_densities(grid, inside * 0, inside * 0.0, [material("water")])
    beam = Beam.of_view(views, 1, 80.0)
    free = Simulation(empty, beam, dose=False, detector=Scored(views, 1)).primary()
    middle = np.s_[6:14, 7:17]
    expected = scatter.sum(0)[middle].sum() / free[middle].sum()
    # 1 % standard error of each.
    assert np.sqrt((error**2).sum()) / scatter.sum() < 0.01
    assert found[middle].mean() == pytest.approx(expected, rel=0.04)
    assert found[middle].mean() > 0.01


def test_views_between_simulated_ones_take_their_mean() -> None:
    """A ball beside the axis: interpolated scatter differs little from that of a view itself."""
    specimen, views = _ball(40.0, 40.0), _circle(48)
    settings = {"photons": 400_000, "voxel_mm": 4.0}
    own = _scatter(specimen, views, 7, views=48, **settings)
    near = _scatter(specimen, views, 7, views=16, **settings)
    opposite = _scatter(specimen, views, 31, views=48, **settings)
    deviation = np.sqrt(((near - own) ** 2).mean()) / own.mean()
    # Noise of 5 % in coarse pixels, and 22.5 degrees between nodes.
    assert deviation < 0.12
    assert np.sqrt(((opposite - own) ** 2).mean()) / own.mean() > 0.2


def test_scatter_moves_with_the_executed_pose() -> None:
    """A view elsewhere takes the scatter of the commanded views that are nearest to it."""
    views = _circle(6)
    specimen = _ball(40.0, 40.0)
    turned = Pose.from_euler([0, 0, 0], [0, 0, 60.0]) @ specimen.world_from_specimen
    settings = {"photons": 50_000, "voxel_mm": 4.0}
    detector = _detector(**settings)
    with Imager(SOURCE, detector, specimen, commanded=views, engine="mesh") as imager:
        there = imager.render(views[1], specimen.world_from_specimen, 0)
        # The body turned by one step, seen one step later.
        same = imager.render(views[2], turned, 0)
    np.testing.assert_allclose(same, there, rtol=1e-5)


def test_settings_that_cannot_be_are_refused() -> None:
    """Energies outside the tables and voxels that are too small are named by their key."""
    views = _circle(3)
    with pytest.raises(InputError, match="1 to 150 keV"):
        Imager(
            Source.model_validate({"energy_kev": 200.0}),
            _detector(photons=1000),
            _ball(),
            commanded=views,
            engine="mesh",
        )
    with pytest.raises(InputError, match=r"detector\.scatter\.voxel_mm"):
        Imager(
            SOURCE,
            _detector(photons=1000, voxel_mm=0.01),
            _ball(),
            commanded=views,
            engine="mesh",
        )
