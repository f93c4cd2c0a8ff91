"""The rooms of the package: few, named apart, and found by their old names."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Sequence, Set
from dataclasses import dataclass
from pathlib import Path

import pytest

from twinct.core.renamed import RENAMED

PACKAGE = Path(__file__).parents[1] / "src" / "twinct"
MOST_ROOMS, MOST_FLOORS = 24, 10
"""So many names a newcomer can survey."""
MOST_NAMESAKES = 2
"""A module name that stands in more rooms says nothing."""


def modules() -> dict[str, Path]:
    return {
        ".".join(("twinct", *path.relative_to(PACKAGE).with_suffix("").parts)): path
        for path in PACKAGE.rglob("*.py")
        if "scripts" not in path.parts
    }


def test_rooms_are_few_and_their_modules_named_apart() -> None:
    namesakes = defaultdict[str, set[str]](set)
    for name in modules():
        _, room, *rest = name.split(".")
        if rest:
            namesakes[rest[-1]].add(room)
    rooms = set.union(*namesakes.values())
    del namesakes["__init__"]
    assert len(rooms) <= MOST_ROOMS
    assert not {name: at for name, at in namesakes.items() if len(at) > MOST_NAMESAKES}


def test_floors_are_few() -> None:
    settings = tomllib.loads((PACKAGE.parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    (layers,) = (c["layers"] for c in contracts if c["id"] == "layers")
    assert len(layers) <= MOST_FLOORS


@dataclass(frozen=True)
class Walk:
    """Types that something passes on its way, as docs/architecture.md lists them.

    Attributes:
        title: title of the list.
        most: number of types, the arrays and rows without a name of their own included.
        functions: functions that it passes, one after the other, by file.
        types: types that hold it.
        others: types without it that these functions take, too.
    """

    title: str
    most: int
    functions: Sequence[tuple[str, str]]
    types: Set[str]
    others: Set[str]


POSE = Walk(
    "Types of a pose on its way",
    8,
    (
        ("trajectory/families.py", "commanded_views"),
        ("geometry/wire.py", "targets_of"),
        ("robots/motion/plan.py", "plan_motion"),
        ("uncertainty/executed.py", "at"),
        ("scan/rig.py", "move"),
        ("xray/imager.py", "expose"),
        ("xray/engine.py", "render"),
        ("scan/store.py", "write"),
        ("scan/encoder_model.py", "nominal_poses"),
        ("uncertainty/reported.py", "reported_poses"),
        ("scan/data.py", "geometry"),
        ("recon/projector.py", "_index_rays"),
    ),
    {"ScanGeometry", "Pose", "PosePairs", "MotionPlan", "Reached", "Scan"},
    {
        *("CellModel", "Motion", "Panel", "Shutter", "Sequence", "Scenario", "Uncertainty"),
        *("Floats", "NDArray", "TrajectorySettings", "ViewImages", "VolumeGrid"),
    },
)
STUDY_VALUE = Walk(
    "Types of a study's value on its way",
    6,
    (
        ("study/design.py", "_choices"),
        ("study/design.py", "_crossed"),
        ("study/design.py", "repeated"),
        ("study/design.py", "trials"),
        ("study/checking.py", "checked"),
        ("study/driver.py", "run"),
        ("study/driver.py", "spec"),
        ("study/driver.py", "_trial_work"),
        ("workers/pool.py", "submit"),
        ("workers/local.py", "_start"),
        ("workers/call.py", "pickled"),
        ("study/trial.py", "try_trial"),
        ("workers/call.py", "call"),
        ("workers/call.py", "received"),
        ("study/driver.py", "_tried"),
        ("study/rows.py", "done"),
        ("study/results.py", "write_results"),
    ),
    {"Axis", "Trial", "TrialSpec", "Work", "Done", "Row"},
    {
        *("Container", "Failed", "Iterable", "Iterator", "Mapping", "Path", "Place", "Pool"),
        *("Progress", "SILENT", "Sequence"),
    },
)


@pytest.mark.parametrize("walk", [POSE, STUDY_VALUE], ids=lambda walk: walk.title)
def test_a_pose_and_a_value_of_a_study_pass_few_types(walk: Walk) -> None:
    page = (PACKAGE.parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")
    _, rest = page.split(f"## {walk.title}\n")
    listed = re.findall(r"^\| (`(\w+)`|[a-z ]+) \| [^h]", rest.partition("\n## ")[0], re.MULTILINE)
    assert len(listed) <= walk.most
    assert {name for _, name in listed if name} == walk.types
    for file, name in walk.functions:
        tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
        nodes = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == name]
        assert nodes, name
        for node in nodes:
            hints = [a.annotation for a in ast.walk(node.args) if isinstance(a, ast.arg)]
            hints.append(node.returns)
            text = " ".join(ast.unparse(hint) for hint in hints if hint)
            used = {*re.findall(r"\b[A-Z]\w+", text)} - {"Any", "None"}
            assert used <= walk.types | walk.others, (file, name)


def test_a_reconstruction_setting_travels_downwards_only() -> None:
    """Only the files of the algorithms read a section, and nothing hands it up again."""
    recon = {
        path: ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.glob("recon/*.py")
    }
    settings, homes = {"AlgorithmSettings", "SettingsT"}, {PACKAGE / "recon" / "algorithm.py"}
    for _ in range(2):  # a class of settings may extend another one
        for path, tree in recon.items():
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef) and settings & {*map(ast.unparse, node.bases)}:
                    settings.add(node.name)
                    homes.add(path)
    assert {"Sart", "Fast", "FistaTv"} <= settings
    for path, tree in recon.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                hints = [ast.unparse(a.annotation) for a in node.args.args if a.annotation]
                read = settings & {word for hint in hints for word in re.findall(r"\w+", hint)}
                assert not read or path in homes, (path.name, node.name)
                given = ast.unparse(node.returns) if node.returns else ""
                assert not settings & {*re.findall(r"\w+", given)}, (path.name, node.name)


def test_every_old_name_leads_to_a_module() -> None:
    known = {name.removesuffix(".__init__") for name in modules()}
    assert not set(RENAMED.values()) - known
    assert not set(RENAMED) & known


OLD = """
import warnings
from twinct.core.errors import DamagedError
from twinct.scan import SimulationBuilder
warnings.simplefilter("error")
names = ["from twinct.scan import Workshop", "SimulationBuilder(None).asked"]
names += ["from twinct.recon import FoundImplant", "DamagedError([], []).found"]
names += ["from twinct.report import StudyAxis"]
for old in ("import twinct.motion.way", *names):
    try:
        exec(old)
    except DeprecationWarning as warning:
        print(warning)
warnings.simplefilter("ignore")
import twinct.motion.way
from twinct.errors import InputError
from twinct.motion.way import find_joint_path
from twinct.runs.view_plan import plan_views
from twinct.scan import Workshop
print(find_joint_path.__module__, plan_views.__module__, InputError.__module__)
print(Workshop is SimulationBuilder)
"""


@pytest.mark.process
def test_old_names_import_the_same_things_with_a_warning() -> None:
    result = subprocess.run([sys.executable, "-c", OLD], capture_output=True, text=True)
    assert result.stdout.splitlines() == [
        "twinct.motion is now twinct.robots.motion",
        "twinct.scan.Workshop is now twinct.scan.SimulationBuilder",
        "SimulationBuilder.asked is now SimulationBuilder.requested",
        "twinct.recon.FoundImplant is now twinct.recon.FittedImplant",
        "DamagedError.found is now DamagedError.damages",
        "twinct.report.StudyAxis is now twinct.report.study_page.StudyAxis",
        "twinct.robots.motion.path_search twinct.view_planning.planner twinct.core.errors",
        "True",
    ], result.stderr
