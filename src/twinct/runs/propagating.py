"""Propagation of a scenario's errors to its geometry, without motion or images."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Floats
from twinct.report import plain
from twinct.robots.cell import chains_of
from twinct.scan import SimulationBuilder
from twinct.scenario import GantryCell
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.propagation import Propagation, propagate

LATTICE = 5
"""Points along each axis of the grid; only points that every view sees are used."""

COMPARED_VIEWS = 5
"""Number of evenly spaced views whose mutual covariances are written."""

FRAME = (
    "errors are executed minus believed: displacement of the focal spot, mm, and rotation of the "
    "source, rad, then those of panel centre and panel; all along and about the world's axes"
)


def nominal_scan(builder: SimulationBuilder) -> NominalScan:
    """Return the nominal views of a scenario, as its controllers expect them.

    Raises:
        TrajectoryError: a view is out of reach or would collide.
    """
    cell = builder.scenario.cell
    if isinstance(cell, GantryCell):
        views = builder.commanded
        return NominalScan.of_gantry(views, cell.view_s * np.arange(1.0, len(views) + 1))
    plan = builder.plan
    assert plan is not None
    speeds = plan.state[plan.waypoints, 1]
    return NominalScan.of_arms(
        *(chains_of(builder.cell), plan.joints, speeds, plan.exposures_s),
        lambda times: plan.at(times)[:, 2],
    )


def errors_of(builder: SimulationBuilder, draws: int = 1000) -> Propagation:
    """Draw a scenario's errors repeatedly, and compute their first-order covariances.

    Raises:
        InputError: fewer than two draws, or calibrated arms (``uncertainty.calibration``).
        TrajectoryError: a view is out of reach or would collide.
    """
    if draws < 2:
        raise InputError(f"draws ({draws}) must be at least 2: one has no spread")
    scenario = builder.scenario
    if file := scenario.uncertainty.calibration:
        raise InputError(
            f"uncertainty.calibration: {file} describes one pair of arms, but here others are "
            "drawn; with a section task, the views are judged for this pair"
        )
    return propagate(
        scenario.uncertainty,
        nominal_scan(builder),
        scenario.detector.panel,
        visible_points(builder),
        draws=draws,
        seed=scenario.seed,
        arms_seed=scenario.arms_seed,
    )


def visible_points(builder: SimulationBuilder) -> Floats:
    """Return the isocentre and the points of a lattice that every view sees, (points, 3), mm."""
    scenario, views = builder.scenario, builder.commanded
    grid, panel = scenario.reconstruction.volume_grid, scenario.detector.panel
    shares = np.arange(LATTICE) / (LATTICE - 1)
    ends = [axis[0] + shares * (axis[-1] - axis[0]) for axis in grid.axes()]
    lattice = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 3)
    places = grid.world_from_grid.apply(lattice)
    last = np.array([panel.columns, panel.rows]) - 1.0
    images = views.project(places)
    seen = ((images >= 0) & (images <= last)).all(axis=(0, 2))
    # A file of views has no isocentre: use the world's origin.
    isocentre = getattr(scenario.trajectory, "isocentre_mm", (0.0, 0.0, 0.0))
    return np.concatenate([[isocentre], places[seen]])


def propagation_data(propagation: Propagation, builder: SimulationBuilder) -> dict[str, Any]:
    """Return propagated errors as plain data: distributions, causes and covariances."""
    scenario, errors, analytic = builder.scenario, propagation.errors, propagation.analytic
    draws, views = errors.shape[:2]
    shown = sorted({k * (views - 1) // (COMPARED_VIEWS - 1) for k in range(COMPARED_VIEWS)})
    some = errors[:, shown].reshape(draws, -1)
    return plain(
        {
            "scenario": scenario.name,
            "draws": draws,
            "seed": scenario.seed,
            "arms_seed": scenario.arms_seed,
            "frame": FRAME,
            "points_mm": propagation.points,
            "summary": summary(propagation),
            "terms": propagation.shares(),
            "views": [
                {
                    "view": view,
                    **{
                        name: _spread(values[:, view])
                        for name, values in figures(propagation).items()
                    },
                    "mean": errors[:, view].mean(axis=0),
                    "covariance": analytic.covariances[view],
                    "covariance_drawn": np.cov(errors[:, view].T),
                }
                for view in range(views)
            ],
            "between_views": {
                "views": shown,
                "covariance": np.block([[analytic.covariance(a, b) for b in shown] for a in shown]),
                "covariance_drawn": np.cov(some.T),
            },
        }
    )


def figures(propagation: Propagation) -> dict[str, Floats]:
    """Return the figures that describe the errors of each draw and view, (draws, views)."""
    errors, pixels = propagation.errors, propagation.pixels.astype(float)
    parts = {
        "source_mm": np.linalg.norm(errors[..., :3], axis=-1),
        "source_deg": np.degrees(np.linalg.norm(errors[..., 3:6], axis=-1)),
        "detector_mm": np.linalg.norm(errors[..., 6:9], axis=-1),
        "detector_deg": np.degrees(np.linalg.norm(errors[..., 9:], axis=-1)),
        "isocentre_px": pixels[..., 0],
    }
    if pixels.shape[-1] > 1:
        parts["region_px"] = np.sqrt((pixels[..., 1:] ** 2).mean(axis=-1))
    return parts


def summary(propagation: Propagation) -> dict[str, dict[str, float]]:
    """Return the distribution of each figure over all draws and views."""
    return {name: _spread(values.ravel()) for name, values in figures(propagation).items()}


def _spread(values: Floats) -> dict[str, float]:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    shown = {"mean": values.mean(), "std": values.std(), "p5": low, "median": middle, "p95": high}
    return {name: float(value) for name, value in (shown | {"max": values.max()}).items()}
