"""Time of a run on this machine, from three small scans of its kind, taken once and kept.

The small scans have the scenario's own specimen, physics, engine, link and algorithm, with fewer
views, pixels and voxels. So whatever costs time is in them, without a model of each effect. Only
the growth with the sizes is a model, the operations of each stage (``_operations``); its rates
follow from the second and the third scan. The first one loads libraries, as a run does: what it
takes beyond its operations is added once. Each is taken twice, and the shorter time of each stage
counts: other programs can only add time, and what the first process alone computes and keeps on
disk, such as kernels and convex bodies, a run finds there.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from twinct.core.errors import InputError
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import write_json
from twinct.core.progress import SILENT, Progress
from twinct.core.threads import available_threads, threads
from twinct.runs.acquisition import Link
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, parse_scenario
from twinct.trajectory import ends_of_sweeps, write_views

log = logging.getLogger(__name__)

SIZES = ((4, 48, 32), (4, 64, 48), (9, 320, 192))
"""Views, columns and voxels along the longest edge of the small scans; never more than a run's.

The volume of the third one, 28 MB, is larger than most caches, like those of runs. With ten views
or more, coarse voxels would leave so much unexplained that its causes are searched for, which few
runs need.
"""

SIZE_KEYS = ("columns", "rows", "pixel_pitch_mm")


BUSY = 0.5
"""Load of the machine, per processor, from which small scans do not tell a quiet machine's time."""


@dataclass(frozen=True)
class RunTime:
    """Expected seconds of a run.

    Attributes:
        stages: seconds by stage, with the names in ``metrics.json``.
        busy: other programs worked while the small scans were taken.
    """

    stages: Mapping[str, float]
    busy: bool = False

    @property
    def robots(self) -> float:
        """Plan of the motion, and its simulation."""
        return self.stages["plan"] + self.stages["motion"]

    @property
    def rendering(self) -> float:
        """Images of all views."""
        return self.stages["xray"]

    @property
    def reconstruction(self) -> float:
        """Volumes, with all corrections."""
        return self.stages["reconstruction"]

    @property
    def whole(self) -> float:
        """The run, from its start to its report."""
        return sum(self.stages.values())

    @property
    def in_words(self) -> str:
        """The seconds in a line."""
        rest = self.whole - self.robots - self.rendering - self.reconstruction
        parts = (("robots", self.robots), ("rendering", self.rendering))
        parts += (("reconstruction", self.reconstruction), ("the rest", rest))
        shares = ", ".join(f"{name} {_shown(seconds)}" for name, seconds in parts)
        busy = ", as busy as it was when this was measured" if self.busy else ""
        return f"about {_shown(self.whole)} on this machine{busy}: {shares}"


def _shown(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def expected_time(scenario: Scenario, link: Link) -> RunTime | None:
    """Return the seconds of a run by the small scans kept on this machine; None without them."""
    known = _kept().get(_kind(scenario, link))
    if known is None:
        return None
    measured = [{str(k): float(v) for k, v in one.items()} for one in known["seconds"]]
    stages = predicted(known["operations"], measured, _operations(scenario))
    return RunTime(stages, bool(known["busy"]))


def measured_time(scenario: Scenario, link: Link, progress: Progress = SILENT) -> RunTime | None:
    """Take the small scans, unless that was done on a quiet machine, and return a run's seconds.

    Returns:
        The seconds; None if a small scan fails, such as by a view that is out of reach.
    """
    known, busy = expected_time(scenario, link), _is_busy()
    if known is not None and (busy or not known.busy):
        return known
    with tempfile.TemporaryDirectory(prefix="twinct-pilot-") as name:
        try:
            small = [small_scan(scenario, Path(name), *size) for size in SIZES]
        except InputError as error:
            log.info("no small scan of this scenario: %s", error)
            return None
        operations = [_operations(one) for one in small]
        seconds = _taken([*small, *small[1:]], Path(name, "first"), link, progress)
        again = seconds and _taken(small[:1], Path(name, "again"), link, progress)
    if not seconds or not again:
        return None
    shorter = list(map(_shorter, seconds[:3], [*again, *seconds[3:]]))
    entry = {"operations": operations, "seconds": shorter, "busy": busy}
    _keep(_kind(scenario, link), entry)
    return expected_time(scenario, link)


def _shorter(one: Mapping[str, float], again: Mapping[str, float]) -> dict[str, float]:
    return {stage: min(seconds, again[stage]) for stage, seconds in one.items()}


def predicted(
    operations: Sequence[Mapping[str, Sequence[float]]],
    seconds: Sequence[Mapping[str, float]],
    wanted: Mapping[str, Sequence[float]],
) -> dict[str, float]:
    """Extrapolate the seconds of three small scans, by stage.

    Args:
        operations: of each small scan, the operations of each stage; see ``_operations``.
        seconds: seconds of each stage of each small scan.
        wanted: operations of the run.
    """
    from scipy.optimize import nnls  # 0.2 s

    cold, *warm = seconds
    stages: dict[str, float] = {}
    for stage in cold:
        of_stage = wanted.get(stage, ())
        if not len(of_stage):  # does not grow
            stages[stage] = cold[stage]
            continue
        table = np.array([one[stage] for one in operations[1:]])
        scale = table.max(axis=0)  # operations of any unit weigh alike
        rates, _ = nnls(table / scale, np.array([one[stage] for one in warm]))
        once = max(cold[stage] - float(np.array(operations[0][stage]) / scale @ rates), 0.0)
        stages[stage] = once + float(np.array(of_stage) / scale @ rates)
    return stages


def _operations(scenario: Scenario) -> dict[str, list[float]]:
    """Return what the stages of a run do, each as numbers whose rates a machine decides.

    Rendering: views, and pixels of all views. Reconstruction: updates by a view, and their samples:
    each ray takes as many as the grid has planes, and each view updates each voxel. A scan with
    ``until`` counts with all its sweeps, each of which ends with a reconstruction. Stages that are
    missing here take equally long in all sizes: the start of both simulations, and the motion along
    the path.
    """
    views = len(SimulationBuilder(scenario).requested)
    section, panel = scenario.reconstruction, scenario.detector.panel
    grid = section.volume_grid
    pixels, voxels = math.prod(panel.shape), math.prod(grid.shape)
    until = scenario.until
    between = 0 if until is None else sum(ends_of_sweeps(views, until.first)[:-1])
    samples = (views + between) * (pixels * max(grid.shape) + voxels)
    passes = getattr(section, "iterations", 1) * len(section.geometries)
    updates = float((views + between) * passes)
    return {
        "plan": [1.0, views],
        "xray": [views, views * pixels],
        "storing": [views, views * pixels],
        "truth": [1.0, voxels],
        "reconstruction": [updates, float(samples * passes)],
        "judge": [1.0, voxels * len(section.geometries)],
        "report": [1.0, voxels],
    }


def small_scan(scenario: Scenario, folder: Path, views: int, columns: int, voxels: int) -> Scenario:
    """Return a scenario with fewer views, pixels and voxels, of the same room.

    Its views are some of the scenario's; ``folder`` gets their file.
    """
    requested = SimulationBuilder(scenario).requested
    chosen = np.unique(np.linspace(0, len(requested) - 1, min(views, len(requested))).astype(int))
    panel, grid = scenario.detector.panel, scenario.reconstruction.volume_grid
    fewer = max(panel.columns / columns, 1.0)
    coarser = max(max(grid.shape) / voxels, 1.0)
    data: dict[str, Any] = scenario.model_dump(mode="json")
    detector = data["detector"]
    detector["columns"], detector["rows"] = (
        max(round(n / fewer), 2) for n in (panel.columns, panel.rows)
    )
    detector["pixel_pitch_mm"] = _larger(detector["pixel_pitch_mm"], fewer)
    _coarsen(data["reconstruction"], coarser)
    file = folder / f"views-{views}.csv"
    write_views(file, requested[chosen])
    data["trajectory"] = {"kind": "file", "path": str(file)}
    data["evaluation"] = data["task"] = None
    if scenario.cell.kind == "arms":
        data["motion"]["plan"] = None  # made for other views
    return parse_scenario(data)


def _coarsen(section: dict[str, Any], coarser: float) -> None:
    """Make the voxels of the grid, of a zoom and of surroundings larger."""
    grid = section["grid"]
    counts = grid["voxels"]
    count = cast(list[int], counts if isinstance(counts, list) else [counts] * 3)
    grid["voxels"] = [max(round(n / coarser), 2) for n in count]
    grid["voxel_mm"] = _larger(grid["voxel_mm"], coarser)
    for name in ("zoom", "surroundings"):
        if section.get(name):
            section[name]["voxel_mm"] = _larger(section[name]["voxel_mm"], coarser)


def _larger(edge: float | list[float], factor: float) -> float | list[float]:
    return [one * factor for one in edge] if isinstance(edge, list) else edge * factor


SCANS = """
import json, sys
from pathlib import Path
from twinct import run
for file in sys.argv[3:]:
    finished = run(file, Path(sys.argv[2]) / Path(file).stem, link=sys.argv[1])
    seconds = json.loads(finished.paths.metrics.read_text(encoding="utf-8"))["seconds"]
    print(json.dumps({name: taken for name, taken in seconds.items() if name != "total"}))
    sys.stdout.flush()
"""


def _taken(
    small: Sequence[Scenario], folder: Path, link: Link, progress: Progress
) -> list[dict[str, float]] | None:
    """Run the small scans in a process of their own, and return the seconds of their stages."""
    folder.mkdir()
    files = [folder / f"small-{number}.yaml" for number in range(len(small))]
    for file, one in zip(files, small, strict=True):
        file.write_text(one.model_dump_json(), encoding="utf-8")
    command = [sys.executable, "-P", "-c", SCANS, link, str(folder), *map(str, files)]
    environment = os.environ | {"TWINCT_THREADS": str(threads())}
    said: list[dict[str, float]] = []
    with (
        progress.stage("small scans, to time this machine", len(files)) as step,
        (folder / "messages").open("w+") as messages,
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=messages, env=environment, text=True
        ) as process,
    ):
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if line.startswith("{"):
                    said.append(json.loads(line))
                    step()
        except BaseException:
            process.kill()
            raise
        if process.wait() or len(said) != len(files):
            messages.seek(0)
            log.info("a small scan failed: %s", messages.read()[-2000:])
            return None
    return said


def _kind(scenario: Scenario, link: Link) -> str:
    """Return the digest of what decides the rates of a run's stages.

    Lengths, angles and relaxations outside the specimen do not, so trials that differ in them are
    of one kind.
    """
    data = scenario.model_dump(mode="json", exclude={"name", "description", "evaluation", "task"})
    data["trajectory"] = data["trajectory"].get("kind")
    for key in SIZE_KEYS:
        data["detector"].pop(key)
    section = data["reconstruction"]
    for name in ("grid", "zoom", "surroundings"):
        section[name] = bool(section.get(name))
    section.pop("iterations", None)
    specimen = data.pop("specimen")
    text = json.dumps([_countable(data), specimen, link, threads()], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _countable(value: Any) -> Any:
    """Return plain data without its floating point numbers and seeds."""
    if isinstance(value, dict):
        items = cast(dict[str, Any], value).items()
        return {k: _countable(v) for k, v in items if k != "seed" and not isinstance(v, float)}
    if isinstance(value, list):
        listed = cast(list[Any], value)
        return [_countable(one) for one in listed if not isinstance(one, float)]
    return value


def _is_busy() -> bool:
    return os.getloadavg()[0] > BUSY * available_threads()


def _file() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "twinct" / "small_scans.json"


def _kept() -> dict[str, Any]:
    try:
        kept = read_json(_file())
    except (OSError, ValueError):
        return {}
    return cast(dict[str, Any], kept) if isinstance(kept, dict) else {}


def _keep(kind: str, entry: dict[str, Any]) -> None:
    """Store an entry; only log a failure, as no check should fail for its estimate."""
    try:
        _file().parent.mkdir(parents=True, exist_ok=True)
        write_json(_file(), _kept() | {kind: entry})
    except OSError as error:
        log.info("%s: cannot keep the times of the small scans: %s", _file(), error)
