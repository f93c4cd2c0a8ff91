"""Views planned for a task: what is chosen, what is written, going on, and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError, ScanExistsError, ScenarioError
from twinct.geometry import Pose, VolumeGrid
from twinct.recon.volume import Volume
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario
from twinct.trajectory import CircleTrajectory, commanded_mas, commanded_views
from twinct.view_planning.objectives import Views
from twinct.view_plans import family_search, planner
from twinct.view_plans.patient import Patient
from twinct.view_plans.planner import plan_views
from twinct.workers import LocalPool
from twinct.xray.beam_shape import BeamShape
from twinct.xray.build import build_spectrum
from twinct.xray.dose import PlaceDoses

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"

SCENARIO = f"""\
extends: {DEMO}
name: block with a pin
source: {{photons_per_mm2_mas: 1.0e+6}}
detector: {{columns: 80, rows: 60, pixel_pitch_mm: 4.0}}
cell: {{kind: gantry}}
specimen:
  position_mm: [0, 0, 0]
  parts:
    - {{name: block, shape: {{kind: box, size_mm: [40, 120, 60]}}, material: water}}
    - {{name: lens, shape: {{kind: sphere, radius_mm: 4}}, position_mm: [0, 50, 0],
       material: eye_lens}}
    - {{name: pin, shape: {{kind: cylinder, radius_mm: 2, height_mm: 40}}, position_mm: [0, 12, 0],
       material: titanium}}
task:
  views: 6
  candidates: 40
  rounds: 1
  radius_mm: 3
  completeness: {{within_deg: 6}}
"""

DETECT = (
    "task.detectability={signal: {kind: sphere, radius_mm: 4, contrast_rel: 0.05}, voxel_mm: 2.5}"
)


FAMILY = [
    "trajectory={kind: circle, views: 9, centre_longitude_deg: 30}",
    "task.metal={parts: [pin], weight: 3}",
    "task.family={parameters: [{key: tilt_deg, low: 0, high: 80}, "
    "{key: tilt_axis_deg, low: -90, high: 90}], generations: 5, population: 6}",
]

COARSE = "detector={columns: 40, rows: 30, pixel_pitch_mm: 8}"
"""The same panel in fewer pixels, where many images are made."""

MONO = "source={energy_kev: 60, photons_per_mm2_mas: 1.0e+6}"

PIECES = 3
"""Of work in each generation."""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "block.yaml"
    path.write_text(SCENARIO)
    return path


def figures(folder: Path) -> dict[str, dict[str, float]]:
    return json.loads((folder / "plan.json").read_text())["goals"]


def test_what_is_written_is_what_a_run_takes(file: Path, tmp_path: Path) -> None:
    found = plan_views(file, tmp_path / "out")
    written = load_scenario(tmp_path / "out" / "planned.yaml")
    assert commanded_views(written.trajectory, written.detector.panel) == found.views
    assert len(found.views) == 6 and found.reachable == found.candidates == 40
    assert np.linalg.norm(found.views.source, axis=1) == pytest.approx(300)
    told = figures(tmp_path / "out")["completeness"]
    assert told["planned"] > told["spread_evenly"]
    assert (tmp_path / "out" / "plan.png").stat().st_size > 10_000
    assert not (tmp_path / "out" / "plan.lock").exists()


def test_arms_find_their_plan_in_a_folder_of_any_name_that_was_moved(tmp_path: Path) -> None:
    """YAML would take ' #' as a comment, and a new line as a blank."""
    out, moved = tmp_path / 'it\'s #1: "a"\nb', tmp_path / "moved"
    keys = ["detector={columns: 16, rows: 12, pixel_pitch_mm: 20}", "uncertainty={}"]
    keys += ["task={position_mm: [0, 0, 0], radius_mm: 20, views: 3, candidates: 12, rounds: 1}"]
    keys += ["task.completeness={within_deg: 10}"]
    keys += ["specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 10}}]"]
    found = plan_views(DEMO, out, keys)
    written = load_scenario(out / "planned.yaml")
    assert SimulationBuilder(written).plan is not None
    out.rename(moved)
    written = load_scenario(moved / "planned.yaml")
    assert written.motion.plan == moved / "plan.npz"
    assert commanded_views(written.trajectory, written.detector.panel) == found.views


def test_a_plan_is_explained_when_it_is_finished(file: Path, tmp_path: Path) -> None:
    metal = "task.metal={parts: [pin], weight: 1}"
    plain = plan_views(file, tmp_path / "plan", [metal])
    found = plan_views(file, tmp_path / "plan", [metal], resume=True, explain=True)
    assert plain.explained is None and found.explained is not None
    assert (found.views.source == plain.views.source).all()
    rows = (tmp_path / "plan" / "explained.csv").read_text().splitlines()
    assert rows[0].startswith("view,longitude_deg,latitude_deg,completeness added_rel,metal added")
    assert len(rows) == 1 + len(plain.views)
    x, y, z = plain.views.source[2]
    stated = [float(cell) for cell in rows[3].split(",")[1:3]]
    assert stated == pytest.approx(
        [np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))], abs=1e-3
    )
    assert found.explained.alone["metal"] <= (plain.figures["metal"]["planned"] or 0.0) + 1e-12
    written = json.loads((tmp_path / "plan" / "plan.json").read_text())
    assert written["best_alone"] == dict(found.explained.alone)
    assert (tmp_path / "plan" / "explained.png").stat().st_size > 10_000
    assert (tmp_path / "plan" / "path.png").stat().st_size > 10_000


def test_views_of_a_family_have_no_reasons_of_their_own(file: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--explain: a path of task\.family is chosen as a whole"):
        plan_views(file, tmp_path / "plan", FAMILY, explain=True)
    assert not (tmp_path / "plan").exists()


def test_detectability_takes_views_across_the_thin_side(file: Path, tmp_path: Path) -> None:
    """The block is 40 mm along x and 120 along y: beams along x have e^1.5 times the photons."""
    found = plan_views(file, tmp_path / "out", [DETECT, "task.completeness.weight=0.05"])
    x, y, _ = np.abs(found.views.source).mean(axis=0)
    assert x > 1.5 * y
    told = figures(tmp_path / "out")["detectability"]
    assert told["planned"] > 1.2 * told["spread_evenly"]


def test_what_is_achieved_is_tried(file: Path, tmp_path: Path) -> None:
    """Images are made once."""
    keys = ["reconstruction.grid={voxels: 24, voxel_mm: 4}", COARSE]
    found = plan_views(file, tmp_path / "out", keys, try_views=True)
    assert found.tried is not None and set(found.tried) == {"own_path", "spread_evenly", "planned"}
    assert all(0 < error < 1 for error in found.tried.values())
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert told["region_rmse_rel"] == dict(found.tried)
    assert (tmp_path / "out" / "tried.png").stat().st_size > 10_000
    written = (tmp_path / "out" / "tried" / "planned.zarr" / "zarr.json").stat().st_mtime_ns
    again = plan_views(file, tmp_path / "out", keys, try_views=True, resume=True)
    assert again.tried == found.tried
    assert (tmp_path / "out" / "tried" / "planned.zarr" / "zarr.json").stat().st_mtime_ns == written


def test_mas_go_where_they_tell_most(file: Path, tmp_path: Path) -> None:
    """Views across the 40 mm get more than those along the 120 mm; the sum is kept, so is dose."""
    keys = [DETECT, "task.completeness.weight=20", "task.exposure={}", "source.current_ma=2"]
    plan_views(file, tmp_path / "out", keys)
    written = load_scenario(tmp_path / "out" / "planned.yaml")
    mas, geometry = commanded_mas(written.trajectory), SimulationBuilder(written).commanded
    assert mas is not None and mas.mean() == pytest.approx(each := 0.02)
    assert mas.min() >= 0.25 * each * (1 - 1e-9) and mas.max() <= 4 * each * (1 + 1e-9)
    along_y = np.abs(geometry.source[:, 1]) / 300
    assert mas[along_y.argmin()] > mas[along_y.argmax()]
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    equal = told["exposure"]["at_equal_mas"]["detectability"]
    assert told["goals"]["detectability"]["planned"] > 1.05 * equal
    dose = [
        *keys,
        "task.dose={part: lens, photons: 2000, views: 8, voxel_mm: 4, weight: 0, at_most_rel: 0.9}",
    ]
    plan_views(file, tmp_path / "dose", dose)
    told = figures(tmp_path / "dose")
    assert told["dose"]["planned"] <= told["dose"]["at_most"] * (1 + 1e-6)


def test_metal_is_seen_past(file: Path, tmp_path: Path) -> None:
    """The pin stands 12 mm before the region along +y: views along y are left out."""
    metal = "task.metal={parts: [pin], weight: 5}"
    plan_views(file, tmp_path / "out", [metal])
    told = figures(tmp_path / "out")["metal"]
    assert told["spread_evenly"] > 0
    assert told["planned"] < 0.3 * told["spread_evenly"]


def test_metal_is_seen_across(file: Path, tmp_path: Path) -> None:
    """The pin stands upright: rays along it are 40 mm long in it, those across 4 mm at most."""
    plan_views(file, tmp_path / "out", ["task.metal={parts: [pin], weight: 5, rays: metal}"])
    told = figures(tmp_path / "out")["metal"]
    assert 2 < told["planned"] < min(4, told["spread_evenly"])


def test_dose_keeps_its_limit(file: Path, tmp_path: Path) -> None:
    dose = (
        "task.dose={part: lens, photons: 2000, views: 8, voxel_mm: 4, weight: 0, at_most_rel: 0.5}"
    )
    plan_views(file, tmp_path / "out", [dose])
    told = figures(tmp_path / "out")["dose"]
    assert 0 < told["planned"] <= 0.5 * told["spread_evenly"] * (1 + 1e-6)


def test_what_few_views_tell_counts(file: Path, tmp_path: Path) -> None:
    """Views along the 120 mm of the block tell less of its middle than those across."""
    keys = ["task.completeness=null", "task.known={voxels: 200}", "task.views=3"]
    keys += ["source.photons_per_mm2_mas=30"]  # few enough that what lies before the region counts
    found = plan_views(file, tmp_path / "out", keys)
    told = figures(tmp_path / "out")["known"]
    assert 1 > told["planned"] > 1.05 * told["spread_evenly"] > 0
    x, y, _ = np.abs(found.views.source).mean(axis=0)
    assert x > y
    with pytest.raises(InputError, match=r"task\.known\.voxels: 5000 need .* GB for 46 views"):
        plan_views(file, tmp_path / "big", ["task.known={voxels: 5000}", "detector.columns=2000"])


def test_the_best_path_of_a_family_looks_past_metal(file: Path, tmp_path: Path) -> None:
    """A circle about x, steep enough, sees past the pin, which ends 59 deg above the region."""
    found = plan_views(file, tmp_path / "out", FAMILY)
    told = figures(tmp_path / "out")["metal"]
    assert told["own_path"] > 0
    assert told["planned"] < 0.5 * told["own_path"]
    written = load_scenario(tmp_path / "out" / "planned.yaml")
    assert isinstance(written.trajectory, CircleTrajectory)
    assert commanded_views(written.trajectory, written.detector.panel) == found.views
    parameters = json.loads((tmp_path / "out" / "plan.json").read_text())["parameters"]
    assert written.trajectory.tilt_deg == parameters["tilt_deg"] > 10
    assert len(found.views) == 6


@pytest.mark.parametrize("counts", ["length", "shift", "starved"])
def test_metal_is_avoided_whatever_counts_of_it(file: Path, tmp_path: Path, counts: str) -> None:
    """Of the pin as a scout's volume shows it, too: the prior has none there."""
    tube = "source={spectrum: {kind: tube, kvp: 100}, photons_per_mm2_mas: null}"
    metal = f"weight: 5, counts: {counts}, least_photons: 3.0e+4"
    plan_views(file, tmp_path / "mesh", [tube, f"task.metal={{parts: [pin], {metal}}}"])
    told = figures(tmp_path / "mesh")["metal"]
    assert told["planned"] < 0.7 * told["spread_evenly"]
    grid = VolumeGrid((48, 48, 48), 1.0, Pose.from_euler((0, 12, 0), (0, 0, 0)))
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    there = (x * x + y * y < 4) & (abs(z) < 20)
    Volume(np.where(there, 0.2, 0.02).astype(np.float32), grid).write(tmp_path / "scout.nii")
    seen = f"seen: {{path: {tmp_path / 'scout.nii'}}}"
    keys = [tube, "specimen.parts.2.material=water", f"task.metal={{{seen}, {metal}}}"]
    plan_views(file, tmp_path / "seen", keys)
    found = figures(tmp_path / "seen")["metal"]
    assert found["planned"] < 0.7 * found["spread_evenly"]
    if counts != "starved":  # which are two or six rays of 78 there
        assert found["spread_evenly"] == pytest.approx(told["spread_evenly"], rel=0.3)


@pytest.mark.tutorial
def test_paths_are_tried(file: Path, tmp_path: Path) -> None:
    """Six views of a circle about z see no z in the block; a tilted circle's volume is better."""
    grid = "reconstruction={algorithm: sart, iterations: 3, grid: {voxels: 24, voxel_mm: 6}}"
    family = FAMILY[2].replace("5, population: 6", "2, population: 4")
    keys = [FAMILY[0], family, grid, "task.completeness=null", "task.trying={}", COARSE]
    found = plan_views(file, tmp_path / "out", keys)
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    errors = told["trying"]
    assert 0 < errors["planned"] < errors["own_path"]
    assert told["worth"][-1] == pytest.approx(-errors["planned"] / errors["spread_evenly"])
    assert found.figures["error in the region"] == errors
    assert plan_views(file, tmp_path / "out", keys, resume=True).views == found.views


def test_a_search_in_a_family_goes_on_where_it_was_stopped(
    file: Path, tmp_path: Path, monkeypatch
) -> None:
    whole = plan_views(file, tmp_path / "whole", FAMILY)
    judged, calls = family_search._judged, []

    def stopped(*args):
        calls.append(1)
        if len(calls) == 2 * PIECES + 1:
            raise KeyboardInterrupt
        return judged(*args)

    monkeypatch.setattr(family_search, "_judged", stopped)
    with pytest.raises(KeyboardInterrupt):
        plan_views(file, tmp_path / "out", FAMILY)
    assert plan_views(file, tmp_path / "out", FAMILY, resume=True).views == whole.views
    assert len(calls) == 5 * PIECES + 1  # two generations are not judged again


def test_paths_that_cannot_be_had_are_told_with_the_nearest(file: Path, tmp_path: Path) -> None:
    dose = "task.dose={part: lens, photons: 2000, views: 8, voxel_mm: 4, at_most_rel: 0.01}"
    with pytest.raises(InputError, match=r"nearest, with tilt_deg .*, has dose = .*, at most"):
        plan_views(file, tmp_path / "out", [*FAMILY, dose])


def test_doses_between_simulated_views_are_those_of_the_views(file: Path) -> None:
    """Interpolated doses of the block, against views that are simulated themselves, and again."""
    builder = SimulationBuilder(load_scenario(file))
    path = commanded_views(builder.scenario.trajectory, builder.scenario.detector.panel)[::10]
    views, patient = Views(path, range(len(path)), np.zeros((1, 3))), Patient(builder)
    keys = {"photons": 20_000, "voxel_mm": 5.0, "key": "task.dose"}
    found = patient.doses(views, "block", simulated=40, **keys)
    spectrum = build_spectrum(builder.scenario.source)
    places = PlaceDoses(builder.specimen, BeamShape(spectrum), ["block"], 5.0, "voxel_mm")
    scattered, errors = places.scattered(path, 80_000, seed=3)
    unscattered = builder.scenario.source.mas * places.unscattered(path)[:, 0]
    own = unscattered + builder.scenario.source.mas * scattered[:, 0]
    assert (errors[:, 0] / scattered[:, 0]).max() < 0.03
    assert (found / own).std() < 0.04
    assert found.mean() == pytest.approx(own.mean(), rel=0.02)
    assert (found / unscattered > 1.2).all()
    assert (own.max() - own.min()) / own.mean() > 0.15  # what a constant would miss
    np.testing.assert_array_equal(patient.doses(views, "block", simulated=40, **keys), found)


def test_points_of_a_part_lie_in_it(file: Path) -> None:
    patient = Patient(SimulationBuilder(load_scenario(file, ["specimen.position_mm=[0, 0, 7]"])))
    points = patient.points_of("lens")
    assert len(points) > 50
    assert np.linalg.norm(points - [0, 50, 7], axis=1).max() < 4.5
    assert points.mean(axis=0) == pytest.approx([0, 50, 7], abs=0.2)


def test_it_goes_on_where_it_was_stopped(file: Path, tmp_path: Path, monkeypatch) -> None:
    whole = plan_views(file, tmp_path / "whole")
    search = planner.search_views

    def stopped(*args, heard, **options):
        def some(state):
            heard(state)
            if len(state.worth) == 4:
                raise KeyboardInterrupt

        return search(*args, heard=some, **options)

    monkeypatch.setattr(planner, "search_views", stopped)
    with pytest.raises(KeyboardInterrupt):
        plan_views(file, tmp_path / "out")
    monkeypatch.undo()
    with pytest.raises(ScanExistsError, match="continue it with --resume"):
        plan_views(file, tmp_path / "out")
    with pytest.raises(ScanExistsError, match="search of another scenario"):
        plan_views(file, tmp_path / "out", ["task.radius_mm=4"], resume=True)
    assert plan_views(file, tmp_path / "out", resume=True).views == whole.views


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("task.dose={part: eye}", r"task\.dose\.part: unknown part 'eye'; the parts are 'block'"),
        ("task.metal={parts: [pin, nail]}", r"task\.metal\.parts\.1: unknown part 'nail'"),
        ("task.candidates=5", r"task\.views \(6\) must be at most task\.candidates \(5\)"),
        ("task.completeness=null", "completeness, detectability or known is required"),
        ("task.trying={}", r"task\.trying: this goal needs task\.family, .* tries whole paths"),
        ("task.metal={parts: []}", r"task\.metal: give either parts .* or seen"),
        (FAMILY[2].replace("80", "0"), r"parameters\.0: low \(0\) must be below high \(0\)"),
        (FAMILY[2].replace("tilt_axis_deg", "tilt_deg"), r"'tilt_deg' is listed twice"),
    ],
)
def test_what_does_not_go_together_is_told_by_its_key(file: Path, override, said) -> None:
    with pytest.raises(ScenarioError, match=said):
        load_scenario(file, [override])


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["task=null"], "the section task is missing"),
        (["task.position_mm=[0, 400, 0]"], r"no reachable view sees the region at \(0, 400, 0\)"),
        (
            ["task.dose={part: lens, photons: 2000, views: 8, voxel_mm: 4, at_most_rel: 0.01}"],
            "at most .* is allowed, but the 6 candid",
        ),
        (["source.photons_per_mm2_mas=null", DETECT], "needs a photon number"),
        (
            ["task.metal={parts: [pin], counts: shift}", MONO],
            r"metal\.counts: shift: a single energy",
        ),
        ([f"task.metal={{seen: {{path: {DEMO}}}}}"], r"demo\.yaml"),
        (
            [*FAMILY, "trajectory={kind: uniform, views: 9}"],
            r"has no numeric key 'tilt_deg'; choose from so",
        ),
        (
            [
                *FAMILY[:1],
                FAMILY[2].replace("tilt_deg, low: 0, high: 80", "sod_mm, low: 9, high: 700"),
            ],
            r"parameters\.0\.high: .*sdd_mm \(600\) must exceed sod_mm \(700\)",
        ),
        (["trajectory={kind: file, path: views.csv}"], r"trajectory\.kind: file: candidates need"),
    ],
)
def test_what_cannot_be_planned_is_told(
    file: Path, tmp_path: Path, monkeypatch, overrides, said
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "views.csv").write_text("300,0,0,-300,0,0\n")
    with pytest.raises(InputError, match=said):
        plan_views(file, tmp_path / "out", overrides)


def test_arms_that_reach_too_little_say_how_much(file: Path, tmp_path: Path) -> None:
    # The source arm stands too far away.
    overrides = [
        *("cell={kind: arms}", "task.candidates=12"),
        "cell.source_arm.base_position_mm=[2500, 0, -400]",
    ]
    with pytest.raises(
        InputError, match=r"task\.views: 6 views are requested, but the arms reach only 0 of"
    ):
        plan_views(file, tmp_path / "out", overrides)


@pytest.mark.tutorial
@pytest.mark.process
def test_other_processes_find_the_same(file: Path, tmp_path: Path) -> None:
    arms = ["cell={kind: arms}", "motion={detector_roll: free}", "task.candidates=16"]
    arc = "trajectory={kind: arc, views: 9, longitude_range_deg: 120, centre_longitude_deg: 0}"
    family = FAMILY[2].replace("80", "20").replace("5, population: 6", "2, population: 5")
    keys = [*arms, arc, FAMILY[1], family]
    alone = plan_views(file, tmp_path / "alone", keys)
    with LocalPool(tmp_path / "work", workers=2) as pool:
        shared = plan_views(file, tmp_path / "shared", keys, pool=pool)
    assert shared.views == alone.views
    assert shared.reachable == alone.reachable
    assert shared.figures == alone.figures
    assert list((tmp_path / "work" / "logs").iterdir())
