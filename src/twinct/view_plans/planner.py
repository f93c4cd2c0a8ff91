"""Planning of views for a scenario's task: from reachable candidates to a trajectory."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError, TrajectoryError
from twinct.core.extras import require
from twinct.core.files.lock import sole_owner
from twinct.core.files.private import temporary_folder
from twinct.core.files.writing import check_folder, storage_errors, write_json
from twinct.core.interruption import keeping
from twinct.core.progress import SILENT, Progress
from twinct.core.threads import limit_threads
from twinct.geometry import Floats, ScanGeometry
from twinct.observers import Observers, audience_of
from twinct.robots.cell import path_marks, tell_if_undrawable
from twinct.robots.motion import save_plan
from twinct.scan import SimulationBuilder
from twinct.scenario import (
    Cell,
    ScenarioText,
    ViewTask,
    load_scenario,
    stage_digests,
    write_scenario,
)
from twinct.trajectory import OrbitSettings, farthest_first, write_views
from twinct.view_planning import Goal, Searched, has_limit, search_views
from twinct.view_plans import explained, trial
from twinct.view_plans.candidates import (
    candidates_of,
    orbit_of,
    own_path,
    reachable,
)
from twinct.view_plans.family_search import best_path, error_of
from twinct.view_plans.journal import SearchJournal, search_digest
from twinct.view_plans.mas import share_exposure
from twinct.view_plans.picture import draw_view_plan
from twinct.view_plans.scout import Scouted, scouted
from twinct.view_plans.task_goals import goals_of
from twinct.view_plans.trial import tried
from twinct.workers import LocalPool, Pool
from twinct.workers.cluster import RayPool

SEARCH, VIEWS, SCENARIO, JOINTS = "search.json", "views.csv", "planned.yaml", "plan.npz"
RESULT, PICTURE, LOCK = "plan.json", "plan.png", "plan.lock"
TRIED = (trial.FOLDER, trial.PICTURE)
EXPLAINED = (explained.TABLE, explained.PICTURE, explained.ROOM)


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """Result of view planning.

    Attributes:
        views: the chosen views, in the order of the candidates, or of the path of a family.
        figures: figure of each goal by name, for the chosen views, for evenly spread views and for
            the scenario's own path with as many views; None if the arms cannot reach the views.
        candidates: number of candidates.
        reachable: number of reachable candidates.
        scan_s: duration of the motion plan; None with a gantry.
        clearance_mm: smallest clearance along the motion plan; None with a gantry.
        scouted: pose of the patient from scout views; None: the scenario's pose.
        tried: error of the volume in the region for each set of views, relative to the reference's
            attenuation; None: no images were made.
        explained: reasons for each view; None: not requested.
    """

    views: ScanGeometry
    figures: dict[str, dict[str, float | None]]
    candidates: int
    reachable: int
    scan_s: float | None
    clearance_mm: float | None
    scouted: Scouted | None = None
    tried: Mapping[str, float] | None = None
    explained: explained.Explanation | None = None


@kinds_checked
def plan(
    source: str | Path | ScenarioText,
    out: str | Path,
    overrides: Sequence[str] = (),
    *,
    scout: str | Path | None = None,
    try_views: bool = False,
    explain: bool = False,
    resume: bool = False,
    address: str | None = None,
    jobs: int | None = None,
    threads: int | None = None,
    observers: Observers = (),
) -> ViewPlan:
    """Choose views for the task of a scenario, with the processes of this machine or of a cluster.

    Args:
        source: scenario file, or a text that is not saved.
        out: folder for the results.
        overrides: changes ``KEY=VALUE`` to the scenario.
        scout: run of a few views to which the specimen is registered first.
        try_views: simulate images of the planned views and of the scenario's path.
        explain: write why each view was chosen and what was given up.
        resume: continue an interrupted search.
        address: address of Ray; ``local`` starts Ray on this machine; None: local processes.
        jobs: number of processes; None: as many as there are threads.
        threads: number of threads of all processes; see ``limit_threads``.
        observers: notified of the progress.

    Raises:
        TwinctError: see ``plan_views``.
    """
    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs {jobs}: must be at least 1")
    bound = limit_threads(threads)
    if load_scenario(source, overrides).cell.kind == "arms":
        require("robots")
    with audience_of(observers) as audience, _pool(address, jobs, bound) as pool:
        return plan_views(
            source if isinstance(source, ScenarioText) else Path(source),
            Path(out),
            overrides,
            scout=None if scout is None else Path(scout),
            try_views=try_views,
            explain=explain,
            resume=resume,
            pool=pool,
            progress=audience,
        )


@contextmanager
def _pool(address: str | None, jobs: int | None, bound: int) -> Generator[Pool | None, None, None]:
    """Yield the pool of workers for a search, or None for a single thread; clean up afterwards."""
    workers = jobs or bound
    if address is None and workers == 1:
        yield None
        return
    with temporary_folder() as folder:
        if address is None:
            share = max(bound // workers, 1)
            pool: Pool = LocalPool(folder, workers=workers, threads=share)
        else:
            pool = RayPool(address, name=folder.name, workers=jobs)
        try:
            yield pool
        finally:
            pool.close(clear=True)


def plan_views(
    source: Path | ScenarioText,
    out: Path,
    overrides: Sequence[str] = (),
    *,
    scout: Path | None = None,
    try_views: bool = False,
    explain: bool = False,
    resume: bool = False,
    pool: Pool | None = None,
    progress: Progress = SILENT,
) -> ViewPlan:
    """Choose views for the task of a scenario, and plan the motion of the arms.

    Writes views.csv, planned.yaml, which ``twinct run`` executes, plan.npz, plan.json and plan.png.

    Args:
        source: scenario file, or a text that is not saved.
        out: folder for the results.
        overrides: changes ``KEY=VALUE`` to the scenario.
        scout: run of a few views to which the specimen is registered first; the planned scenario
            contains the resulting pose.
        try_views: simulate images of the planned views and of the scenario's path, as by a gantry,
            reconstruct both, and report the errors.
        explain: write why each view was chosen and what was given up (explained.csv and .png), and
            a picture of the path in the room (path.png).
        resume: continue an interrupted search.
        pool: processes that check reach and judge paths of a family, with the same results; None:
            this process.
        progress: receives the progress.

    Raises:
        InputError: no task, a region that no view sees, limits that no choice meets, or fewer
            reachable candidates than views, each with the nearest possible value; or scout views
            that do not show the specimen.
        ScanExistsError: the folder holds a search and ``resume`` is false, or another search.
        TrajectoryError: no collision-free motion connects the chosen views.
    """
    scenario = load_scenario(source, overrides)
    task = scenario.task
    if task is None:
        raise InputError(
            f"{_file_of(source)}: the section task is missing; it sets the goals of the views"
        )
    if explain and task.family is not None:
        raise InputError(
            "--explain: a path of task.family is chosen as a whole, so that its views have no "
            "reasons of their own; plan without task.family, or without --explain"
        )
    check_folder(out, {SEARCH, VIEWS, SCENARIO, JOINTS, RESULT, PICTURE, LOCK, *TRIED, *EXPLAINED})
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with sole_owner(out / LOCK), ExitStack() as stack:
        seen = None
        if scout is not None:
            seen = scouted(SimulationBuilder(scenario), scout, progress)
            overrides = [*overrides, *seen.overrides]
            scenario = load_scenario(source, overrides)
        digest = search_digest(stage_digests(scenario)["images"], task)
        journal = SearchJournal(out / SEARCH, digest, resume)
        stack.enter_context(keeping(lambda: f"{out} keeps {journal.in_words}"))
        builder = SimulationBuilder(scenario)
        orbit, panel = orbit_of(scenario.trajectory), scenario.detector.panel
        all_views = candidates_of(orbit, task.candidates, panel)
        if journal.within_reach is None:
            journal.write_candidates(reachable(builder, all_views, progress, pool))
        assert journal.within_reach is not None
        within = all_views[journal.within_reach]
        if len(within) < task.views:
            raise InputError(
                f"task.views: {task.views} views are requested, but the arms reach only "
                f"{len(within)} of {len(all_views)} candidates; request at most {len(within)}, or "
                "use more task.candidates or motion.detector_roll: free; twinct place finds a "
                "better place for the arms"
            )
        own = own_path(orbit, task.views, panel)
        choose = _chosen if task.family is None else partial(_tuned, pool=pool)
        choice = choose(builder, task, within, own, journal, progress)
        write_views(out / VIEWS, choice.views, choice.mas)
        scan_s, clearance = _driven(builder, source, overrides, out, choice.section)
        figures, chosen = choice.figures, choice.views
        errors = None
        if try_views:
            even = within[farthest_first(within.source, task.views)]
            every = {
                "own_path": (own, None),
                "spread_evenly": (even, None),
                "planned": (chosen, choice.mas),
            }
            errors = tried(builder, every, out, progress)
        centre = np.asarray(orbit.isocentre_mm)
        reasons = None
        if explain:
            reasons = explained.explained(choice.goals, within.source - centre, choice.chosen)
            explained.write_explanation(out, reasons)
            labels = {goal.name: task.label(goal.name) for goal in choice.goals}
            explained.draw_explanation(
                out / explained.PICTURE, scenario.name, reasons, choice.goals, figures, labels
            )
            _draw_path(out, progress)
        plan = ViewPlan(
            chosen, figures, len(all_views), len(within), scan_s, clearance, seen, errors, reasons
        )
        write_json(out / RESULT, _plan_data(plan, choice))
        draw_view_plan(
            out / PICTURE,
            scenario.name,
            {
                "candidates": all_views.source - centre,
                "within reach": within.source - centre,
                "scenario's path": own.source - centre,
                "planned": chosen.source - centre,
            },
            choice.worth,
            figures,
        )
        return plan


def _file_of(source: Path | ScenarioText) -> Path:
    return source.path if isinstance(source, ScenarioText) else source


@dataclass(frozen=True, eq=False)
class _Choice:
    """Chosen views.

    Attributes:
        views: views in the order in which they are written.
        goals: goals of the search.
        figures: figures of each goal, as in ``ViewPlan``.
        worth: worth of the best choice after each step of the search.
        extras: further entries of plan.json.
        section: the trajectory of the views; None: they are written to a file.
        mas: mAs of each view, (views,); None: the source's.
        chosen: the chosen candidates within reach, in the order of ``views``; empty for a family.
    """

    views: ScanGeometry
    goals: Sequence[Goal]
    figures: dict[str, dict[str, float | None]]
    worth: Sequence[float]
    extras: Mapping[str, Any]
    section: OrbitSettings | None = None
    mas: Floats | None = None
    chosen: Sequence[int] = ()


def _chosen(
    builder: SimulationBuilder,
    task: ViewTask,
    within: ScanGeometry,
    own: ScanGeometry,
    journal: SearchJournal,
    progress: Progress,
) -> _Choice:
    """Choose views among the reachable candidates."""
    even = farthest_first(within.source, task.views)
    together = ScanGeometry.joined([within, own])
    goals = goals_of(builder, together, len(within), even, progress)
    limited = any(has_limit(goal) for goal in goals)
    steps = task.views * (1 + task.rounds + limited)
    with progress.stage("choosing views", steps, len(journal.state.worth)) as step:

        def heard(state: Searched) -> None:
            journal.went_on(state)
            step()

        choice = search_views(
            goals, len(within), task.views, start=journal.state, rounds=task.rounds, heard=heard
        )
    chosen, path = sorted(choice.chosen), range(len(within), len(together))
    assert journal.within_reach is not None
    data: dict[str, Any] = {"chosen": journal.within_reach[chosen].tolist()}
    figures, mas = _figures(goals, chosen, even, path), None
    if task.exposure is not None:
        shared = share_exposure(task.exposure, goals, chosen)
        mas = shared.exposures * builder.scenario.source.mas
        data["exposure"] = {"mas": mas.tolist(), "at_equal_mas": shared.equal}
        for name, value in shared.figures.items():
            figures[name]["planned"] = value
    return _Choice(within[chosen], goals, figures, choice.worth, data, mas=mas, chosen=chosen)


def _tuned(
    builder: SimulationBuilder,
    task: ViewTask,
    within: ScanGeometry,
    own: ScanGeometry,
    journal: SearchJournal,
    progress: Progress,
    pool: Pool | None,
) -> _Choice:
    """Choose the best path of the scenario's family."""
    count = task.views
    reference = within[farthest_first(within.source, count)]
    tuned = best_path(builder, reference, journal, progress, pool)
    together = ScanGeometry.joined([reference, tuned.views, own])
    even, planned, path = (range(k * count, (k + 1) * count) for k in range(3))
    goals = goals_of(builder, together, count, even, SILENT)
    figures = _figures(goals, planned, even, path)
    data: dict[str, Any] = {"parameters": dict(tuned.parameters)}
    if task.trying is not None:
        sets = {"planned": tuned.views, "spread_evenly": reference, "own_path": own}
        error = "error in the region"
        figures[error] = {n: error_of(builder, views) for n, views in sets.items()}
        data["trying"] = figures[error]
    return _Choice(tuned.views, goals, figures, tuned.worth, data, tuned.section)


def _figures(
    goals: Sequence[Goal], planned: Sequence[int], even: Sequence[int], path: Sequence[int]
) -> dict[str, dict[str, float | None]]:
    kinds = {"planned": planned, "spread_evenly": even, "own_path": path}
    figures = {goal.name: {kind: goal.of(views) for kind, views in kinds.items()} for goal in goals}
    return {
        name: {kind: None if np.isnan(value) else value for kind, value in of.items()}
        for name, of in figures.items()
    }


def _driven(
    builder: SimulationBuilder,
    source: Path | ScenarioText,
    overrides: Sequence[str],
    out: Path,
    section: OrbitSettings | None,
) -> tuple[float | None, float | None]:
    """Write the scenario of the views; return duration and clearance of its motion plan."""
    folder = out.resolve()
    trajectory = {"kind": "file", "path": str(folder / VIEWS)}
    if section is not None:
        trajectory = section.model_dump(mode="json")
    changes: dict[str, Any] = {"trajectory": trajectory}
    if not isinstance(builder.scenario.cell, Cell):
        write_scenario(out / SCENARIO, source, overrides, changes)
        return None, None
    free = builder.roll_free[1]
    changes["motion.detector_roll"] = "free" if free else "fixed"
    tour = section is None and builder.scenario.until is None
    changes["motion.order"] = "shortest" if tour else "given"
    write_scenario(out / SCENARIO, source, overrides, changes)
    try:
        plan = SimulationBuilder(load_scenario(out / SCENARIO)).plan
    except TrajectoryError as error:
        note = f"the chosen views are kept in {out / VIEWS}; move the arms, or change task.views"
        raise TrajectoryError([*error.problems, note]) from error
    assert plan is not None
    save_plan(plan, out / JOINTS)
    changes["motion.plan"] = str(folder / JOINTS)
    write_scenario(out / SCENARIO, source, overrides, changes)
    return plan.duration_s, float(plan.clearance_mm.min())


def _draw_path(out: Path, progress: Progress) -> None:
    """Draw the room with the planned path of the source, in the order in which it is driven."""
    if tell_if_undrawable(progress):
        return
    builder = SimulationBuilder(load_scenario(out / SCENARIO))
    sources = builder.commanded.source
    order = np.arange(len(sources))
    if builder.plan is not None:
        order = np.argsort(builder.plan.exposures_s)
    middle = int(order[len(order) // 2])
    builder.draw(out / explained.ROOM, middle, marks=path_marks(sources[order]))


def _plan_data(plan: ViewPlan, choice: _Choice) -> dict[str, Any]:
    """Return the content of plan.json."""
    seen = plan.scouted
    return {
        "scouted": seen
        and {
            "views": seen.views,
            "moved_mm": seen.moved_mm,
            "turned_deg": seen.turned_deg,
            "position_mm": seen.world_from_specimen.position.tolist(),
            "rotation_deg": seen.world_from_specimen.to_euler()[1].tolist(),
        },
        "candidates": plan.candidates,
        "reachable": plan.reachable,
        **choice.extras,
        "worth": list(choice.worth),
        "goals": {
            goal.name: plan.figures[goal.name]
            | {
                "weight": goal.weight,
                "unit": goal.unit,
                "at_most": goal.at_most,
                "at_least": goal.at_least,
            }
            for goal in choice.goals
        },
        "scan_s": plan.scan_s,
        "clearance_mm": plan.clearance_mm,
        "region_rmse_rel": plan.tried and dict(plan.tried),
        "best_alone": plan.explained and dict(plan.explained.alone),
    }
