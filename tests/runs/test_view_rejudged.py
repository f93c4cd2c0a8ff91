"""A plan judged again under the robots' errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawn_arms import deviations

from twinct.calibration import CalibratedArms
from twinct.cli import main
from twinct.core.errors import InputError
from twinct.geometry import Pose
from twinct.robots.calibrated_arms import ArmDeviations
from twinct.robots.cell import nominal_chains
from twinct.runs.propagating import nominal_scan
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario
from twinct.view_plans.goals_with_errors import _blur_mm, rejudged
from twinct.view_plans.planner import plan_views

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
SCENARIO = f"""\
extends: {DEMO}
source: {{photons_per_mm2_mas: 1.0e+6}}
detector: {{columns: 80, rows: 60, pixel_pitch_mm: 4.0}}
cell: {{kind: gantry}}
uncertainty: {{source: {{sigma_mm: 0}}, detector: {{sigma_mm: 0}}}}
specimen:
  position_mm: [0, 0, 0]
  parts:
    - {{name: block, shape: {{kind: box, size_mm: [40, 120, 60]}}, material: water}}
task:
  views: 8
  candidates: 30
  rounds: 1
  radius_mm: 3
  completeness: {{within_deg: 6}}
  detectability: {{signal: {{kind: sphere, radius_mm: 3, contrast_rel: 0.05}}, voxel_mm: 1.5}}
"""


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rejudged")
    (folder / "block.yaml").write_text(SCENARIO)
    plan_views(folder / "block.yaml", folder / "plan")
    return folder / "plan" / "planned.yaml"


def test_without_errors_it_is_as_planned(planned: Path) -> None:
    found, blur_mm = rejudged(SimulationBuilder(load_scenario(planned)), 2)
    assert blur_mm == pytest.approx([0, 0], abs=1e-9)
    for goal in found.values():
        assert goal.drawn == pytest.approx(goal.commanded, rel=1e-6)


def test_blur_is_that_of_the_poses_and_lowers_what_is_detected(planned: Path) -> None:
    """Of panels displaced by sigma along u and v, at half the SDD: half of it, but for a shift."""
    sigma_mm, equations = 4.0, 2 * 8
    views = "{detector_in_plane_mm: 4}"
    builder = SimulationBuilder(load_scenario(planned, [f"uncertainty.views={views}"]))
    found, blur_mm = rejudged(builder, 40)
    expected = sigma_mm / 2 * np.sqrt(1 - 3 / equations)
    assert np.sqrt((blur_mm**2).mean()) == pytest.approx(expected, rel=0.1)
    d = found["detectability"]
    assert d.drawn.mean() < 0.9 * d.commanded
    assert np.ptp(d.drawn) > 0
    assert found["completeness"].drawn.mean() == pytest.approx(
        found["completeness"].commanded, rel=0.1
    )


def test_what_all_views_agree_upon_blurs_nothing(planned: Path) -> None:
    builder = SimulationBuilder(load_scenario(planned))
    scan, place = nominal_scan(builder), np.array([3.0, -2.0, 1.0])
    believed = scan.poses[:, None]
    true = believed.copy()
    true[..., :3, 3] += (0.4, -0.3, 0.5)
    assert _blur_mm(true, believed, builder.commanded, place) == pytest.approx([0], abs=2e-3)
    true[1, :, ::2, :3, 3] += 1.0
    assert _blur_mm(true, believed, builder.commanded, place) > 0.1


def test_the_command_tells_it(planned: Path, tmp_path: Path, capsys) -> None:
    words = ["uncertainty", str(planned), "--draws", "3", "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--set", "uncertainty.views={detector_in_plane_mm: 1}"])
    assert not ended.value.code
    told = capsys.readouterr().out
    assert "effect on the task: 3 scans" in told and "detectability" in told
    assert '"task"' in (tmp_path / "out" / "uncertainty.json").read_text()


ARMS = [
    "cell={kind: arms}",
    "motion={detector_roll: free, trigger: settled}",
    "trajectory={kind: arc, views: 8, longitude_range_deg: 180, centre_longitude_deg: 0}",
    "uncertainty.arms={joint_offset_deg: 0.1, link_mm: 0.5, tool_mm: 1, windup_deg: 0.05, "
    "gear_deg: 0.02}",
]


@pytest.fixture(scope="module")
def arms(planned: Path) -> tuple[Path, CalibratedArms]:
    """A scenario with arms that are not as known, and what a perfect calibration makes of them."""
    block = planned.parents[1] / "block.yaml"
    scenario = load_scenario(block, ARMS)
    source, detector = nominal_chains(scenario.cell, scenario.detector.panel)
    section = scenario.uncertainty.arms
    changes = []
    for chain, side in ((source, "source"), (detector, "detector")):
        true = deviations(scenario.uncertainty, chain, scenario.arms_seed, side)
        changes.append(ArmDeviations(*(array[0] for array in true)))
    found = CalibratedArms(
        (source, detector), tuple(changes), section.gear_periods, Pose.identity(), {}
    )
    return block, found


def test_arms_that_were_calibrated_are_believed_where_they_are(
    arms: tuple[Path, CalibratedArms], tmp_path: Path, capsys
) -> None:
    block, found = arms
    found.write(tmp_path / "arms.json")
    calibrated = f"uncertainty.calibration={tmp_path / 'arms.json'}"
    _, blur_mm = rejudged(SimulationBuilder(load_scenario(block, ARMS)), 3)
    assert blur_mm.min() > 0.1 and np.ptp(blur_mm) > 0.01  # other arms in each draw
    goals, blur_mm = rejudged(SimulationBuilder(load_scenario(block, [*ARMS, calibrated])), 3)
    assert blur_mm == pytest.approx([0, 0, 0], abs=1e-6)
    d = goals["detectability"]
    assert np.ptp(d.drawn) == pytest.approx(0, abs=1e-9)
    words = ["uncertainty", str(block), "--draws", "2"]
    with pytest.raises(SystemExit) as ended:
        main([*words, *(word for key in (*ARMS, calibrated) for word in ("--set", key))])
    assert not ended.value.code
    assert "blurred by 0.000 mm" in capsys.readouterr().out


def test_arms_of_another_cell_are_refused(
    arms: tuple[Path, CalibratedArms], tmp_path: Path
) -> None:
    block, found = arms
    found.write(tmp_path / "arms.json")
    keys = [*ARMS, f"uncertainty.calibration={tmp_path / 'arms.json'}"]
    moved = "cell.source_arm.base_position_mm=[760, 0, -150]"
    with pytest.raises(InputError, match=r"arms\.json"):
        rejudged(SimulationBuilder(load_scenario(block, [*keys, moved])), 2)
