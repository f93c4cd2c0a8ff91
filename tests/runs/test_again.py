"""A scan asked again: what is beside a run is what a fresh run would give, and nothing is mixed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twinct import load_scan, reconstruct, run
from twinct.core.errors import InputError, ScanExistsError
from twinct.recon.algorithms import algorithms
from twinct.runs import Run, derive_geometry, reconstruct_run, rewrite_report, verify
from twinct.runs.reconstruction_folder import StoredReconstruction
from twinct.runs.stages import volume_made_from
from twinct.scan import NamedGeometry
from twinct.scenario import SECTIONS, Scenario, load_scenario
from twinct.uncertainty import believed_poses

AFFINE_MM = 1e-5
"""NIfTI holds a volume's affine in single precision."""

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"


@pytest.fixture
def folder(finished: Run, tmp_path: Path) -> Path:
    return shutil.copytree(finished.paths.path, tmp_path / "out")


def test_another_reconstruction_stands_beside_the_first_and_in_the_report(
    folder: Path, finished: Run
) -> None:
    before = (folder / "volume.nii").read_bytes()
    keys = ["reconstruction.algorithm=cgls", "reconstruction.grid={voxels: 12, voxel_mm: 12}"]
    made = reconstruct_run(folder, keys, geometry="executed")
    assert (made.name, made.geometry) == ("cgls-executed", "executed")
    assert (folder / "volume.nii").read_bytes() == before
    assert not (folder / "checkpoints").exists()
    grid = {"voxels": 12, "voxel_mm": 12}
    fresh = reconstruct(finished.scan, algorithm="cgls", geometry="executed", grid=grid)
    np.testing.assert_array_equal(made.volume.array, fresh.array)
    np.testing.assert_allclose(made.volume.grid.affine, fresh.grid.affine, atol=1e-6)
    figures = json.loads((folder / "metrics.json").read_text())
    assert figures["image"] == finished.figures["image"]
    told = figures["reconstructions"]["cgls-executed"]
    assert told["image"]["rmse_rel"] == pytest.approx(made.figures.rmse_rel)
    page = (folder / "report.html").read_text()
    assert "<b>cgls-executed</b>" in page and page.count("Cross-sections of") == 2
    assert verify(folder).problems == ()
    whole = (made.path / "volume.nii").read_bytes()
    (made.path / "volume.nii").write_bytes(whole[:-1] + b"?")
    assert "the file written for cgls-executed" in verify(folder).problems[0]
    (made.path / "volume.nii").write_bytes(whole)
    # The very same is not made twice, another must have another name.
    again = reconstruct_run(folder, keys, geometry="executed")
    assert (again.name, again.digest, again.seconds) == (made.name, made.digest, made.seconds)
    with pytest.raises(ScanExistsError, match="cgls-executed is another reconstruction"):
        reconstruct_run(folder, geometry="executed", name="cgls-executed")


def test_a_report_that_was_interrupted_is_completed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    keys = ["reconstruction.algorithm=cgls"]
    with monkeypatch.context() as patch:
        patch.setattr("twinct.runs.reconstruction.rewrite_report", interrupted)
        with pytest.raises(KeyboardInterrupt) as stop:
            reconstruct_run(folder, keys)
    (told,) = stop.value.__notes__
    assert told == f"{folder}/reconstructions/cgls is kept; the same command completes the report"
    made = (folder / "reconstructions/cgls/volume.nii").stat().st_mtime_ns
    reconstruct_run(folder, keys)
    assert json.loads((folder / "metrics.json").read_text())["reconstructions"]["cgls"]
    assert "<b>cgls</b>" in (folder / "report.html").read_text()
    assert (folder / "reconstructions/cgls/volume.nii").stat().st_mtime_ns == made


STOPPING = ["reconstruction.stop=auto", "reconstruction.iterations=20"]


def test_passes_that_another_reconstruction_made_are_told(folder: Path) -> None:
    made = reconstruct_run(folder, STOPPING, geometry="executed", name="stopped")
    passes = made.results["passes"]
    assert 1 <= passes < 20 and len(made.residuals) == passes
    assert made.description.partition("stop auto: ")[2].split()[0] == str(passes)
    assert StoredReconstruction.read(made.path).results == made.results
    figures = json.loads((folder / "metrics.json").read_text())
    assert figures["reconstructions"]["stopped"]["passes"] == passes
    assert "passes" not in figures
    assert f"{made.description}, executed geometry" in (folder / "report.html").read_text()
    log = (folder / "twinct.log").read_text()
    assert "reconstruction stopped: " in log and f"the volume took {passes} passes" in log


def test_a_run_that_stops_by_itself_tells_of_its_passes(
    folder: Path, tiny: Callable[..., Scenario]
) -> None:
    run(tiny(*STOPPING), folder, link="local", resume=True)
    for _ in range(2):
        figures = json.loads((folder / "metrics.json").read_text())
        assert 1 <= figures["passes"] == len(figures["residuals"]["believed"]) < 20
        assert f"stop auto: {figures['passes']} pass" in (folder / "report.html").read_text()
        rewrite_report(folder)


def test_implants_that_another_reconstruction_knew_are_kept(folder: Path) -> None:
    keys = ["reconstruction.iterations=1"]
    made = reconstruct_run(folder, keys, geometry="executed", name="one")
    assert not made.results.keys() - {"unexplained", "diagnosis", "warnings"}
    screw = {"name": "screw", "position_mm": [1.0, 2.0, 3.0]}
    other = {"name": "two", "path": made.path.with_name("two")}
    known = replace(made, **other, results={"implants": [screw]})
    known.keep(made.volume)
    assert StoredReconstruction.read(known.path).results == {"implants": [screw]}
    # Those of before have it beside the rest, or nothing of it.
    told = json.loads((known.path / "reconstruction.json").read_text())
    del told["found"]
    for before, found in (
        ({"implants": [screw], "passes": None}, {"implants": [screw]}),
        ({"implants": [], "passes": 3}, {"passes": 3}),
        ({}, {}),
    ):
        (known.path / "reconstruction.json").write_text(json.dumps(told | before))
        assert StoredReconstruction.read(known.path).results == found


@pytest.mark.tutorial
def test_a_zoom_is_free_of_what_lies_around_it(folder: Path) -> None:
    zoom = "reconstruction.zoom={centre_mm: [0, 0, 20], size_mm: 60, voxel_mm: 4}"
    near = reconstruct_run(folder, ["reconstruction.iterations=5", zoom], name="near")
    np.testing.assert_allclose(near.volume.grid.voxel, 4)
    alone = "reconstruction.grid={centre_mm: [0, 0, 20], voxels: 15, voxel_mm: 4}"
    bare = reconstruct_run(folder, ["reconstruction.iterations=5", alone], name="bare")
    assert near.figures.rmse_rel < 0.5 * bare.figures.rmse_rel


def test_a_run_goes_on_with_a_geometry_that_was_derived_from_its_scan(
    folder: Path, finished: Run
) -> None:
    scenario = finished.scenario
    section = scenario.reconstruction.model_copy(update={"geometry": ("executed", "calibrated")})
    other = scenario.model_copy(update={"reconstruction": section})
    with pytest.raises(InputError, match="'calibrated'; choose from commanded, executed, believed"):
        run(other, folder, link="local", resume=True)
    derive_geometry(folder, "calibrated", ["uncertainty.seed=7"])
    again = run(other, folder, link="local", resume=True)
    assert set(again.figures["image_by_geometry"]) == {"executed", "calibrated"}
    told = again.figures["geometries"]["calibrated"]
    assert told["made_by"]["seed"] == 7
    assert 0 < told["pose_error"]["source"]["position_mm"]["mean"] < 0.3
    assert "<th>calibrated</th>" in again.paths.report.read_text()
    # Another geometry of this name is another result.
    (folder / "geometries" / "calibrated.json").unlink()
    derive_geometry(folder, "calibrated", ["uncertainty.seed=8"])
    assert volume_made_from(again.paths) != again.paths.volume_digest(other)


def test_a_geometry_of_another_scan_is_refused(folder: Path) -> None:
    derive_geometry(folder, "calibrated", ["uncertainty.seed=7"])
    file = folder / "geometries" / "calibrated.json"
    found = NamedGeometry.read(file)
    NamedGeometry("other", found.poses, {**found.made_by, "executed": "0" * 64}).write(file.parent)
    with pytest.raises(InputError, match="'other' was derived from another scan: it has 10 views"):
        load_scan(folder)


def test_ten_reports_of_the_poses_need_one_scan(folder: Path, finished: Run) -> None:
    images = {p: p.stat().st_mtime_ns for p in (folder / "scan.zarr").rglob("*")}
    for seed in range(10):
        derive_geometry(folder, f"seed{seed}", [f"uncertainty.seed={seed}"])
    scan = load_scan(folder)
    for seed in (0, 9):
        found = scan.poses(f"seed{seed}")
        for view in range(len(scan)):
            noise = scan.scenario.uncertainty
            assert found[view] == believed_poses(*scan.executed[view], noise, seed, view)
    assert len({geometry.digest for geometry in scan.derived.values()}) == 10  # seed 1 is the run's
    assert {p: p.stat().st_mtime_ns for p in (folder / "scan.zarr").rglob("*")} == images
    volume = reconstruct(scan, geometry="seed3", iterations=1)
    other = reconstruct(scan, geometry="seed4", iterations=1)
    assert np.abs(volume.array - other.array).max() > 0


@pytest.mark.parametrize(
    ("overrides", "options", "said"),
    [
        ([], {"geometry": "xyz"}, "'xyz'; choose from commanded, executed, believed"),
        (["detector.columns=9"], {}, "only keys of reconstruction"),
        ([], {"name": "../up"}, "use at most 64 letters"),
        (["reconstruction.relaxation=7"], {}, "relaxation"),
    ],
)
def test_what_cannot_be_asked_is_said_and_nothing_is_written(
    finished: Run, overrides: list[str], options: dict[str, str], said: str
) -> None:
    folder = finished.paths.path
    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError, match=said):
        reconstruct_run(folder, overrides, **options)
    assert sorted(folder.rglob("*")) == before


def test_where_there_is_no_run_it_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a run folder"):
        reconstruct_run(tmp_path)
    with pytest.raises(InputError, match="not a run folder"):
        load_scan(tmp_path)
    with pytest.raises(InputError, match="not a reconstruction of a run"):
        StoredReconstruction.read(tmp_path)


def test_a_geometry_that_was_changed_is_refused(finished: Run, folder: Path) -> None:
    file = folder / "geometries" / "believed.json"
    whole = NamedGeometry.read(file)
    assert whole.poses.source == finished.scan.believed.source
    (file.parent / ".believed.json.partial.json").write_text("{")  # of a killed write
    assert list(load_scan(folder).derived) == ["believed"]
    told = json.loads(file.read_text())
    told["source"][3][0] += 1e-9
    file.write_text(json.dumps(told))
    with pytest.raises(InputError, match="digest"):
        load_scan(folder)
    file.write_text(file.read_text()[:50])
    with pytest.raises(InputError, match="not a geometry"):
        load_scan(folder)


def test_names_of_a_scan_cannot_be_taken(finished: Run) -> None:
    for name, said in (("executed", "every scan already has"), ("a/b", "use at most 64 letters")):
        with pytest.raises(InputError, match=said):
            derive_geometry(finished.paths.path, name)


def test_a_run_has_three_geometries(tiny, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'believd'; choose from commanded, executed, believed"):
        run(tiny("reconstruction.geometry=believd"), tmp_path / "out", link="local")
    assert not (tmp_path / "out").exists()


@pytest.mark.tutorial
@pytest.mark.usefixtures("unreported")
def test_each_algorithm_gives_the_volume_of_a_fresh_run(
    tiny_keys: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    circle = ["cell={kind: gantry}", "trajectory={kind: circle, views: 12}"]  # as fdk needs it
    asked = run(load_scenario(DEMO, [*tiny_keys, *circle]), tmp_path / "asked", link="local")
    monkeypatch.setattr("twinct.runs.reconstruction.rewrite_report", lambda *_: None)
    names = sorted(algorithms())
    assert len(names) >= 7
    for name in names:
        section = f"algorithm: {name}, geometry: believed, "
        section += "grid: {voxels: [10, 12, 14], voxel_mm: 9}"
        if "iterations" in SECTIONS[name].model_fields:
            section += ", iterations: 3"
        if name == "prior_tv":
            section += f", prior: {{path: {asked.paths.volume}}}"
        more = [f"reconstruction={{{section}}}"]
        fresh = load_scenario(DEMO, [*tiny_keys[:4], *circle, *more])
        out = tmp_path / name
        shutil.copytree(asked.paths.scan, out / "scan.zarr")
        wanted = run(fresh, out, link="local", resume=True).volume
        made = reconstruct_run(asked.paths.path, more).volume
        np.testing.assert_array_equal(made.array, wanted.array, err_msg=name)
        grid = fresh.reconstruction.grid.volume_grid
        assert made.grid.shape == grid.shape
        np.testing.assert_allclose(made.grid.affine, grid.affine, atol=AFFINE_MM)


def test_a_reconstruction_that_cannot_be_written_leaves_no_draft(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = reconstruct_run(folder, ["reconstruction.iterations=1"], name="whole")

    def fail(*_: object) -> None:
        raise OSError("no space")

    monkeypatch.setattr("twinct.runs.reconstruction_folder.write_json", fail)
    before = sorted(made.path.parent.iterdir())
    with pytest.raises(OSError, match="no space"):
        replace(made, path=made.path.with_name("next")).keep(made.volume)
    assert sorted(made.path.parent.iterdir()) == before
