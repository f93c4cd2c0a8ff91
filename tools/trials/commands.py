"""Commands under trial, on tiny scenarios, and what each has to leave behind."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recordings import told_by

ROOT = Path(__file__).parents[2]
HOOK = Path(__file__).parent / "hook"
VIEWS = 6
BALL = {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 10}
TINY = {
    "trajectory.views": VIEWS,
    "detector": {"columns": 24, "rows": 16, "pixel_pitch_mm": 14},
    "xray.engine": "mesh",
    "specimen.parts": [{"shape": BALL}],
    "reconstruction.grid": {"voxels": 12, "voxel_mm": 13},
    "reconstruction.iterations": 2,
}
TASK = {
    "position_mm": [0, 0, 0], "radius_mm": 20, "views": 4, "candidates": 20,
    "completeness": {"within_deg": 10},
}  # fmt: skip
AXES = [
    {"key": "reconstruction.relaxation", "values": [0.2, 0.5]},
    {"key": "trajectory.views", "values": [3, 4]},
]
CLOSE = " ".join(f"--set {key}={json.dumps(TINY[key], separators=(',', ':'))}" for key in TINY)
"""The keys as words without spaces."""
SET = [word for key, value in TINY.items() for word in ("--set", f"{key}={json.dumps(value)}")]


@dataclass(frozen=True)
class Command:
    """A command of twinct.

    Attributes:
        words: its words; OUT and MADE are the trial's output and the folder of prepared inputs.
        results: patterns of result files whose bytes do not depend on the time.
        again: further words that continue an interrupted command.
        kept: patterns of files that a continued command must not write again.
        of: name in the prepared inputs of what OUT is a copy of; empty: OUT is new.
        over: the command may also run over its earlier results.
        victims: processes of the command that a trial may kill or stop.
        beside: words of a command that runs beside it, and outlives it; it ends with 0.
        grows: its result is a recording, of which an interrupted command leaves a readable part.
    """

    words: str
    results: tuple[str, ...]
    again: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    of: str = ""
    over: bool = False
    victims: tuple[str, ...] = ()
    beside: str = ""
    grows: bool = False

    @property
    def of_cluster(self):
        """True if the command needs a cluster."""
        return "ADDRESS" in self.words


SCAN = ("scan.zarr/**/*", "volume.nii", "truth.nii")
VIEW_FILES = ("scan.zarr/status/c.*",)
COMMANDS = {
    "run": Command(
        "run MADE/gantry.yaml --out OUT --link local", SCAN, ("--resume",), VIEW_FILES
    ),
    "run of arms": Command(
        "run MADE/arms.yaml --out OUT --link local", SCAN, ("--resume",), VIEW_FILES
    ),
    "run over ros2": Command(
        "run MADE/arms.yaml --out OUT --link ros2", SCAN, ("--resume",), VIEW_FILES,
        victims=("robots", "xray"),
    ),
    "study": Command(
        "study MADE/study.yaml --out OUT --jobs 1", ("journal.jsonl", "trials/*"),
        ("--resume", "--retry-failed"), ("trials/*",), victims=("worker",),
    ),
    "study on a cluster": Command(
        "study MADE/study.yaml --out OUT --address ADDRESS", ("journal.jsonl", "trials/*"),
        ("--resume",), ("trials/*",),
    ),
    "plan": Command(
        "plan MADE/task.yaml --out OUT --jobs 1", ("views.csv", "plan.json", "search.json"),
        ("--resume",),
    ),
    "reconstruct": Command(
        "reconstruct OUT --set reconstruction.algorithm=sirt --as again",
        (*SCAN, "reconstructions/again/volume.nii"), of="run",
    ),
    "calibrate": Command(
        "calibrate self OUT", (*SCAN, "geometries/self.json"), of="run",
    ),
    "predict": Command(
        "predict OUT --as again", (*SCAN, "predictions/again/views.csv"), of="run",
    ),
    "demo": Command(f"demo --out OUT {CLOSE}", SCAN, ("--threads", "1"), VIEW_FILES),
    "render": Command("render MADE/arms.yaml --out OUT/room.png", ("*",), over=True),
    "report": Command("report OUT", (*SCAN, "metrics.json", "report.html"), of="run"),
    "reach": Command("reach MADE/arms.yaml --out OUT --directions 12", ("reach.*",), over=True),
    "place": Command(
        "place MADE/arms.yaml --save OUT/placed.yaml --samples 1 --z 0 0 --standoff 150 150",
        ("*",), over=True,
    ),
    "view": Command("view MADE/run --export OUT/page.html", ("*",), over=True),
    "film": Command("view MADE/run --movie OUT/film.mp4", ("*",), over=True),
    "import": Command("import MADE/run/scan.mcap --out OUT", ("scan.zarr/**/*", "scenario.yaml")),
    "export": Command("export MADE/run --to rtk --out OUT/rtk", ("rtk/*",)),
    "volume": Command(
        "export MADE/run --volume volume --to dicom --out OUT/volume", ("volume/*",)
    ),
    "motion": Command("motion MADE/arms.yaml --to csv --out OUT/plan", ("plan/*",)),
    "drive": Command(
        "drive MADE/arms.yaml --out OUT/drive.mcap --both /arms/follow_joint_trajectory "
        "--source-prefix source_ --detector-prefix detector_ --patience-s 600", ("drive.mcap",),
        beside="node robots MADE/arms.yaml", grows=True,
    ),
    "specimen": Command("specimen MADE/gantry.yaml --out OUT", ("*.stl", "truth.nii"), over=True),
    "uncertainty": Command(
        "uncertainty MADE/arms.yaml --draws 20 --out OUT", ("uncertainty.json",), over=True
    ),
    "check": Command(
        "check MADE/arms.yaml --save OUT/plan.npz --picture OUT/view.png", ("*",), over=True
    ),
    "verify": Command("verify OUT", SCAN, of="run"),
    "arm": Command(
        "arm MADE/moveit/arms.urdf --out OUT/arm", ("arm/*", "arm/meshes/*")
    ),
    "urdf": Command("urdf MADE/arms.yaml --out OUT", ("*",), over=True),
    "geometry": Command(
        "geometry OUT --as again --set uncertainty.seed=3", (*SCAN, "geometries/again.json"),
        of="run",
    ),
    "import of images": Command(  # metadata and digests name the folder
        "import MADE/exported --out OUT", ("scan.zarr/[!m]*/**/*", "scenario.yaml", "imported.png")
    ),
    "compare": Command("compare MADE/run MADE/other --out OUT/page.html", ("*",), over=True),
    "ctsimu render": Command(
        "ctsimu render MADE/ctsimu/SCENARIO --out OUT --samples 1", ("*.tif",), ("--resume",),
        ("*_0*.tif",),
    ),
    "ctsimu export": Command(
        "ctsimu export MADE/run --out OUT", ("*.json", "*.stl", "projections/*")
    ),
    "ctsimu qualify": Command(
        "ctsimu qualify --out OUT --tests 2D-FB-2", ("2D-FB-2/*.tif", "qualification.json")
    ),
}  # fmt: skip
"""All commands that work for longer than a second, by their names in the report.

``init`` and ``schema`` are shorter; the page of ``view`` has no end, nor has ``node``, which runs
beside ``drive``.
"""


def environment(changes):
    """Return the environment of a command, with changes; None removes a variable."""
    paths = [str(HOOK), os.environ.get("PYTHONPATH", "")]
    own = {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "TWINCT_THREADS": "1"}
    changed = os.environ | {"MUJOCO_GL": "egl"} | own | changes
    return {name: value for name, value in changed.items() if value is not None}


def prepare(made, names):
    """Make the inputs of some commands in a folder."""
    write(made / "gantry.yaml", "circle_gantry", TINY)
    write(made / "arms.yaml", "demo", TINY)
    write(made / "task.yaml", "circle_gantry", TINY | {"task": TASK})
    study = {"scenario": str(made / "gantry.yaml"), "axes": AXES, "keep": "volume"}
    (made / "study.yaml").write_text(json.dumps(study))
    if any(
        COMMANDS[n].of or re.search("MADE/(run|ctsimu|exported)", COMMANDS[n].words) for n in names
    ):
        do("run MADE/gantry.yaml --out MADE/run --link local --record", made)
        shutil.copytree(made / "run", made / "other")
    if "ctsimu render" in names:
        do("ctsimu export MADE/run --out MADE/ctsimu", made)
    if "arm" in names:
        do("urdf MADE/arms.yaml --moveit --out MADE/moveit", made)
    if "import of images" in names:
        do("export MADE/run --to rtk --out MADE/exported", made)


def write(file, extends, keys):
    """Write a scenario with other values of some dotted keys."""
    told: dict[str, Any] = {"extends": str(ROOT / "scenarios" / f"{extends}.yaml")}
    for dotted, value in keys.items():
        place = told
        *sections, key = dotted.split(".")
        for section in sections:
            place = place.setdefault(section, {})
        place[key] = value
    file.write_text(json.dumps(told))


def line(words, made, out, address=""):
    """Return the command line of a command's words."""
    scenario = next(
        (p.name for p in (made / "ctsimu").glob("*.json") if "openCT" not in p.name), ""
    )
    places = {"MADE": str(made), "OUT": str(out), "SCENARIO": scenario, "ADDRESS": address}
    found = []
    for word in words.split():
        parts = [places.get(part, part) for part in word.split("/")]
        found.append("/".join(parts))
    return [sys.executable, "-m", "twinct", *found]


def do(words, made):
    """Run a command that has to succeed."""
    done = subprocess.run(
        line(words, made, made), env=environment({}), capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{words} ended with {done.returncode}:\n{done.stderr}")


def begin(command, made, out):
    """Make the output of a command that works in an existing folder."""
    if command.of:
        shutil.copytree(made / command.of, out)
    else:
        out.mkdir(parents=True)


def contents(out, patterns):
    """Return the contents of all complete files below a folder that fit one of some patterns."""
    files = {path for pattern in patterns for path in out.glob(pattern) if path.is_file()}
    return {str(p.relative_to(out)): content(p) for p in sorted(files) if not is_draft(p)}


def is_draft(path):
    """Return True for a file in a draft of a command."""
    return "partial" in path.name or any(p.startswith(".twinct-draft-") for p in path.parts)


def content(file):
    """Return the bytes of a file, without what depends on the time or names its own folder."""
    if file.name == "drive.mcap":
        return told_by(file)
    if file.suffix == ".urdf":
        return file.read_bytes().replace(file.parent.resolve().as_uri().encode(), b"OUT")
    if file.suffix != ".jsonl":
        return file.read_bytes()
    rows = [json.loads(row) for row in file.read_text().splitlines(True) if row.endswith("\n")]
    done = [row for row in rows if row["status"] == "done"]  # failed ones are tried again
    return sorted(json.dumps(row | {"seconds": {}}) for row in done)
