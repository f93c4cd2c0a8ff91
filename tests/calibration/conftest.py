"""A phantom and its images, by rays that share nothing with what is tested."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from twinct.calibration import BallPhantom
from twinct.geometry import Panel, ScanGeometry
from twinct.scenario import BallHelix
from twinct.specimen.balls import nominal_centres
from twinct.trajectory import ArcTrajectory, on_sphere
from twinct.trajectory.orbit import orbit_views

PANEL = Panel(240, 320, 1.0, 1.0)
MU_PER_MM = 0.9
"""Of steel at 60 keV."""


NEAR_PX = 12
"""A shadow reaches no further than this from its middle."""


def phantom(tolerance_mm: float = 0.0) -> BallPhantom:
    shape = BallHelix(kind="ball_helix", radius_mm=60.0, height_mm=110.0, turns=4.3)
    return BallPhantom(nominal_centres(shape), shape.ball_radius_mm, tolerance_mm)


def views(number: int) -> ScanGeometry:
    """Some of an arc at a latitude."""
    section = ArcTrajectory(kind="arc", views=number, sod_mm=300.0, sdd_mm=600.0)
    longitude = np.linspace(0.1, 3.0, number)
    return orbit_views(section, PANEL, on_sphere(longitude, np.full(number, 0.2), 300.0))


def off(geometry: ScanGeometry, rng: np.random.Generator, mm: float, deg: float) -> ScanGeometry:
    """Source and panel somewhere else."""
    from twinct.calibration import moved

    sigma = np.array([mm] * 6 + [np.radians(deg)] * 3)
    return moved(geometry, sigma * rng.normal(size=9))


def image(
    view: ScanGeometry, phantom: BallPhantom, samples: int = 4, blur_px: float = 0.0
) -> np.ndarray:
    """Transmission through the balls: chords of rays to points of each pixel, averaged."""
    panel = view.panel
    fine = (np.arange(samples) + 0.5) / samples - 0.5
    paths = np.zeros((samples, samples, panel.rows, panel.columns))
    pixels = view.pixel_centres(0)
    for centre, (column, row) in zip(
        phantom.centres, view.project(phantom.centres)[0], strict=True
    ):
        low = np.maximum(np.array([row, column]).astype(int) - NEAR_PX, 0)
        window = tuple(slice(at, at + 2 * NEAR_PX) for at in low)
        to_ball = centre - view.source[0]
        for i, du in enumerate(fine):
            for j, dv in enumerate(fine):
                off = du * panel.pitch_u * view.u[0] + dv * panel.pitch_v * view.v[0]
                ray = pixels[window] + off - view.source[0]
                along = ray @ to_ball / np.linalg.norm(ray, axis=2)
                square = phantom.radius_mm**2 - (to_ball @ to_ball - along**2)
                paths[(i, j, *window)] += 2 * np.sqrt(np.maximum(square, 0.0))
    total = np.exp(-MU_PER_MM * paths).mean(axis=(0, 1))
    return (gaussian_filter(total, blur_px) if blur_px else total).astype(np.float32)
