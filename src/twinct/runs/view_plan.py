"""Views planned for a scenario's task: from candidates that the arms can have to a trajectory."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.errors import InputError, ScanExistsError, TrajectoryError
from twinct.files.lock import sole_owner
from twinct.files.writing import check_folder, storage_errors, write_json
from twinct.geometry import Floats, ScanGeometry
from twinct.planning import Goal, Searched, search_views
from twinct.progress import SILENT, Progress
from twinct.report.view_plan import draw_view_plan
from twinct.runs.view_goals import goals_of
from twinct.scan import Workshop
from twinct.scenario import Cell, Scenario, load_scenario, stage_digests, write_scenario
from twinct.trajectory import OrbitSettings, UniformTrajectory, commanded_views, write_views

SEARCH, VIEWS, SCENARIO, JOINTS = "search.json", "views.csv", "planned.yaml", "plan.npz"
RESULT, PICTURE, LOCK = "plan.json", "plan.png", "plan.lock"


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """What was planned.

    Attributes:
        views: the chosen views, rising by candidate.
        figures: of each goal, of the chosen views, of views spread evenly and of the scenario's own
            path with as many, by name.
        candidates: how many there were.
        reachable: how many of them the arms can have.
        scan_s: duration of the motion plan; None with a gantry.
        clearance_mm: smallest on the way; None likewise.
    """

    views: ScanGeometry
    figures: dict[str, dict[str, float]]
    candidates: int
    reachable: int
    scan_s: float | None
    clearance_mm: float | None


def plan_views(
    source: Path,
    out: Path,
    overrides: Sequence[str] = (),
    *,
    resume: bool = False,
    progress: Progress = SILENT,
) -> ViewPlan:
    """Choose views for the task of a scenario, and plan how the arms take them.

    Writes views.csv, planned.yaml, which ``twinct run`` executes, plan.npz, plan.json and plan.png.

    Args:
        source: scenario file.
        out: folder for the results.
        overrides: of keys of the scenario.
        resume: go on with a search that was interrupted.
        progress: hears how far it is.

    Raises:
        InputError: no task, a region that no view sees, limits that no choice keeps, fewer
            candidates within reach than views; each with the nearest that is possible.
        ScanExistsError: the folder holds a search, and nobody asked to resume, or another one.
        TrajectoryError: no way joins the chosen views.
    """
    scenario = load_scenario(source, overrides)
    task = scenario.task
    if task is None:
        raise InputError(f"{source}: has no section task: it says what views are planned for")
    check_folder(out, {SEARCH, VIEWS, SCENARIO, JOINTS, RESULT, PICTURE, LOCK})
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with storage_errors(out), sole_owner(out / LOCK):
        journal = _Journal(out / SEARCH, _digest(scenario), resume)
        workshop = Workshop(scenario)
        all_views = _candidates(scenario)
        if journal.reachable is None:
            journal.reachable = _reachable(workshop, all_views, progress)
            journal.write()
        within = all_views[journal.reachable]
        if len(within) < task.views:
            raise InputError(
                f"task.views: {task.views} are asked for, the arms can have {len(within)} of "
                f"{len(all_views)} candidates: take at most {len(within)}, more task.candidates, "
                "or motion.detector_roll: free; twinct place finds a better place for the arms"
            )
        even = _even(within.source, task.views)
        own = _own_path(scenario, task.views)
        together = ScanGeometry.joined([within, own])
        path = list(range(len(within), len(together)))
        goals = goals_of(workshop, together, len(within), even, progress)
        steps = task.views * (1 + task.rounds)
        with progress.stage("choosing views", steps, len(journal.state.worth)) as step:

            def heard(state: Searched) -> None:
                journal.state = state
                journal.write()
                step()

            found = search_views(
                goals,
                len(within),
                task.views,
                start=journal.state,
                rounds=task.rounds,
                heard=heard,
            )
        chosen = sorted(found.chosen)
        figures = {
            goal.name: {
                "planned": goal.of(chosen),
                "spread_evenly": goal.of(even),
                "own_path": goal.of(path),
            }
            for goal in goals
        }
        views = within[chosen]
        write_views(out / VIEWS, views)
        scan_s, clearance = _driven(source, overrides, scenario, out)
        plan = ViewPlan(views, figures, len(all_views), len(within), scan_s, clearance)
        write_json(out / RESULT, _told(plan, goals, found, journal.reachable[chosen]))
        centre = np.asarray(_orbit(scenario).isocentre_mm)
        draw_view_plan(
            out / PICTURE,
            scenario.name,
            {
                "candidates": all_views.source - centre,
                "within reach": within.source - centre,
                "scenario's path": own.source - centre,
                "planned": views.source - centre,
            },
            found.worth,
            figures,
        )
        return plan


class _Journal:
    """How far a search is, on disk."""

    def __init__(self, path: Path, digest: str, resume: bool) -> None:
        self._path, self._digest = path, digest
        self.reachable: NDArray[np.intp] | None = None
        self.state = Searched()
        if not path.exists():
            return
        kept = _read(path)
        if not resume:
            raise ScanExistsError(f"{path} holds a search: --resume goes on with it")
        if kept.get("digest") != digest:
            raise ScanExistsError(f"{path} is the search of another scenario: choose another --out")
        self.reachable = np.array(kept["reachable"], np.intp)
        state = kept["state"]
        self.state = Searched(
            tuple(state["chosen"]), tuple(state["worth"]), state["place"], state["unchanged"]
        )

    def write(self) -> None:
        assert self.reachable is not None
        state = vars(self.state)
        kept = {"digest": self._digest, "reachable": self.reachable.tolist(), "state": state}
        write_json(self._path, kept)


def _read(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: cannot be read: {error}: delete it to search anew") from None


def _digest(scenario: Scenario) -> str:
    assert scenario.task is not None
    parts = [stage_digests(scenario)["images"], scenario.task.model_dump(mode="json")]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _orbit(scenario: Scenario) -> OrbitSettings:
    section = scenario.trajectory
    if not isinstance(section, OrbitSettings):
        raise InputError(
            f"trajectory.kind: {section.kind}: candidates need an isocentre and distances: take a "
            "kind that has them, such as sinusoid"
        )
    return section


def _candidates(scenario: Scenario) -> ScanGeometry:
    """Views all over the sphere, at the distances of the scenario's path."""
    orbit, task = _orbit(scenario), scenario.task
    assert task is not None
    section = UniformTrajectory(
        kind="uniform",
        views=task.candidates,
        isocentre_mm=orbit.isocentre_mm,
        sod_mm=float(orbit.sod_at(0.5)),
        sdd_mm=float(orbit.sdd_at(0.5)),
        latitude_range_deg=(-90.0, 90.0),
    )
    return commanded_views(section, scenario.detector.panel)


def _own_path(scenario: Scenario, views: int) -> ScanGeometry:
    section = _orbit(scenario).model_copy(update={"views": views})
    return commanded_views(section, scenario.detector.panel)


def _reachable(workshop: Workshop, geometry: ScanGeometry, progress: Progress) -> NDArray[np.intp]:
    """Candidates that both arms can hold at a time, with the clearance that a way keeps."""
    if not isinstance(workshop.scenario.cell, Cell):
        return np.arange(len(geometry))
    from twinct.reach import Holder, Poses

    holder = Holder(workshop.cell, workshop.scenario.motion, roll_free=workshop.roll_free)
    poses = Poses.of(geometry.source_poses(), geometry.detector_poses())
    of_arms = [holder.alone(side, arm) for arm, side in enumerate((poses.source, poses.detector))]
    alone = set(of_arms[0].pose.tolist()) & set(of_arms[1].pose.tolist())
    found: list[int] = []
    with progress.stage("views within reach", len(alone)) as step:
        for view in sorted(alone):
            if len(holder.pairs(of_arms[0], of_arms[1], view)):
                found.append(view)
            step()
    return np.array(found, np.intp)


def _even(sources: Floats, number: int) -> list[int]:
    """Views spread evenly: each the farthest from those before (Gonzalez 1985)."""
    chosen = [0]
    far = np.linalg.norm(sources - sources[0], axis=1)
    while len(chosen) < number:
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(sources - sources[chosen[-1]], axis=1))
    return chosen


def _driven(
    source: Path, overrides: Sequence[str], scenario: Scenario, out: Path
) -> tuple[float | None, float | None]:
    """Write the scenario that takes the views; seconds and clearance of its motion."""
    folder = out.resolve()
    trajectory = json.dumps({"kind": "file", "path": str(folder / VIEWS)})
    changes = [*overrides, f"trajectory={trajectory}"]
    if not isinstance(scenario.cell, Cell):
        write_scenario(out / SCENARIO, source, changes)
        return None, None
    from twinct.motion import save_plan

    roll = [f"motion.detector_roll={'free' if Workshop(scenario).roll_free[1] else 'fixed'}"]
    changes += [*roll, "motion.order=shortest"]
    write_scenario(out / SCENARIO, source, changes)
    try:
        plan = Workshop(load_scenario(out / SCENARIO)).plan
    except TrajectoryError as error:
        kept = f"the chosen views are kept in {out / VIEWS}; other arms' places, or task.views"
        raise TrajectoryError([*error.problems, kept]) from error
    assert plan is not None
    save_plan(plan, out / JOINTS)
    write_scenario(out / SCENARIO, source, [*changes, f"motion.plan={folder / JOINTS}"])
    return plan.duration_s, float(plan.clearance_mm.min())


def _told(
    plan: ViewPlan, goals: Sequence[Goal], found: Searched, chosen: NDArray[np.intp]
) -> dict[str, Any]:
    """What plan.json says."""
    return {
        "candidates": plan.candidates,
        "reachable": plan.reachable,
        "chosen": chosen.tolist(),
        "worth": list(found.worth),
        "goals": {
            goal.name: plan.figures[goal.name]
            | {"weight": goal.weight, "unit": goal.unit, "at_most": goal.at_most}
            for goal in goals
        },
        "scan_s": plan.scan_s,
        "clearance_mm": plan.clearance_mm,
    }
