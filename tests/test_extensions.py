"""What other distributions offer is found in every process; what is broken stops nobody else."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import nibabel
import numpy as np
import pytest
from shell import Shell

from twinct.core.extensions import Registry
from twinct.core.settings import Section
from twinct.specimen import material
from twinct.view_planning import task as task_section
from twinct.view_planning.objectives import LessIsBetter, Mean, Objective
from twinct.view_planning.objectives.registry import BUILT_IN

HERE = Path(__file__).parent
GROUP = "twinct.tests"
POLYGON = 0.01
"""A ring of 96 by 48 flat faces has 0.4 % less volume; voxels add little."""


@dataclass(frozen=True)
class Thing:
    name: str


def distribution(folder: Path, name: str, version: str, points: str, code: str = "") -> None:
    """As an installer leaves it: a module of the same name, and what it offers."""
    info = folder / f"{name}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(points)
    (folder / f"{name}.py").write_text(code)


def of(monkeypatch: pytest.MonkeyPatch, folder: Path, *entries: str, name: str = "things") -> None:
    code = "import kind\nA, B, OTHER, TEXT = kind.Thing('a'), kind.Thing('b'), kind.Thing('c'), 'b'"
    distribution(folder, name, "1.0", "\n".join([f"[{GROUP}]", *entries]), code)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setitem(sys.modules, "kind", sys.modules[__name__])
    monkeypatch.delitem(sys.modules, name, raising=False)


def test_a_good_one_is_found_beside_the_built_in_ones(monkeypatch, tmp_path: Path) -> None:
    of(monkeypatch, tmp_path, "b = things:B")
    found = Registry(GROUP, Thing, {"a": Thing("a")})
    assert dict(found) == {"a": Thing("a"), "b": Thing("b")}
    assert not found.broken


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ("b = things_that_are_not:B", "ModuleNotFoundError: No module named"),
        ("b = things:NOTHING", "AttributeError"),
        ("b = things:TEXT", "TypeError: it points to str, not to Thing"),
        ("b = things:OTHER", "ValueError: its own name is 'c'"),
    ],
)
def test_a_broken_one_is_logged_with_its_distribution_and_left_out(
    monkeypatch, caplog, tmp_path: Path, entry: str, reason: str
) -> None:
    of(monkeypatch, tmp_path, entry, "d = things:B", "e = things:A")
    found = Registry(GROUP, Thing, {"a": Thing("a")})
    assert set(found) == {"a"}
    assert f"'b' of things 1.0 cannot be used: {reason}" in found.broken["b"]
    assert found.broken["b"] in caplog.text


def test_names_that_are_taken_are_refused(monkeypatch, caplog, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    of(monkeypatch, tmp_path / "one", "a = things:A", "b = things:B")
    of(monkeypatch, tmp_path / "two", "b = others:B", name="others")
    built_in = Thing("a")
    found = Registry(GROUP, Thing, {"a": built_in})
    assert dict(found) == {"a": built_in} and found["a"] is built_in
    assert "several packages offer this name: others 1.0, things 1.0" in found.broken["b"]
    # Whoever names the built-in one gets it.
    assert "a" not in found.broken
    reason = "'a' of things 1.0 cannot be used: ValueError: this name is built"
    assert reason in caplog.text
    caplog.clear()
    assert not Registry(GROUP, Thing, {}, taken={"a"}) and reason in caplog.text


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny distribution, and one that is broken, in a folder for PYTHONPATH."""
    source, target = (tmp_path_factory.mktemp(name) for name in ("source", "target"))
    shutil.copytree(HERE / "extension", source, dirs_exist_ok=True)
    command = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-build-isolation"]
    subprocess.run(
        [*command, "--no-index", "--quiet", "--target", target, source],
        check=True,
        env={**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1"},
    )
    points = "[twinct.algorithms]\nhopeless = hopeless:IT\nsart = hopeless:IT\n"
    points += "[twinct.trajectories]\nnowhere = hopeless:IT\n"
    points += "[twinct.objectives]\nworst = hopeless:IT\n"
    points += "[twinct.exports]\nuseless = hopeless:IT\n"
    points += "[twinct.figures]\nhidden = hopeless:IT\nmtf = hopeless:IT\n"
    points += "[twinct.parts]\nghost = hopeless:IT\nsphere = hopeless:IT\n"
    points += "[twinct.xray_engines]\ndark = hopeless:IT\n"
    points += "[twinct.errors]\nwobble = hopeless:IT\n"
    points += "[twinct.arms]\nlame = hopeless:IT\nur10e = hopeless:IT\n"
    distribution(target, "hopeless", "0.3", points, "raise OSError('its library is gone')\n")
    return target


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    np.save(tmp_path / "start.npy", np.full((28, 26, 24), 1e-3, np.float32))
    file = tmp_path / "mine.yaml"
    file.write_text(
        f"extends: {HERE}/same_bytes/small.yaml\n"
        "trajectory: {kind: zigzag, views: 3}\n"
        "reconstruction: {algorithm: landweber, path: start.npy}\n"
        "xray: {engine: mesh}\n"
    )
    return file


@pytest.fixture
def twinct(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    """Commands of a process that finds both distributions."""
    with Shell(tmp_path_factory.mktemp("streams"), installed) as shell:
        yield shell


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.ros
def test_a_foreign_scenario_is_checked_and_run(twinct: Shell, scenario: Path) -> None:
    checked = twinct("check", scenario)
    assert checked.returncode == 0, checked.stderr
    assert "landweber" in checked.stdout and "zigzag" in checked.stdout
    assert "'hopeless' of hopeless 0.3 cannot be used: OSError: its library is gone" in (
        checked.stderr
    )
    # Over ROS 2 its nodes find it, too.
    out = scenario.parent / "out"
    done = twinct("run", scenario, "--out", out, "--link", "ros2")
    assert done.returncode == 0, done.stderr
    exported = twinct("export", out, "--to", "plugin")
    assert exported.returncode == 0, exported.stderr
    assert (out / "export-plugin" / "scan.npz").is_file()
    refused = twinct("export", out, "--to", "useless")
    assert refused.returncode == 2
    assert "--to useless: 'useless' of hopeless 0.3 cannot be used: OSError" in refused.stderr
    schema = json.loads(twinct("schema").stdout)
    assert "LandweberReconstruction" in schema["$defs"] and "Zigzag" in schema["$defs"]


@pytest.fixture
def task(tmp_path: Path) -> Path:
    file = tmp_path / "level.yaml"
    file.write_text(
        f"extends: {HERE}/same_bytes/small.yaml\n"
        "cell: {kind: gantry}\n"
        "task:\n"
        "  {views: 3, candidates: 24, rounds: 1, radius_mm: 3,\n"
        "   completeness: {weight: 0.01}, level: {free_deg: 2}}\n"
    )
    return file


@pytest.mark.tutorial
@pytest.mark.process
def test_views_are_planned_for_a_foreign_objective(twinct: Shell, task: Path) -> None:
    checked = twinct("check", task)
    assert checked.returncode == 0, checked.stderr
    planned = twinct("plan", task, "--out", task.parent / "out", "--jobs", "1")
    assert planned.returncode == 0, planned.stderr
    assert "level, deg" in planned.stdout
    told = json.loads((task.parent / "out" / "plan.json").read_text())["goals"]
    assert told["level"]["weight"] == -1.0
    assert told["level"]["planned"] < 0.5 * told["level"]["spread_evenly"]
    alone = twinct("check", task, "--set", "task.completeness=null")
    assert alone.returncode == 2
    assert "metal, dose, moving and level alone would choose the same view" in alone.stderr


@pytest.mark.tutorial
@pytest.mark.process
def test_who_names_a_broken_objective_is_told_why(twinct: Shell, task: Path) -> None:
    refused = twinct("check", task, "--set", "task.worst={}")
    assert refused.returncode == 2
    assert "--set task.worst={}: task.worst: 'worst' of hopeless 0.3 cannot be used: " in (
        refused.stderr
    )


@pytest.mark.parametrize(
    ("name", "settings", "reason"),
    [
        ("goals", LessIsBetter, "the section task has another key of this name"),
        ("views", LessIsBetter, "the section task has another key of this name"),
        ("new", Section, "its settings are neither MoreIsBetter nor LessIsBetter"),
    ],
)
def test_an_objective_that_does_not_fit_the_task_is_left_out(
    monkeypatch, name: str, settings: type, reason: str
) -> None:
    odd = Objective(name, settings, lambda own, views, patient: Mean([0.0]), "Odd.")
    monkeypatch.setattr(
        task_section,
        "objectives",
        lambda: Registry("twinct.none", Objective, {**BUILT_IN, name: odd}),
    )
    usable = task_section.usable_objectives.__wrapped__()
    assert list(usable) == list(BUILT_IN)
    assert usable.broken == {name: f"the objective {name!r} cannot be used: {reason}"}


def test_the_page_includes_the_files_that_are_tested() -> None:
    page = HERE.parent / "docs" / "howto" / "extensions.md"
    text = page.read_text(encoding="utf-8")
    found = re.findall(
        r"^```{literalinclude} (\S+)\n(?::start-at: (.*)\n)?```$", text, re.MULTILINE
    )
    assert len(found) == text.count("literalinclude")
    for file, start in found:
        code = (page.parent / file).resolve()
        assert code.parent == HERE / "extension" / "twinct_tiny"
        assert start in code.read_text(encoding="utf-8")


STUDY = """\
scenario: {file}
search:
  figure: image.tails.middle.tail_rel
  trials: 2
  batch: 2
  keys: [{{label: share, key: evaluation.tails.0.share, low: 0.01, high: 0.5}}]
figures: [image.tails.middle.tail_rel]
"""


@pytest.mark.tutorial
@pytest.mark.process
def test_a_foreign_figure_is_checked_measured_shown_and_searched_for(
    twinct: Shell, tmp_path: Path
) -> None:
    file, out = tmp_path / "tails.yaml", tmp_path / "out"
    file.write_text(
        f"extends: {HERE}/same_bytes/small.yaml\n"
        "trajectory: {views: 12, longitude_range_deg: 180}\n"
        "cell: {kind: gantry}\n"
        "xray: {engine: analytic}\n"
        "evaluation:\n"
        "  regions: [{name: middle, shape: {kind: sphere, radius_mm: 30}}]\n"
        "  tails: [{region: middle}]\n"
    )
    refused = twinct("check", file, "--set", "evaluation.tails.0.region=centre")
    assert refused.returncode == 2
    assert "evaluation.tails.0.region: unknown region 'centre'; the only one is" in refused.stderr
    assert twinct("check", file).returncode == 0
    done = twinct("run", file, "--out", out, "--link", "local")
    assert done.returncode == 0, done.stderr
    image = json.loads((out / "metrics.json").read_text())["image"]
    assert image["tails"]["middle"]["tail_rel"] > image["regions"]["middle"]["rmse_rel"] > 0
    assert "<td>largest errors</td>" in (out / "report.html").read_text(encoding="utf-8")
    study = tmp_path / "study.yaml"
    study.write_text(STUDY.format(file=file))
    searched = twinct("study", study, "--out", tmp_path / "searched", "--jobs", "1")
    assert searched.returncode == 0, searched.stderr
    assert (tmp_path / "searched" / "journal.jsonl").read_text().count("tail_rel") == 2
    page = (tmp_path / "searched" / "study.html").read_text(encoding="utf-8")
    assert "largest errors, middle" in page and "Best trials" in page, "lower is better"
    # Unused, it leaves no trace: the scenario can be read where it is not installed.
    unused = twinct("report", out, "--set", "evaluation.tails=[]")
    assert unused.returncode == 0, unused.stderr
    assert "tails" not in (out / "scenario.yaml").read_text() + (out / "metrics.json").read_text()


@pytest.mark.tutorial
@pytest.mark.process
def test_a_foreign_figure_without_a_truth_is_measured_in_an_imported_scan(
    twinct: Shell, tmp_path: Path
) -> None:
    shutil.unpack_archive(HERE / "version_1_0" / "measured.tar.xz", tmp_path, filter="data")
    folder = tmp_path / "measured"
    region = "evaluation.regions=[{name: middle, shape: {kind: sphere, radius_mm: 30}}]"
    done = twinct("report", folder, "--set", region, "--set", "evaluation.grain=[{region: middle}]")
    assert done.returncode == 0, done.stderr
    made = json.loads((folder / "metrics.json").read_text())["reconstructions"]["fast"]
    assert made["judgement"]["grain"]["middle"]["grain_per_mm"] > 0
    assert "<td>grain</td>" in (folder / "report.html").read_text(encoding="utf-8")
    refused = twinct("report", folder, "--set", "evaluation.tails=[{region: middle}]")
    assert refused.returncode == 2 and "has no truth that these figures" in refused.stderr


@pytest.fixture
def without_gvxr(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Refuse the import of gVXR in all processes, nodes included."""
    package = tmp_path / "blocked" / "gvxrPython3"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('blocked')\n")
    paths = [str(package.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.usefixtures("without_gvxr")
def test_another_engine_images_a_whole_scan_without_gvxr(twinct: Shell, scenario: Path) -> None:
    out, blurred = scenario.parent / "out", "source.focal_spot={kind: square, size_mm: 1}"
    command = ["run", scenario, "--out", out, "--link", "local", "--set"]
    refused = twinct(*command, "xray.engine=gvxr")
    assert refused.returncode != 0 and "gVXR cannot be loaded: blocked" in refused.stderr
    changes = ["xray.engine=analytic", "--set", blurred, "--set", "source.focal_spot.samples=2"]
    checked = twinct("check", scenario, "--set", *changes)
    assert checked.returncode == 0, checked.stderr
    assert "analytic" in checked.stdout
    done = twinct(*command, *changes, "--resume")
    assert done.returncode == 0, done.stderr
    assert "rendered by analytic" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.parametrize(
    ("engine", "reason"),
    [
        ("dark", "'dark' of hopeless 0.3 cannot be used: OSError: its library is gone"),
        ("gvrx", "there is no engine 'gvrx'; did you mean 'gvxr'?"),
    ],
)
def test_who_names_an_engine_that_cannot_be_used_is_told_why(
    twinct: Shell, scenario: Path, engine: str, reason: str
) -> None:
    change, out = ("--set", f"xray.engine={engine}"), scenario.parent / "out"
    for command in (["check", scenario], ["run", scenario, "--out", out, "--link", "local"]):
        refused = twinct(*command, *change)
        assert refused.returncode == 2
        place = f"--set xray.engine={engine}: xray.engine: "
        assert f"{place}{reason} (allowed: gvxr, mesh, cuda_mesh, analytic)" in refused.stderr
    assert not out.exists()


@pytest.mark.tutorial
@pytest.mark.process
def test_who_names_a_broken_one_is_told_why(twinct: Shell, scenario: Path) -> None:
    given = "reconstruction.algorithm=hopeless", "trajectory.kind=nowhere", "evaluation.hidden=[]"
    given += "uncertainty.wobble={}", "cell.source_arm.model=lame"
    refused = twinct("check", scenario, *(f"--set={one}" for one in given))
    assert refused.returncode == 2
    for place in (f"{one}: " for one in given):
        said = [line for line in refused.stderr.splitlines() if f"--set {place}" in line]
        [line] = [line for line in said if "cannot be used" in line]
        assert "of hopeless 0.3 cannot be used: OSError: its library is gone" in line
    (scenario.parent / "start.npy").unlink()
    refused = twinct("check", scenario)
    assert refused.returncode == 2
    assert f"{scenario}:3: reconstruction.path: no file at {scenario.parent}" in refused.stderr


@pytest.mark.tutorial
@pytest.mark.process
def test_a_foreign_part_is_checked_imaged_and_judged(twinct: Shell, tmp_path: Path) -> None:
    file, out = tmp_path / "ring.yaml", tmp_path / "out"
    file.write_text(
        f"extends: {HERE}/same_bytes/small.yaml\n"
        "trajectory: {views: 3}\n"
        "cell: {kind: gantry}\n"
        "xray: {engine: mesh}\n"
        "specimen:\n"
        "  parts: [{shape: {kind: ring, radius_mm: 30, tube_mm: 10}, material: bone}]\n"
    )
    for change, reason in (
        ("kind=ghost", "'ghost' of hopeless 0.3 cannot be used: OSError"),
        ("closed=false", "of kind ring: its surface is open"),
    ):
        refused = twinct("check", file, "--set", f"specimen.parts.0.shape.{change}")
        assert refused.returncode == 2 and reason in refused.stderr, refused.stderr
    done = twinct("run", file, "--out", out, "--link", "local")
    assert done.returncode == 0, done.stderr
    truth = nibabel.load(out / "truth.nii")
    volume = truth.get_fdata().sum() / truth.get_fdata().max() * np.prod(truth.header.get_zooms())
    assert volume == pytest.approx(2 * np.pi**2 * 30 * 10**2, rel=POLYGON)
    assert "ring" in (out / "report.html").read_text(encoding="utf-8")


OWN_PARTS = f"""\
extends: {HERE}/same_bytes/small.yaml
trajectory: {{views: 3}}
cell: {{kind: gantry}}
source: {{focal_spot: {{kind: gaussian, sigma_mm: 0.3, samples: 2}}}}
specimen:
  parts:
  - {{name: foam, shape: {{kind: foam, radius_mm: 20, bone: 0.1}}, material: bone}}
  - name: pin
    shape: {{kind: box, size_mm: [9, 9, 9]}}
    material: bone
    position_mm: [0, -38, 0]
  - name: egg
    shape: {{kind: egg, radius_mm: 10, height_mm: 14}}
    material: water
    position_mm: [0, 38, 0]
"""


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.parametrize("engine", ["gvxr", "analytic"])
def test_foreign_voxels_and_solids_are_cast_beside_any_engine(
    twinct: Shell, tmp_path: Path, engine: str
) -> None:
    file, out = tmp_path / "own.yaml", tmp_path / "out"
    file.write_text(OWN_PARTS + f"xray: {{engine: {engine}}}\n")
    words = f"rendered by {engine}; foam, egg by rays of their own"
    checked = twinct("check", file)
    assert checked.returncode == 0, checked.stderr
    assert words in " ".join(checked.stdout.replace("│", " ").split())
    done = twinct("run", file, "--out", out, "--link", "local")
    assert done.returncode == 0, done.stderr
    assert words in (out / "report.html").read_text(encoding="utf-8")
    # The truth has the attenuation of each part, by its own formulas.
    truth = nibabel.load(out / "truth.nii")
    values, cell = truth.get_fdata(), np.prod(truth.header.get_zooms())
    y = truth.affine[1, 3] + truth.affine[1, 1] * np.arange(values.shape[1])
    water, bone = (material(name).mu_per_mm(80.0) for name in ("water", "bone"))
    for part, mu_mm3 in (
        (y > 25, water * 4 / 3 * np.pi * 10 * 10 * 14),
        (abs(y) < 25, 4 * np.pi * 20**3 * (5 / 24 * water + 0.1 / 3 * bone)),
        (y < -25, bone * 9**3),
    ):
        assert values[:, part].sum() * cell == pytest.approx(mu_mm3, rel=0.02)
    assert json.loads((out / "metrics.json").read_text())["image"]["rmse_near_rel"] > 0


@pytest.mark.tutorial
@pytest.mark.process
def test_no_later_part_is_cut_out_of_a_foreign_solid(twinct: Shell, tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(
        OWN_PARTS + "  - {shape: {kind: sphere, radius_mm: 3}, position_mm: [0, 38, 0]}\n"
    )
    refused = twinct("check", file)
    assert refused.returncode == 2
    assert "part 'egg' of kind egg is cast by its own rays, out of which no later" in (
        refused.stderr
    )


SAG_STUDY = """\
scenario: {file}
axes: [{{key: uncertainty.sag.mm, values: [0.5, 1]}}]
figures: [image.rmse_rel]
"""


@pytest.mark.tutorial
@pytest.mark.process
def test_a_foreign_error_is_checked_drawn_propagated_and_varied(
    twinct: Shell, tmp_path: Path
) -> None:
    file, out = tmp_path / "sag.yaml", tmp_path / "out"
    file.write_text(
        f"extends: {HERE}/same_bytes/small.yaml\n"
        "trajectory: {views: 3}\n"
        "cell: {kind: gantry}\n"
        "xray: {engine: mesh}\n"
        "uncertainty: {sag: {mm: 2, spread: 0}, source: {sigma_mm: 0}, detector: {sigma_mm: 0}}\n"
    )
    refused = twinct("check", file, "--set", "uncertainty.sag.spread=2")
    assert refused.returncode == 2 and "uncertainty.sag.spread" in refused.stderr
    assert twinct("check", file).returncode == 0
    told = twinct("uncertainty", file, "--draws", "2", "--out", out / "told")
    assert told.returncode == 0, told.stderr
    [term] = json.loads((out / "told" / "uncertainty.json").read_text())["terms"]
    assert term["term"] == "sag, mean"
    done = twinct("run", file, "--out", out / "run", "--link", "local")
    assert done.returncode == 0, done.stderr
    # A level beam sinks by 2 mm; the path rises to 5 deg.
    found = json.loads((out / "run" / "metrics.json").read_text())["pose_error"]["source"][
        "position_mm"
    ]
    assert found["mean"] == pytest.approx(term["source_mm"], rel=1e-3)
    assert found["mean"] == pytest.approx(2.0, rel=0.01)
    study = tmp_path / "study.yaml"
    study.write_text(SAG_STUDY.format(file=file))
    varied = twinct("study", study, "--out", out / "study", "--jobs", "1")
    assert varied.returncode == 0, varied.stderr
    assert "uncertainty.sag.mm" in (out / "study" / "study.html").read_text(encoding="utf-8")
    # Unused, it leaves no trace: the scenario can be read where it is not installed.
    unused = "--set", "uncertainty.sag=null"
    done = twinct("run", file, "--out", out / "none", "--link", "local", *unused)
    assert done.returncode == 0, done.stderr
    assert "sag" not in (out / "none" / "scenario.yaml").read_text()


@pytest.mark.tutorial
@pytest.mark.process
def test_a_foreign_arm_is_checked_and_moved(twinct: Shell, tmp_path: Path) -> None:
    file, out = tmp_path / "six.yaml", tmp_path / "out"
    file.write_text(
        f"extends: {HERE}/same_bytes/small.yaml\n"
        "trajectory: {views: 3}\n"
        "xray: {engine: mesh}\n"
        "cell: {source_arm: {model: six}}\n"
    )
    refused = twinct("check", file, "--set", "cell.source_arm.model=sixx")
    assert refused.returncode == 2
    assert "did you mean 'six'? (known: ur10e, lbr_iiwa14, six, and menagerie" in refused.stderr
    checked = twinct("check", file)
    assert checked.returncode == 0, checked.stderr
    done = twinct("run", file, "--out", out, "--link", "local")
    assert done.returncode == 0, done.stderr
    assert json.loads((out / "metrics.json").read_text())["clearance_mm"]["min"] > 12
    assert "model: six" in (out / "scenario.yaml").read_text()


LATE = """
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from twinct.core.errors import InputError, TrajectoryError
from twinct.evaluation import Figure, FigureKind, FigureSettings
from twinct.recon.algorithm import Algorithm, AlgorithmSettings
from twinct.robots.arm_files import ArmFile
from twinct.specimen.part_kinds import PartKind, PartSettings
from twinct.trajectory import Family, OrbitSettings
from twinct.uncertainty.error_terms import ErrorSettings, ErrorTerm, Spread, size
from twinct.xray.engine import EngineChoice


class Path1(OrbitSettings):
    kind: Literal["late_path"]


def refused(*given):
    raise TrajectoryError("late path: no such views")


class Solver(AlgorithmSettings):
    algorithm: Literal["late_solver"] = "late_solver"


def unfit(*given):
    raise InputError("reconstruction: late solver does not fit")


class Body(PartSettings):
    kind: Literal["late_body"]


class Count(FigureSettings):
    region: str


class Slack(ErrorSettings):
    mm: float = size("Slack of the tool.")


def slack(settings, motion):
    yield Spread("tool", np.full(6, settings.mm))


PATH = Family(Path1, refused)
SOLVER = Algorithm(Solver, unfit, volumes=1, check=unfit)
BODY = PartKind(Body, lambda section: ([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]]))
COUNT = FigureKind(
    "late_count",
    Count,
    "Counts.",
    (Figure("n", "number", "1", 1, 0, ""),),
    lambda at, one: {},
    check=lambda places, one: {"region": "cannot be counted"},
    names={"region": "region"},
)
SLACK = ErrorTerm("late_slack", Slack, slack, ("tool",))
HIDDEN = ErrorTerm("late_hidden", Slack, slack)
ENGINE = EngineChoice("late_engine", object(), modules=("no_such_module",))
ARM = ArmFile("late_arm", Path("/nowhere/arm.xml"))
"""

LATE_POINTS = """\
[twinct.trajectories]
late_path = late:PATH
[twinct.algorithms]
late_solver = late:SOLVER
[twinct.parts]
late_body = late:BODY
[twinct.figures]
late_count = late:COUNT
[twinct.errors]
late_slack = late:SLACK
late_hidden = late:HIDDEN
[twinct.xray_engines]
late_engine = late:ENGINE
[twinct.arms]
late_arm = late:ARM
"""

REFUSED_LATE = {
    "trajectory={kind: late_path, views: 3}": "late path: no such views",
    "reconstruction.algorithm=late_solver": "late solver does not fit",
    "specimen.parts.0.shape={kind: late_body}": "its surface is open",
    "evaluation={regions: [{name: a, shape: {kind: sphere, radius_mm: 9}}], "
    "late_count: [{region: a}]}": "cannot be counted",
    "uncertainty.late_slack={mm: 1}": "uncertainty.late_slack: a gantry has no arms",
    "uncertainty.late_hidden={mm: 1}": "has the place 'tool', but the error declares only pose",
    "xray.engine=late_engine": "no_such_module",
    "cell={kind: arms, source_arm: {model: late_arm}}": "model: late_arm does not exist",
}


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    """Commands of a process that finds extensions of every kind, all of which refuse their use."""
    target = tmp_path_factory.mktemp("late")
    distribution(target, "late", "1.0", LATE_POINTS, LATE)
    with Shell(tmp_path_factory.mktemp("streams"), target) as shell:
        yield shell


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.parametrize("change", REFUSED_LATE)
def test_check_and_run_agree_on_each_kind_of_extension(
    late: Shell, tmp_path: Path, change: str
) -> None:
    file, out = tmp_path / "late.yaml", tmp_path / "out"
    file.write_text(
        f"extends: {HERE}/same_bytes/small.yaml\n"
        "trajectory: {views: 3}\n"
        "cell: {kind: gantry}\n"
        "xray: {engine: mesh}\n"
    )
    for command in (["check", file], ["run", file, "--out", out, "--link", "local"]):
        refused = late(*command, "--set", change)
        assert refused.returncode == 2, refused.stdout + refused.stderr
        assert REFUSED_LATE[change] in " ".join(refused.stderr.split())
    assert not out.exists()
