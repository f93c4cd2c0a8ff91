"""Covariances to first order beside what is drawn, term by term and together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twinct.geometry import Panel, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, build_cell, chains_of
from twinct.scenario import PRESETS, Cell, Detector, Uncertainty
from twinct.uncertainty import TrueCell
from twinct.uncertainty.propagation import (
    NominalScan,
    Propagation,
    draw,
    first_order,
    project,
    propagate,
)

PANEL = Panel(48, 64, 5.0, 5.0)
POINTS = [[0.0, 0.0, 0.0], [30.0, 10.0, -20.0], [-20.0, 30.0, 20.0]]
VIEWS = 3
RAIL = {"range_mm": [-900, 900]}
QUIET = {"source": {"sigma_mm": 0}, "detector": {"sigma_mm": 0}}


@pytest.fixture(scope="module")
def scan(cell: CellModel) -> NominalScan:
    """Arms held up to each other, turned a little from view to view."""
    rng = np.random.default_rng(5)
    start = np.tile([0.1, -2.0, 2.0, 0.1, 1.6, 0.2], 2)
    joints = start + np.linspace(0, 0.6, VIEWS)[:, None] * rng.uniform(-1, 1, 12)
    speeds = rng.normal(size=joints.shape) * 0.3
    return NominalScan.of_arms(chains_of(cell), joints, speeds, np.array([1.0, 5.0, 9.0]))


def section(**keys: Any) -> Uncertainty:
    return Uncertainty.model_validate({**QUIET, **keys})


def told(scan: NominalScan, draws: int, **keys: Any) -> Propagation:
    return propagate(section(**keys), scan, PANEL, POINTS, draws=draws, seed=1, arms_seed=2)


TERMS = {
    "joint offset": {"arms": {"source": {"joint_offset_deg": 0.03}}},
    "link": {"arms": {"link_mm": 0.2, "link_deg": 0.02}},
    "base": {"arms": {"base_mm": 0.2, "base_deg": 0.02}},
    "tool": {"arms": {"tool_mm": 0.2, "tool_deg": 0.02}},
    "windup": {"arms": {"windup_deg": 0.2, "windup_spread": 0.2, "detector": {"windup_deg": 0.5}}},
    "gear": {"arms": {"gear_deg": 0.02, "gear_periods": 2}},
    "drift": {"arms": {"drift_mm": 0.2, "warm_up_min": 1.0}},
    "ageing": {"arms": {"ageing_mm": 0.1, "ageing_deg": 0.01, "age_months": 6}},
    "trigger": {"arms": {"trigger_jitter_ms": 2.0}},
    "rail": {"arms": {"rail_mm": 0.2, "rail_deg": 0.02, "rail_period_mm": 700.0}},
    "encoder": {"encoder_step_deg": 0.02},
    "views": {"views": {"source_mm": 0.1, "detector_tilt_deg": 0.1, "correlation_views": 2}},
    "patient": {"patient": {"nod_mm": 3, "nod_deg": 2, "jerk_mm": 1}},
    "reported": {
        "source": {"sigma_mm": 0.1},
        "detector": {"sigma_mm": 0.1, "cutoff_mm": None, "rotation_sigma_deg": 0.05},
    },
}


@pytest.mark.parametrize("name", [name for name in TERMS if name != "rail"])
def test_a_term_spreads_as_its_covariance_says(scan: NominalScan, name: str) -> None:
    """All views and both tools at once, in units of the deviations: correlations with them."""
    found = told(scan, 4000, **TERMS[name])
    (term,) = {term.name for term in found.analytic.terms}
    assert term == name
    blocks = [[found.analytic.covariance(a, b) for b in range(VIEWS)] for a in range(VIEWS)]
    expected, drawn = np.block(blocks), np.cov(found.errors.reshape(4000, -1).T)
    deviation = np.sqrt(np.diag(expected))
    moved = deviation > 1e-9
    assert np.sqrt(np.diag(drawn))[~moved] == pytest.approx(0.0, abs=1e-6)
    scale = np.outer(deviation, deviation)[np.ix_(moved, moved)]
    off = (drawn - expected)[np.ix_(moved, moved)] / scale
    # 4000 draws: standard error 2.2 % of a variance, 1.6 % of a correlation; some 1000 numbers
    assert np.abs(off).max() < 0.1


ON_RAILS = ("joint offset", "link", "windup", "gear", "trigger", "encoder", "rail")
"""Terms that count joints, of which a rail is none that turns."""


@pytest.fixture(scope="module")
def railed() -> NominalScan:
    """Both arms on rails, one of them steep, on the move."""
    arm = {"rail": {"range_mm": [-900, 900], "axis": [0.2, 1, 0.3]}}
    section = Cell.model_validate({"source_arm": arm, "detector_arm": {"rail": RAIL}})
    chains = chains_of(build_cell(section, None, Pose.identity(), Detector().panel))
    start = np.tile([0.1, 0.1, -2.0, 2.0, 0.1, 1.6, 0.2], 2)
    rng = np.random.default_rng(5)
    joints = start + np.linspace(0, 0.6, VIEWS)[:, None] * rng.uniform(-1, 1, 14)
    speeds = rng.normal(size=joints.shape) * 0.3
    return NominalScan.of_arms(chains, joints, speeds, np.array([1.0, 5.0, 9.0]))


@pytest.mark.parametrize("name", ON_RAILS)
def test_a_term_of_an_arm_on_a_rail_spreads_as_its_covariance_says(
    railed: NominalScan, name: str
) -> None:
    test_a_term_spreads_as_its_covariance_says(railed, name)


def test_windup_of_equal_gears_is_no_spread_but_a_mean(scan: NominalScan) -> None:
    found = told(scan, 3, arms={"windup_deg": 0.2})
    assert not found.analytic.terms
    (mean,) = found.analytic.means
    # Of turns of half a degree the second order is some hundredths of a millimetre.
    assert mean.factor[:, :, 0] == pytest.approx(found.errors[0], abs=0.02)
    assert np.ptp(found.errors, axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(found.errors).max() > 0.3


def test_the_collaborative_arm_as_a_whole(scan: NominalScan) -> None:
    arms = PRESETS["collaborative"]["arms"]
    found = told(scan, 4000, arms=arms)
    expected = np.sqrt(np.diagonal(found.analytic.covariances, axis1=1, axis2=2))
    assert found.errors.std(axis=0) == pytest.approx(expected, rel=0.05)  # standard error 1.1 %
    rows = found.shares()
    assert "windup, mean" in [row["term"] for row in rows]
    assert all(float(row["region_px"]) > 0 for row in rows)
    # Alone and independent: together they are the whole of it, up to what is not linear.
    total = np.sqrt(sum(float(row["isocentre_px"]) ** 2 for row in rows))
    whole = np.sqrt((found.pixels[..., 0].astype(float) ** 2).mean())
    assert whole == pytest.approx(total, rel=0.05)


def test_the_first_draw_is_the_scan(cell: CellModel, scan: NominalScan) -> None:
    keys: dict[str, Any] = {
        "arms": {**PRESETS["collaborative"]["arms"], "trigger_jitter_ms": 0.0},
        "patient": {"nod_mm": 3.0, "nod_deg": 2.0},
    }
    asked = section(**keys)
    parts = list(draw(asked, scan, 2, 1, 2))
    assert [part for part, _ in parts] == [slice(0, VIEWS)]
    true = TrueCell(asked, 1, 2, chains_of(cell))
    stands = Pose.from_euler((1, 2, 3), (0, 0, 30))
    for view in range(VIEWS):
        at = [Pose.from_matrix(m[:3, 3], m[:3, :3]) for m in scan.poses[:, view]]
        joints = np.concatenate([own[view] for own in scan.joints])
        speeds = np.concatenate([own[view] for own in scan.speeds])
        here = PosePairs.at(*at, stands)
        real = true.at(here, view, float(scan.time_s[view]), joints, speeds)
        back = stands @ real.object[0].inverse()
        for side, pose in enumerate(real[0]):
            drawn = parts[0][1].true[side, 0, view]
            np.testing.assert_allclose((back @ pose).matrix, drawn, atol=1e-9)


def test_a_gantry_has_the_terms_of_any_machine(random_geometry: Any) -> None:
    views = random_geometry(4, PANEL, np.random.default_rng(0))
    gantry = NominalScan.of_gantry(views, np.arange(4.0))
    asked = section(preset="c_arm")
    assert {term.name for term in first_order(asked, gantry).terms} == {"views"}
    found = propagate(asked, gantry, PANEL, POINTS, draws=500, seed=1, arms_seed=1)
    expected = np.sqrt(np.diagonal(found.analytic.covariances, axis1=1, axis2=2))
    moved = expected > 0
    # 500 draws: standard error 3.2 %, of 36 numbers
    assert found.errors.std(axis=0)[moved] == pytest.approx(expected[moved], rel=0.12)
    np.testing.assert_allclose(
        project(gantry.poses[:, None], PANEL, np.array(POINTS))[0],
        views.project(POINTS),
        atol=1e-8,
    )
