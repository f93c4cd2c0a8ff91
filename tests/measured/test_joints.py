"""Joint angles of both arms become poses, through the kinematics of a scenario's cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ball_scan import COLUMNS, ROWS

from twinct.core.errors import InputError
from twinct.measured.description import read_description
from twinct.measured.views import ImageFacts
from twinct.robots.cell import nominal_chains
from twinct.scenario import load_scenario

VIEWS = 4
PANEL = {"detector.columns": COLUMNS, "detector.rows": ROWS, "detector.pixel_pitch_mm": 1.5}


@pytest.fixture
def cell(tmp_path: Path):
    """A scenario's file, its two chains, and joints with the panel in front of the source."""
    pytest.importorskip("mujoco", reason="needs the extra robots")
    path = tmp_path / "cell.yaml"
    lines = [f"extends: {Path(__file__).parents[2] / 'scenarios' / 'demo.yaml'}", "detector:"]
    lines += [f"  columns: {COLUMNS}", f"  rows: {ROWS}", "  pixel_pitch_mm: 1.5"]
    path.write_text("\n".join(lines) + "\n")
    scenario = load_scenario(path)
    chains = nominal_chains(scenario.cell, scenario.detector.panel)
    rng, kept = np.random.default_rng(3), []
    while len(kept) < VIEWS:
        joints = [rng.uniform(-2, 2, len(chain)) for chain in chains]
        source, panel = (
            chain.tools(own[None])[0] for chain, own in zip(chains, joints, strict=True)
        )
        if panel[:3, 2] @ (source[:3, 3] - panel[:3, 3]) > 0:
            kept.append((np.concatenate(joints), source, panel))
    return path, kept


def views(path: Path, table, unit: str, tmp_path: Path, rows: int = ROWS):
    np.savetxt(tmp_path / "joints.csv", table, delimiter=",", header="angles")
    section = {
        "images": {"path": "a.npy", "values": "transmissions"},
        "geometry": {
            "kind": "joints",
            "path": str(tmp_path / "joints.csv"),
            "unit": unit,
            "scenario": str(path),
        },
    }
    geometry = read_description(section).geometry
    return geometry.views(ImageFacts(VIEWS, rows, COLUMNS))


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_joints_give_the_tools_of_both_arms(unit, cell, tmp_path):
    path, kept = cell
    joints = np.array([one for one, _, _ in kept])
    found = views(path, np.degrees(joints) if unit == "deg" else joints, unit, tmp_path)
    for view, (_, source, panel) in enumerate(kept):
        np.testing.assert_allclose(found.geometry.source[view], source[:3, 3], atol=1e-6)
        np.testing.assert_allclose(found.geometry.detector[view], panel[:3, 3], atol=1e-6)
        np.testing.assert_allclose(found.geometry.u[view], panel[:3, 0], atol=1e-9)
        np.testing.assert_allclose(found.geometry.v[view], panel[:3, 1], atol=1e-9)
    assert found.geometry.panel.shape == (ROWS, COLUMNS)
    assert f"in {unit}, nominal arms of cell.yaml" in found.notes[0]


def test_wrong_tables_are_named(cell, tmp_path):
    path, kept = cell
    joints = np.array([one for one, _, _ in kept])
    with pytest.raises(InputError, match="are they in radians"):
        views(path, joints, "deg", tmp_path)
    with pytest.raises(InputError, match="are they in degrees"):
        views(path, np.degrees(joints), "rad", tmp_path)
    with pytest.raises(InputError, match="11 joints of each view, but the cell's source arm has 6"):
        views(path, joints[:, 1:], "rad", tmp_path)
    with pytest.raises(InputError, match="states 3 views, but there are 4 images"):
        views(path, joints[1:], "rad", tmp_path)
    with pytest.raises(InputError, match="20 x 26 pixels"):
        views(path, joints, "rad", tmp_path, rows=ROWS + 1)
    gantry = tmp_path / "gantry.yaml"
    gantry.write_text(f"extends: {path}\ncell: {{kind: gantry}}\n")
    with pytest.raises(InputError, match="its cell is a gantry"):
        views(gantry, joints, "rad", tmp_path)
