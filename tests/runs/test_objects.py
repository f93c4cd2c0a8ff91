"""Meshes and views from a program's memory: scanned, kept in the run's folder, gone on with."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

import twinct
from twinct.core.errors import InputError, ScenarioError, SpecimenError
from twinct.geometry import Panel, ScanGeometry
from twinct.runs import rewrite_report
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, load_scenario, specimen_digest, stage_digests
from twinct.trajectory import commanded_views

GANTRY = Path(__file__).parents[2] / "scenarios" / "circle_gantry.yaml"


@pytest.fixture(scope="module")
def gantry() -> Scenario:
    return load_scenario(
        GANTRY,
        {
            "trajectory.views": 6,
            "xray.engine": "mesh",
            "detector": {"columns": 16, "rows": 12, "pixel_pitch_mm": 20},
            "reconstruction": {"grid": {"voxels": 10, "voxel_mm": 16}, "iterations": 1},
        },
    )


def block(edge: float = 60.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box((edge, 50, 40))
    mesh.apply_translation((1 / 3, 0, 0))  # no number of single precision
    return mesh


def turned(views: int = 5) -> ScanGeometry:
    around = np.linspace(0.1, 2.0, views)
    out = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    side = np.stack([-np.sin(around), np.cos(around), 0 * around], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (views, 1))
    return ScanGeometry(300 * out, -300 * out, side, up, Panel(16, 12, 20.0, 20.0))


def test_a_mesh_is_a_specimen_or_a_shape(gantry: Scenario) -> None:
    scan = twinct.simulate(gantry, specimen=block())
    (part,) = SimulationBuilder(scan.scenario).specimen.parts
    np.testing.assert_array_equal(part.mesh.bounds, block().bounds)
    assert part.name == "mesh" and scan.scenario.specimen.parts[0].material == "bone"
    shaped = gantry.with_({"specimen.parts": [{"shape": block(), "material": "water"}]})
    assert shaped.specimen.parts[0].shape == scan.scenario.specimen.parts[0].shape
    again = shaped.with_({"specimen.parts.0.shape": block(30)}, seed=3)
    assert again.specimen.parts[0].material == "water"
    data = {"extends": GANTRY, "specimen": {"parts": [{"shape": block(30)}]}}
    assert load_scenario(data).specimen.parts[0].shape == again.specimen.parts[0].shape
    assert np.isfinite(twinct.evaluate(scan, twinct.reconstruct(scan)).rmse_rel)


def test_digests_depend_on_what_the_mesh_holds(gantry: Scenario) -> None:
    one, same, other = (gantry.with_(specimen=block(edge)) for edge in (60, 60, 60.0000001))
    assert one == same and stage_digests(one) == stage_digests(same)
    assert not set(stage_digests(one).values()) & set(stage_digests(other).values())
    assert specimen_digest(one) != specimen_digest(other)


def test_views_are_a_geometry_or_arrays(gantry: Scenario) -> None:
    asked = turned()
    S, D, u, v = asked.source, asked.detector, asked.u, asked.v
    panel = asked.panel
    for views in (asked, (S, D, u, v), np.hstack([S, D, u, v])):
        assert commanded_views(gantry.with_(trajectory=views).trajectory, panel) == asked
    upright = commanded_views(gantry.with_(trajectory=(S, D)).trajectory, panel)
    np.testing.assert_array_equal(upright.source, S)
    np.testing.assert_allclose(upright.u, u, atol=1e-12)
    mas = np.arange(1.0, 6.0)
    scan = twinct.simulate(GANTRY, trajectory=(S, D, mas), detector=gantry.detector.model_dump())
    np.testing.assert_array_equal(scan.mas, mas)
    np.testing.assert_array_equal(scan.geometry("executed").source, S)
    digests = {stage_digests(gantry.with_(trajectory=turned(n)))["plan"] for n in (5, 6, 6)}
    assert len(digests) == 2


def test_wrong_objects_are_refused_where_they_come_in(gantry: Scenario) -> None:
    S, D, line = turned().source, turned().detector, np.ones(5)
    for views, why in (
        ((S, D[:4]), "dimensions"),
        ((S, D, line, line), r"shape \(5, 8\) form no views: a view has 6 numbers"),
        (np.empty((0, 6)), r"shape \(0, 6\)"),
        ((S, D, 0 * line), "mAs of view 0 is not above 0"),
        ((S, np.where(np.eye(5, 3) == 1, np.nan, D)), "not finite"),
        ((S, S), "source and panel coincide"),
    ):
        with pytest.raises(ScenarioError, match=f"^trajectory: .*{why}"):
            gantry.with_(trajectory=views)
    hole = block()
    hole.update_faces(np.arange(len(hole.faces)) > 0)
    with pytest.raises(SpecimenError, match=r"^specimen: the mesh is open: 3 of"):
        twinct.simulate(gantry, specimen=hole)
    with pytest.raises(ScenarioError, match=r"^resum: unknown key"):
        twinct.run(gantry, "nowhere", resum=True)
    with pytest.raises(InputError, match="builder: it has its own scenario: change seed"):
        twinct.simulate(gantry, builder=SimulationBuilder(gantry), seed=2)


@pytest.mark.usefixtures("unreported")
def test_a_run_keeps_its_objects_and_moves_with_them(gantry: Scenario, tmp_path: Path) -> None:
    out = tmp_path / "out"
    mine = {"specimen": block(), "trajectory": turned()}
    made = twinct.run(gantry, out, link="local", **mine)
    named = made.scenario.files()
    assert set(named) == {"specimen.parts.0.shape.path", "trajectory.path"}
    assert {file.parent for file in named.values()} == {out / "inputs"}
    assert made.scan.scenario.files() == named
    scan = twinct.simulate(gantry, **mine)
    np.testing.assert_array_equal(made.scan.transmission, scan.transmission)
    before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}

    same = twinct.run(gantry, out, link="local", resume=True, **mine)
    assert same.scenario == made.scenario
    with pytest.raises(InputError, match="another scenario"):
        twinct.run(gantry, out, link="local", resume=True, **{**mine, "specimen": block(61)})
    assert {file: file.read_bytes() for file in out.rglob("*") if file.is_file()} == before

    moved = shutil.move(out, tmp_path / "moved")
    files = {file.parent for file in rewrite_report(moved).scenario.files().values()}
    assert files == {moved / "inputs"}
    twice = twinct.run(moved / "scenario.yaml", tmp_path / "twice", link="local")
    np.testing.assert_array_equal(twice.scan.transmission, scan.transmission)
    assert sorted(file.name for file in moved.glob("inputs/*")) == sorted(
        file.name for file in twice.scenario.files().values()
    )
