"""Scans from numbers alone: a gantry that stands exactly where it was commanded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.scan import Scan, Simulated
from twinct.scenario import Scenario
from twinct.trajectory import commanded_views


def views_of(scenario: Scenario) -> ScanGeometry:
    """The views that a scenario commands."""
    return commanded_views(scenario.trajectory, scenario.detector.panel)


def still_scan(scenario: Scenario, transmission: NDArray[np.float32], **keys: object) -> Scan:
    """A scan with these images; its three geometries are alike."""
    poses, views = PosePairs.from_geometry(views_of(scenario)), len(transmission)
    taken = Simulated(
        scenario=scenario,
        commanded=poses,
        executed=poses,
        executed_object=(),
        joint_names=(),
        joints=np.zeros((views, 0)),
        simulated_s=np.arange(views, dtype=float),
        clearance_mm=np.full(views, 50.0),
    )
    return Scan(taken, transmission, **keys)


def chords(geometry: ScanGeometry, view: int, *radii_mm: float) -> list[NDArray[np.float64]]:
    """Lengths of the rays of a view in balls about the origin, mm, (rows, columns) each."""
    source = geometry.source[view]
    ray = geometry.pixel_centres(view) - source
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    far = source @ source - (ray @ source) ** 2
    return [2 * np.sqrt(np.maximum(radius**2 - far, 0)) for radius in radii_mm]
