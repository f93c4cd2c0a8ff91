"""Where scout views saw the patient, against where it was."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.core.progress import SILENT
from twinct.geometry import Pose
from twinct.runs import acquire_to_store
from twinct.scan import SimulationBuilder, local_rig
from twinct.scenario import load_scenario, parse_scenario
from twinct.view_plans.planner import plan_views
from twinct.view_plans.scout import scouted

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"

SCENARIO = f"""\
extends: {DEMO}
name: lump
source: {{photons_per_mm2_mas: 1.0e+5}}
detector: {{columns: 80, rows: 60, pixel_pitch_mm: 4.0, noise: {{kind: quantum}}}}
trajectory: {{kind: sinusoid, views: 5}}
cell: {{kind: gantry}}
uncertainty: {{source: {{sigma_mm: 0}}, detector: {{sigma_mm: 0}}}}
specimen:
  parts:
    - {{name: block, shape: {{kind: box, size_mm: [60, 80, 40]}}, material: soft_tissue}}
    - {{name: bar, shape: {{kind: box, size_mm: [10, 30, 14]}}, position_mm: [20, 10, 12],
       rotation_deg: [20, 0, 35], material: bone}}
    - {{name: ball, shape: {{kind: sphere, radius_mm: 9}}, position_mm: [-18, -25, -8],
       material: bone}}
task: {{views: 4, candidates: 20, rounds: 0, radius_mm: 3, completeness: {{within_deg: 6}}}}
"""
MOVED = [
    "specimen.position_mm=[3, -2, 4]",
    "specimen.rotation_deg=[2, -3, 5]",
]
CLOSE_MM, CLOSE_DEG = 0.6, 0.5
"""At its corners: 0.3 voxels, in five views of 2 mm pixels there; it was 5 mm and 6 deg away."""


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("lump") / "lump.yaml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def scout(file: Path) -> Path:
    """A scan of the specimen where it lies."""
    scenario = load_scenario(file, MOVED)
    store = file.parent / "scan.zarr"
    acquire_to_store(SimulationBuilder(scenario), store, local_rig, resume=False)
    return store


def test_the_specimen_is_put_where_it_lies(file: Path, scout: Path) -> None:
    found = scouted(SimulationBuilder(load_scenario(file)), scout, SILENT)
    true = Pose.from_euler((3, -2, 4), (2, -3, 5))
    corners = np.array([[30, 40, 20], [-30, 40, 20], [30, -40, -20], [20, 10, 12]])
    off = np.linalg.norm(found.world_from_specimen.apply(corners) - true.apply(corners), axis=1)
    assert off.max() < CLOSE_MM
    assert found.world_from_specimen.angle_deg(true) < CLOSE_DEG
    assert found.turned_deg == pytest.approx(true.angle_deg(Pose.identity()), abs=CLOSE_DEG)
    assert found.moved_mm == pytest.approx(np.linalg.norm([3, -2, 4]), abs=CLOSE_MM)
    again = load_scenario(file, found.overrides).specimen.world_from_specimen
    assert again.distance_mm(found.world_from_specimen) < 1e-9
    assert again.angle_deg(found.world_from_specimen) < 1e-6


def test_views_are_planned_for_where_it_lies(file: Path, scout: Path, tmp_path: Path) -> None:
    found = plan_views(file, tmp_path, scout=scout)
    written = load_scenario(tmp_path / "planned.yaml").specimen
    assert written.position_mm == pytest.approx((3, -2, 4), abs=CLOSE_MM)
    told = json.loads((tmp_path / "plan.json").read_text())["scouted"]
    assert told["views"] == 5 and told["position_mm"] == pytest.approx(written.position_mm)
    assert plan_views(file, tmp_path, scout=scout, resume=True).views == found.views


def test_scout_views_of_something_else_are_refused(file: Path, scout: Path, tmp_path: Path) -> None:
    told = load_scenario(file).model_dump(mode="json")
    told["specimen"]["parts"][0]["material"] = "titanium"
    with pytest.raises(InputError, match=r"scan\.zarr: the scan does not show the scenario's"):
        scouted(SimulationBuilder(parse_scenario(told)), scout, SILENT)
    with pytest.raises(InputError, match="nothing"):
        scouted(SimulationBuilder(load_scenario(file)), tmp_path / "nothing", SILENT)
    one = tmp_path / "one.zarr"
    scenario = load_scenario(file, ["trajectory.views=1"])
    acquire_to_store(SimulationBuilder(scenario), one, local_rig, resume=False)
    with pytest.raises(InputError, match="1 scout view, but at least 2"):
        scouted(SimulationBuilder(load_scenario(file)), one, SILENT)
