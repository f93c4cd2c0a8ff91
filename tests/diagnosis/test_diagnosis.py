"""Each cause, injected alone into the scan of an asymmetric object, is the first one named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twinct.diagnosis import diagnosed
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.recon import Projector

VIEWS, PIXELS, PHOTONS = 40, 36, 3e5
GRID = VolumeGrid([32] * 3, 1.0)
FINE = VolumeGrid([80] * 3, 0.4)


def circle() -> ScanGeometry:
    """Views of a circle about z, 120 mm from the axis and 200 mm from the panel."""
    angle = 2 * np.pi * np.arange(VIEWS) / VIEWS
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(VIEWS)], axis=1)
    u = np.stack([-np.sin(angle), np.cos(angle), np.zeros(VIEWS)], axis=1)
    pitch = 58 / PIXELS
    return ScanGeometry(
        120 * out, -80 * out, u, np.cross(out, u), Panel(PIXELS, PIXELS, *[pitch] * 2)
    )


def ball(x: float, y: float, z: float, radius: float) -> np.ndarray:
    """Return 1 in a ball, (z, y, x)."""
    i, j, k = FINE.axes()
    far = (i - x) ** 2 + (j - y)[:, None] ** 2 + (k - z)[:, None, None] ** 2
    return (far < radius**2).astype(np.float32)


BODY = 0.08 * (ball(1, -1, 0, 12) - ball(4, 3, 3, 4) + 0.6 * ball(-4, 1, -3, 4) - ball(2, -7, 5, 3))
METAL = 0.5 * sum(ball(*at, 2.6) for at in ((3, -3, -4), (-5, -2, 2), (0, 6, -2), (2, -3, 7)))


def seen(beam: np.ndarray) -> np.ndarray:
    """Return line integrals of transmissions, with the noise of photons."""
    photons = np.random.default_rng(1).poisson(np.maximum(beam, 0) * PHOTONS)
    return -np.log(np.maximum(photons, 0.5) / PHOTONS).astype(np.float32)


def lines(geometry: ScanGeometry, body: np.ndarray = BODY) -> np.ndarray:
    """Return exact line integrals."""
    return Projector(geometry, FINE)(body)


def named(
    p: np.ndarray, geometry: ScanGeometry | None = None, grid: VolumeGrid = GRID
) -> list[str]:
    """Return the names of the causes."""
    A = Projector(geometry or circle(), grid)
    found = diagnosed(A, p, photons=np.full(VIEWS, PHOTONS))
    return [one.name for one in found.named]


def taken_at(**changed: np.ndarray) -> np.ndarray:
    """Return a scan at a geometry that differs from the stated one."""
    return seen(np.exp(-lines(replace(circle(), **changed))))


def turned(degrees: float) -> dict[str, np.ndarray]:
    """Return the axes of a panel that is turned in its plane."""
    c, s, g = np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), circle()
    return {"u": c * g.u + s * g.v, "v": c * g.v - s * g.u}


def test_a_scan_without_errors_names_no_cause():
    assert named(seen(np.exp(-lines(circle())))) == []


def test_an_offset_is_named():
    g = circle()
    assert named(taken_at(detector=g.detector + 1.0 * g.u))[0] == "offset"


def test_a_roll_is_named():
    assert named(taken_at(**turned(2)))[0] == "roll"


def test_a_leaning_axis_is_named():
    g, c, s = circle(), np.cos(np.radians(3)), np.sin(np.radians(3))
    out, up = g.source / 120, np.array([0.0, 0.0, 1.0])
    away = c * out + s * up
    geometry = replace(g, source=120 * away, detector=-80 * away, v=c * up - s * out)
    assert named(seen(np.exp(-lines(geometry))))[0] == "tilt"


def test_a_turn_by_less_than_stated_is_named():
    g, angle = circle(), 2 * np.pi * np.arange(VIEWS) / VIEWS * 0.96
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    u = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    geometry = replace(g, source=120 * out, detector=-80 * out, u=u)
    assert named(seen(np.exp(-lines(geometry))))[0] == "angles"


def test_a_motion_is_named():
    g, course = circle(), np.linspace(-1, 1, VIEWS)[:, None] * np.array([0.3, 0.5, 0.7])
    assert named(taken_at(source=g.source + course, detector=g.detector + course))[0] == "motion"


def test_poses_of_single_views_are_named():
    g, off = circle(), np.random.default_rng(2).normal(0, 1.0, (VIEWS, 2))
    detector = g.detector + off[:, :1] * g.u + off[:, 1:] * g.v
    assert named(taken_at(detector=detector))[0] == "poses"


def test_air_that_does_not_read_1_is_named():
    assert named(seen(0.8 * np.exp(-lines(circle()))))[0] == "air"


def test_a_beam_that_hardens_is_named():
    p = lines(circle())
    assert named(seen((np.exp(-4 * p) + np.exp(-p / 4)) / 2))[0] == "beam"


def test_metal_is_named():
    p, m = lines(circle()), lines(circle(), METAL)
    assert named(seen((np.exp(-p - 2 * m) + np.exp(-p - m / 2)) / 2))[0] == "metal"


@pytest.mark.parametrize("floor", [0.25, 0.4])
def test_starved_pixels_are_named(floor):
    p = seen(np.exp(-lines(circle())))
    assert named(np.minimum(p, -np.log(np.float32(floor))))[0] == "pixels"


def test_saturated_pixels_are_named():
    p = seen(np.exp(-lines(circle())))
    assert named(np.maximum(p, np.float32(0.3)))[0] == "pixels"


def test_an_object_beyond_the_grid_is_named():
    small = VolumeGrid([18] * 3, 1.0)
    assert named(seen(np.exp(-lines(circle()))), grid=small)[0] == "truncation"


def test_an_object_beyond_the_panel_is_named():
    """The rays that are left agree; only the panel's border shows it."""
    g = circle()
    narrow = replace(g, panel=replace(g.panel, columns=16))
    assert named(seen(np.exp(-lines(narrow))), narrow)[0] == "truncation"


def test_a_reversed_order_of_the_views_is_named():
    p = seen(np.exp(-lines(circle())))
    assert named(p[::-1])[0] == "order"


def test_views_in_the_order_of_their_names_are_named():
    p = seen(np.exp(-lines(circle())))
    assert named(p[sorted(range(VIEWS), key=str)])[0] == "order"
