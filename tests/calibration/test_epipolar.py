"""Planes that views share: what is told of them is true, and views are moved until it agrees."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from soft_balls import CENTRES, MU, RADII, images

from twinct.calibration.epipolar import EMPTY, PlaneDerivatives, epipolar_consistent
from twinct.calibration.freedom import PosePrior
from twinct.calibration.modes import aligned
from twinct.calibration.plane_integrals import PlaneIntegrals
from twinct.calibration.plane_pairs import PlanePairs
from twinct.calibration.resection import moved
from twinct.core.errors import CalibrationError, InputError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.trajectory import ArcTrajectory, on_sphere
from twinct.trajectory.orbit import orbit_views

GRID = VolumeGrid((8, 8, 8), (20.0, 20.0, 20.0), Pose.identity())
PANEL = Panel(96, 104, 2.4, 2.4)
POINTS = np.array([[0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20.0]])
ACROSS = (70, 140)
PRIOR = PosePrior(sigma_mm=1.0, sigma_deg=0.3)
SIGMA = np.array([PRIOR.sigma_mm] * 6 + [np.radians(PRIOR.sigma_deg)] * 3)

BLUR = 0.03
"""Pixels and their smoothing, about 1.7 mm in the middle, take so much of these derivatives."""


def derivatives(normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Of plane integrals, mu pi R^2 (1 - d^2)^3 / 3 at d R from a centre, as planes shift."""
    d = (offsets[:, None] - normals @ CENTRES.T) / RADII
    return (-2 * np.pi * MU * RADII * d * np.maximum(1 - d**2, 0) ** 2).sum(axis=1)


def free_views(panel: Panel, views: int = 5) -> ScanGeometry:
    """Sources anywhere about, panels tilted by some 15 degrees and turned anyhow."""
    rng = np.random.default_rng(7)
    towards = rng.normal(size=(views, 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    u = np.cross(towards, rng.normal(size=(views, 3)))
    u /= np.linalg.norm(u, axis=1)[:, None]
    tilt = Rotation.from_rotvec(0.25 * rng.normal(size=(views, 3)))
    return ScanGeometry(
        towards * rng.uniform(280, 340, (views, 1)),
        -towards * 290 + 8 * rng.normal(size=(views, 3)),
        tilt.apply(u),
        tilt.apply(np.cross(towards, u)),
        panel,
    )


def views_about(views: int = 16, panel: Panel = PANEL, latitude: float = 0.5) -> ScanGeometry:
    section = ArcTrajectory(kind="arc", views=views, sod_mm=300.0, sdd_mm=600.0)
    longitude = np.linspace(-1.8, 1.8, views)
    return orbit_views(section, panel, on_sphere(longitude, latitude * np.sin(longitude), 300.0))


def off_px(geometry: ScanGeometry, executed: ScanGeometry) -> float:
    return aligned(geometry, executed, POINTS).after_px


def wrong(executed: ScanGeometry, seed: int = 5) -> ScanGeometry:
    rng = np.random.default_rng(seed)
    return moved(executed, SIGMA * rng.normal(size=(len(executed), 9)))


def seen_planes(geometry: ScanGeometry, view: int, planes: int = 2000):
    """Normals of planes through a view's source and the middle's surroundings, and its lines."""
    rng = np.random.default_rng(view)
    source = geometry.source[view]
    ray = rng.uniform(-40, 40, (planes, 3)) - source
    normals = np.cross(ray, rng.normal(size=(planes, 3)))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    axes = np.stack([geometry.u[view], geometry.v[view], source - geometry.detector[view]])
    return normals, normals @ axes.T


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def missed(pitch: float) -> float:
    """By how much tilted views miss the analytic derivatives, RMS of RMS."""
    size = round(250 / pitch)
    geometry = free_views(Panel(size, size + 8, pitch, pitch))
    integrals = PlaneIntegrals(images(geometry), geometry)
    errors, truths = [], []
    for view in range(len(geometry)):
        normals, lines = seen_planes(geometry, view)
        told, _, left = integrals.at(view, lines)
        truth = derivatives(normals, normals @ geometry.source[view])
        own = left < EMPTY
        assert own.mean() > 0.8
        errors.append(told[own] - truth[own])
        truths.append(truth[own])
    return rms(np.concatenate(errors)) / rms(np.concatenate(truths))


def test_a_tilted_view_tells_the_derivative_of_plane_integrals() -> None:
    coarse, fine = missed(2.8), missed(1.4)
    assert coarse < BLUR
    # Nothing is left but the pixels' own blur, which goes about with their size squared.
    assert fine < 0.33 * coarse


def test_how_a_line_changes_what_is_told() -> None:
    geometry = free_views(PANEL)
    integrals = PlaneIntegrals(images(geometry), geometry)
    _, lines = seen_planes(geometry, 2)
    _, slopes, left = integrals.at(2, lines)
    own = np.isfinite(left)
    for axis, step in enumerate((1e-3, 1e-3, 0.3)):
        by = np.eye(3)[axis] * step
        numeric = (integrals.at(2, lines + by)[0] - integrals.at(2, lines - by)[0]) / (2 * step)
        assert rms(slopes[own, axis] - numeric[own]) < 0.01 * rms(numeric[own])


@pytest.mark.parametrize("normal", [[1.0, 0.0], [-1.0, 0.0], [-1.0, -0.0], [0.0, -1.0]])
def test_a_line_along_a_panels_side_told_either_way_round(normal) -> None:
    geometry = free_views(PANEL)
    integrals = PlaneIntegrals(images(geometry), geometry)
    line = np.array([*normal, 12.0])
    told, slope, _ = integrals.at(0, line)
    near, _, _ = integrals.at(0, line + [1e-7, 1e-7, 0])
    turned, turned_slope, _ = integrals.at(0, -line)
    assert abs(told) > 0.1
    assert near == pytest.approx(told, rel=1e-3)
    assert turned == pytest.approx(-told, rel=1e-6)
    np.testing.assert_allclose(turned_slope, slope, rtol=1e-3, atol=1e-3)


def disagreement(p: np.ndarray, geometry: ScanGeometry) -> float:
    """Of both views of all pairs, against what they tell."""
    pairs = PlanePairs.of(geometry, np.zeros(3))
    integrals = PlaneIntegrals(p, geometry)
    lines = pairs.lines(geometry)
    told, left = np.zeros(lines.shape[:-1]), np.zeros(lines.shape[:-1])
    for view in range(len(geometry)):
        own = pairs.sides == view
        told[own], _, left[own] = integrals.at(view, lines[own])
    both = (left < EMPTY).all(axis=0)
    assert both.mean() > 0.3
    return rms((told[0] - told[1])[both]) / rms(told[:, both])


def test_two_views_tell_the_same_and_a_mirrored_panel_does_not() -> None:
    geometry = free_views(PANEL, views=6)
    p = images(geometry)
    assert disagreement(p, geometry) < BLUR
    for mirrored in (p[:, ::-1], p[:, :, ::-1]):
        assert disagreement(mirrored, geometry) > 0.5


def test_a_view_shifted_across_the_planes_goes_back() -> None:
    executed = views_about(latitude=0.0)
    change = np.zeros((len(executed), 9))
    change[5, 4] = 1.8  # the panel, along v: the axis of rotation
    believed = moved(executed, change)
    found = epipolar_consistent(images(executed), believed, GRID, PRIOR, across=ACROSS)
    rows = [
        float((view.project(POINTS) - executed.project(POINTS))[5, :, 1].mean())
        for view in (believed, found.geometry)
    ]
    assert abs(rows[0]) == pytest.approx(0.75, rel=1e-6)
    assert abs(rows[1]) < 0.06


def test_errors_of_all_views_are_found() -> None:
    executed = views_about()
    believed = wrong(executed)
    found = epipolar_consistent(images(executed), believed, GRID, PRIOR, across=ACROSS)
    assert off_px(found.geometry, executed) < 0.15 * off_px(believed, executed)
    assert found.residuals[-1] < 0.2 * found.residuals[0]
    assert len(found.residuals) == len(ACROSS) + 1
    assert (found.complete > 0.9 * found.planes).all() and not found.problems


def test_a_geometry_without_errors_stays() -> None:
    executed = views_about()
    found = epipolar_consistent(images(executed), executed, GRID, PRIOR, across=ACROSS)
    assert off_px(found.geometry, executed) < 0.05


def test_a_patient_who_moves_is_followed() -> None:
    still = views_about()
    nod = np.sin(np.linspace(0, np.pi, len(still)))[:, None] * [2, -1, 1.5, 0.02, 0.03, -0.015]
    executed = ScanGeometry.joined(
        [Pose.exp(one) @ view for one, view in zip(nod, still, strict=True)]
    )
    prior = PosePrior(sigma_mm=2.0, sigma_deg=1.5, correlation_views=6)
    p = images(executed)
    found = epipolar_consistent(p, still, GRID, prior, what="patient", across=ACROSS)
    assert found.change.shape == (len(still), 6)
    assert off_px(found.geometry, executed) < 0.2 * off_px(still, executed)


def test_cut_lines_are_known_as_such_and_help_all_the_same() -> None:
    small = Panel(60, 68, 2.4, 2.4)
    executed = views_about(panel=small)
    p = images(executed)
    integrals = PlaneIntegrals(p, executed)
    complete, cut, usual = [], [], []
    for view in range(len(executed)):
        normals, lines = seen_planes(executed, view)
        told, _, left = integrals.at(view, lines)
        truth = derivatives(normals, normals @ executed.source[view])
        usual.append(truth[left < EMPTY])
        complete.append((told - truth)[left < EMPTY])
        cut.append((told - truth)[np.isfinite(left) & (left > 0.1)])
    usual, complete, cut = (np.concatenate(one) for one in (usual, complete, cut))
    complete, cut = (float(np.median(np.abs(one))) for one in (complete, cut))
    assert complete < BLUR * rms(usual)
    assert cut > 3 * complete
    believed = wrong(executed)
    found = epipolar_consistent(p, believed, GRID, PRIOR, across=(90, 90))
    assert found.complete.sum() < 0.5 * found.planes.sum()
    assert off_px(found.geometry, executed) < 0.5 * off_px(believed, executed)


def test_lines_across_pixels_that_do_not_count_do_not_count() -> None:
    executed = views_about(6)
    p = images(executed)
    mask = np.ones(p.shape, bool)
    mask[2, 40:50, 30:70] = False
    broken = np.where(mask, p, 50.0).astype(np.float32)
    whole, holed = PlaneIntegrals(p, executed), PlaneIntegrals(broken, executed, mask)
    _, lines = seen_planes(executed, 2)
    told, _, left = holed.at(2, lines)
    own = np.isfinite(left)
    assert 0.1 < own.mean() < 0.7
    truth = whole.at(2, lines)[0]
    assert rms((told - truth)[own]) < 0.01 * rms(truth[own])
    assert np.isfinite(holed.at(3, lines)[2]).sum() == np.isfinite(whole.at(3, lines)[2]).sum()


def test_a_view_that_shares_nothing_is_named_and_others_go_on() -> None:
    executed = views_about()
    believed = wrong(executed)
    p = images(executed)
    mask = np.ones(p.shape, bool)
    mask[4] = False
    p[7] = 0
    p[4] = np.nan
    found = epipolar_consistent(p, believed, GRID, PRIOR, mask=mask, across=ACROSS)
    assert list(found.problems) == [4]
    assert "0 planes through its source and another cut both panels" in found.problems[4]
    assert found.planes[4] == 0
    np.testing.assert_allclose(found.change[4], 0, atol=1e-12)
    others = [view for view in range(len(executed)) if view not in (4, 7)]
    left = off_px(found.geometry[others], executed[others])
    assert left < 0.3 * off_px(believed[others], executed[others])


@pytest.mark.parametrize(
    ("views", "blank", "said"),
    [
        ([0, 0, 0, 0], False, "view 0: its source is too near to all sources"),
        ([0, 3, 6, 9], True, "view 0: 0 of the .* planes that it shares"),
        ([0], False, "view 0: its source is too near"),
    ],
)
def test_a_scan_without_shared_planes_is_refused(views, blank, said) -> None:
    executed = views_about(12)[views]
    p = images(executed) * (0 if blank else 1)
    with pytest.raises(CalibrationError, match=said):
        epipolar_consistent(p, executed, GRID, PRIOR, across=ACROSS)


def test_arrays_that_do_not_fit_are_refused() -> None:
    executed = views_about(4)
    p = images(executed)
    with pytest.raises(InputError, match="the geometry needs"):
        epipolar_consistent(p[:3], executed, GRID, PRIOR)
    with pytest.raises(InputError, match="must be bool"):
        epipolar_consistent(p, executed, GRID, PRIOR, mask=np.ones(PANEL.shape))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="across is empty"):
        epipolar_consistent(p, executed, GRID, PRIOR, across=())
    p[1, 3, 4] = np.nan
    with pytest.raises(InputError, match="view 1 of the projections has 1 pixels"):
        epipolar_consistent(p, executed, GRID, PRIOR)


def test_a_few_planes_that_happen_to_agree_do_not_outweigh_all_others() -> None:
    views = views_about(3)
    pairs = PlanePairs.of(views, np.zeros(3))
    told = np.zeros((2, *pairs.normals.shape[:2]))
    told[0] = np.random.default_rng(2).normal(size=told.shape[1:])
    complete = np.zeros(told.shape[1:], bool)
    complete[0, :5] = True
    told[0, complete] = 1e-6
    every = np.ones_like(complete)
    seen = PlaneDerivatives(views, pairs, told, np.zeros((*told.shape, 3)), every, every, complete)
    weights = seen.weights()
    assert weights[complete].max() == pytest.approx(weights.max())
    # One standard deviation of the differences, 30 of which count as one.
    assert weights.max() == pytest.approx(1 / 30, rel=0.2)
