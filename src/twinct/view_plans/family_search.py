"""Search for the best path of a family: parameters of the scenario's trajectory, by CMA-ES."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from twinct.core.errors import InputError
from twinct.core.files.private import temporary_folder
from twinct.core.foreign_text import quoted
from twinct.core.progress import SILENT, Progress
from twinct.geometry import ScanGeometry
from twinct.scan import SimulationBuilder
from twinct.scenario import FamilySearch
from twinct.trajectory import OrbitSettings, commanded_views
from twinct.view_planning import best_parameters, worth_of
from twinct.view_plans.candidates import orbit_of, reachable
from twinct.view_plans.journal import SearchJournal
from twinct.view_plans.search_work import spread
from twinct.view_plans.task_goals import goals_of
from twinct.view_plans.trial import trial
from twinct.workers import Pool

MISSED = -1e3
"""Worth of an infeasible path, scaled by 1 + its violation, which guides the search."""

TOGETHER = 2
"""Number of paths that are judged as one piece of work."""


@dataclass(frozen=True, eq=False)
class TunedPath:
    """Result of a search in a family.

    Attributes:
        section: the trajectory, as a section of a scenario.
        parameters: the optimised parameters, by key.
        views: views of the path.
        worth: worth of the best path after each generation.
    """

    section: OrbitSettings
    parameters: Mapping[str, float]
    views: ScanGeometry
    worth: tuple[float, ...]


def best_path(
    builder: SimulationBuilder,
    reference: ScanGeometry,
    journal: SearchJournal,
    progress: Progress,
    pool: Pool | None = None,
) -> TunedPath:
    """Search for the path of highest worth whose views are all reachable.

    Args:
        builder: builder of a scenario whose task has a family.
        reference: evenly spread views; their measures are the units.
        journal: state of an earlier search; each generation is written to it.
        progress: receives the progress.
        pool: processes that judge paths; None: this process.

    Raises:
        InputError: keys that the trajectory does not have, or values that it refuses; no feasible
            path within the bounds, with the violations of the nearest one.
        MissingExtraError: cmaes is not installed.
    """
    task = builder.scenario.task
    assert task is not None and task.family is not None
    orbit = orbit_of(builder.scenario.trajectory)
    _check(orbit, task.views, task.family)
    generations, judged = list(journal.generations), 0
    tried = None
    if task.trying is not None and len(generations) < task.family.generations:
        tried = error_of(builder, reference)

    def starts(sets: Sequence[object]) -> range:
        return range(0, len(sets), TOGETHER)

    def worth(sets: Sequence[Mapping[str, float]]) -> Sequence[float]:
        nonlocal judged
        judged += 1
        if judged <= len(generations):
            return generations[judged - 1]
        pieces = [_PathBatch(reference, tried, sets[k : k + TOGETHER]) for k in starts(sets)]
        judgements = spread(_judged, builder, pieces, pool)
        values = [value for piece in judgements for value, _ in piece]
        journal.judged(values)
        return values

    bounds = {one.key: (one.low, one.high) for one in task.family.parameters}
    tuned = best_parameters(
        worth,
        bounds,
        generations=task.family.generations,
        population=task.family.population,
        seed=builder.scenario.seed,
        progress=progress,
    )
    if tuned.worth <= MISSED:
        raise _infeasible(builder, reference, tuned.parameters)
    section = _section(orbit, task.views, tuned.parameters)
    views = commanded_views(section, builder.scenario.detector.panel)
    return TunedPath(section, tuned.parameters, views, tuned.history)


def _infeasible(
    builder: SimulationBuilder, reference: ScanGeometry, nearest: Mapping[str, float]
) -> InputError:
    """Return the refusal of a search without any feasible path."""
    ((_, words),) = _judged(builder, _PathBatch(reference, None, [nearest]))
    near = ", ".join(f"{key} {value:.3g}" for key, value in nearest.items())
    return InputError(
        f"task.family: no tried path is feasible; the nearest, with {near}, {words}; try wider "
        "bounds, fewer keys, motion.detector_roll: free, or more task.family.generations"
    )


@dataclass(frozen=True, eq=False)
class _PathBatch:
    """Paths to be judged.

    Attributes:
        reference: evenly spread views.
        tried: error of a volume of the reference views; None: paths are not tried.
        sets: parameters of each path.
    """

    reference: ScanGeometry
    tried: float | None
    sets: Sequence[Mapping[str, float]]


def error_of(builder: SimulationBuilder, views: ScanGeometry) -> float:
    """Return the error of a volume of the views in the task's region; store no files."""
    with temporary_folder() as folder:
        return trial(builder, views, None, folder, "path").error_rel


def _judged(builder: SimulationBuilder, piece: _PathBatch) -> list[tuple[float, str]]:
    """Return the worth of each path, and its violations in words."""
    reference, task = piece.reference, builder.scenario.task
    assert task is not None
    panel, count = builder.scenario.detector.panel, task.views
    orbit = orbit_of(builder.scenario.trajectory)
    paths = [commanded_views(_section(orbit, count, one), panel) for one in piece.sets]
    held = np.array([len(reachable(builder, path, SILENT)) for path in paths])
    both = ScanGeometry.joined([reference, *paths])
    goals = goals_of(builder, both, len(reference), range(len(reference)), SILENT)
    judged: list[tuple[float, str]] = []
    for k in range(len(paths)):
        views = range(len(reference) + k * count, len(reference) + (k + 1) * count)
        missed = count - int(held[k])
        words = [f"has {missed} of {count} views out of reach"] if missed else []
        far = missed / count
        for goal in goals:
            if goal.at_most is not None and (has := goal.of(views)) > goal.at_most:
                far += has / goal.at_most - 1
                words.append(f"has {goal.name} = {has:.4g}, at most {goal.at_most:.4g} allowed")
            if goal.at_least is not None and (has := goal.of(views)) < goal.at_least:
                far += 1 - has / goal.at_least
                words.append(f"has {goal.name} = {has:.4g}, at least {goal.at_least:.4g} needed")
        worth = MISSED * (1 + far) if words else worth_of(goals, views)
        if piece.tried is not None and task.trying is not None and not words:
            worth -= task.trying.weight * error_of(builder, paths[k]) / piece.tried
        judged.append((worth, ", ".join(words)))
    return judged


def _section(orbit: OrbitSettings, views: int, parameters: Mapping[str, float]) -> OrbitSettings:
    keys: dict[str, Any] = orbit.model_dump() | {"views": views} | dict(parameters)
    return type(orbit).model_validate(keys)


def _check(orbit: OrbitSettings, views: int, family: FamilySearch) -> None:
    fields = type(orbit).model_fields
    numbers = [
        name
        for name in fields
        if isinstance(getattr(orbit, name), float) and not name.startswith("isocentre")
    ]
    problems: list[str] = []
    for i, one in enumerate(family.parameters):
        key = f"task.family.parameters.{i}"
        if one.key not in numbers:
            problems.append(
                f"{key}.key: the scenario's trajectory has no numeric key {quoted(one.key)}; "
                "choose "
                f"from {', '.join(numbers)}"
            )
            continue
        for side in ("low", "high"):
            try:
                _section(orbit, views, {one.key: getattr(one, side)})
            except ValidationError as error:
                problems.append(f"{key}.{side}: {error.errors()[0]['msg']}")
    if problems:
        raise InputError(problems)
