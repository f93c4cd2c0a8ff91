"""Proposals: edits that cure, place or plan, with what they change, before anyone accepts them.

Each is a question. Its answer holds one edit of the scenario, and the reach and the motion of the
present and of the proposed state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError, TrajectoryError
from twinct.core.files.plain_yaml import written_on_a_line
from twinct.core.progress import Progress
from twinct.design.bench import Bench
from twinct.design.edits import Edit
from twinct.design.movable import tidy
from twinct.design.own_folder import relative_to_file, room_in
from twinct.design.questions import HeldViews, Motion, PlannedMotion, Question
from twinct.observers import audience_of
from twinct.robots.reach import Remedy
from twinct.runs.reaching import place
from twinct.runs.remedies import keys_of, remedies
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Scenario, ScenarioText, load_scenario
from twinct.view_plans import planner

PLACING_S = 15.0
"""Time of a search for places of the arms; as ``twinct place`` takes for a trajectory."""

TASK_RADIUS_SHARE = 0.5
"""Radius of the region of a new task, as a share of half the grid's smallest edge."""


@dataclass(frozen=True, eq=False)
class Standing:
    """Reach and motion of a state of the scenario.

    Attributes:
        scenario: the state.
        held: views that both arms hold, (views,).
        motion: motion through all views.
    """

    scenario: Scenario
    held: NDArray[np.bool_]
    motion: Motion

    @classmethod
    def of(cls, source: ScenarioText, bench: Bench) -> Standing:
        """Return the standing of a text."""
        held = HeldViews(source).answered(bench)
        motion = Motion(None)
        if held.all():
            motion = PlannedMotion(source).answered(bench)
        return cls(bench.scenario(source), held, motion)


@dataclass(frozen=True, eq=False)
class Proposal:
    """An edit, with the standing before and after it.

    Attributes:
        words: the proposal in a sentence or two.
        edit: the edit.
        now: standing of the present state.
        then: standing of the state after the edit.
    """

    words: tuple[str, ...]
    edit: Edit
    now: Standing
    then: Standing


@dataclass(frozen=True)
class ProposalQuestion(Question):
    """A question whose answer is a proposal; a newer one replaces it."""

    subject: ClassVar[str] = "proposal"

    def answered(self, bench: Bench) -> Proposal:
        """Return the proposal.

        Raises:
            InputError: nothing better was found; says why.
        """
        with audience_of(bench.observers) as audience:
            with audience.stage("looking at the present state", 1):
                now = Standing.of(self.source, bench)
            words, values = self._found(bench, now, audience)
            edit = Edit({key: _tidied(value) for key, value in values.items()})
            with audience.stage("looking at the proposed state", 1):
                then = Standing.of(edit.on(self.source), bench)
        return Proposal(tuple(words), edit, now, then)

    def _found(
        self, bench: Bench, now: Standing, progress: Progress
    ) -> tuple[list[str], dict[str, Any]]:
        """Return the proposal in words, and its values by dotted key."""
        raise NotImplementedError


@dataclass(frozen=True)
class Cure(ProposalQuestion):
    """The change that cures views out of reach: the first remedy that ``twinct check`` finds."""

    def _found(
        self, bench: Bench, now: Standing, progress: Progress
    ) -> tuple[list[str], dict[str, Any]]:
        scenario = now.scenario
        if not isinstance(scenario.cell, Cell):
            raise InputError("cell.kind: a gantry takes every view: there is nothing to cure")
        if now.motion.plan is not None:
            raise InputError(
                "both arms hold all views, and a motion connects them: nothing to cure"
            )
        builder = bench.builder(scenario)
        lost = np.flatnonzero(~now.held).tolist()
        error = TrajectoryError(now.motion.problems or ["out of reach"], lost)
        if not lost:
            error = _refusal_of(builder, error)
        _, words = remedies(builder, error, progress=progress)
        found = [one for one in words if isinstance(one, Remedy)]
        if not found:
            raise InputError([str(one) for one in words] or ["no remedy was found"])
        return [str(found[0])], keys_of(found[0], scenario)


def _refusal_of(builder: SimulationBuilder, otherwise: TrajectoryError) -> TrajectoryError:
    """Return the refusal of the plan, which knows to which views no way leads."""
    try:
        _ = builder.plan
    except TrajectoryError as error:
        return error
    return otherwise


@dataclass(frozen=True)
class BetterPlaces(ProposalQuestion):
    """Places of the arms from which they hold more views, as ``twinct place`` finds them.

    Attributes:
        seconds: time of the search; None for no limit.
        samples: positions of each single arm that are tried first.
    """

    seconds: float | None = PLACING_S
    samples: int = 128

    def _found(
        self, bench: Bench, now: Standing, progress: Progress
    ) -> tuple[list[str], dict[str, Any]]:
        found = place(
            now.scenario, seconds=self.seconds, samples=self.samples, observers=bench.observers
        )
        if not found.moved:
            raise InputError("nothing better was found: the arms stay where they are")
        before, after = now.scenario.cell, found.placement.cell
        assert isinstance(before, Cell)
        values = {
            f"cell.{arm}.{key}": getattr(getattr(after, arm), key)
            for arm in ("source_arm", "detector_arm")
            for key in ("base_position_mm", "base_rotation_deg", "standoff_mm", "tool_rotation_deg")
            if getattr(getattr(after, arm), key) != getattr(getattr(before, arm), key)
        }
        words = (
            f"other places of the arms: they hold {100 * found.after:.0f} % of "
            f"{found.judged_on} views, {100 * found.before:.0f} % before"
        )
        return [words], values


def _tidied(value: Any) -> Any:
    """Return a value as a person would write it."""
    if isinstance(value, Mapping):
        return {key: _tidied(one) for key, one in cast("Mapping[str, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [_tidied(one) for one in cast("list[Any]", value)]
    return tidy(value) if isinstance(value, float) else value


@dataclass(frozen=True)
class BetterViews(ProposalQuestion):
    """Views for the scenario's task, as ``twinct plan`` chooses them.

    Without a task, the views shall give complete data in a ball in the middle of the volume.
    """

    def _found(
        self, bench: Bench, now: Standing, progress: Progress
    ) -> tuple[list[str], dict[str, Any]]:
        task = {} if now.scenario.task is not None else {"task": task_of(now.scenario)}
        folder = room_in(self.source.path, "views")
        text = Edit(task).on(self.source)
        plan = planner.plan(text, folder, jobs=1, observers=bench.observers)
        planned = load_scenario(folder / planner.SCENARIO)
        values: dict[str, Any] = dict(task)
        trajectory = planned.trajectory.model_dump(mode="json")
        if "path" in trajectory:
            trajectory["path"] = relative_to_file(folder / planner.VIEWS, self.source.path)
        values["trajectory"] = trajectory
        if isinstance(planned.cell, Cell):
            values["motion.detector_roll"] = planned.motion.detector_roll
            values["motion.order"] = planned.motion.order
            values["motion.plan"] = relative_to_file(folder / planner.JOINTS, self.source.path)
        figures = ", ".join(
            f"{name} {_or_none(of['planned'])} (the scenario's path {_or_none(of['own_path'])})"
            for name, of in plan.figures.items()
        )
        words = [f"{len(plan.views)} views, chosen among {plan.reachable} within reach: {figures}"]
        if task:
            words.append(f"the scenario had no task; task: {written_on_a_line(task['task'])}")
        return words, values


def _or_none(value: float | None) -> str:
    return "none" if value is None else f"{value:.3g}"


def task_of(scenario: Scenario) -> dict[str, Any]:
    """Return a task for a scenario without one: complete data in the middle of its volume."""
    grid = scenario.reconstruction.volume_grid
    world_from_specimen = scenario.specimen.world_from_specimen
    middle = world_from_specimen.inverse().apply(grid.world_from_grid.position)
    radius = TASK_RADIUS_SHARE * min(grid.size_mm) / 2
    views = len(SimulationBuilder(scenario).requested)
    return {
        "position_mm": [round(float(number), 1) for number in middle],
        "radius_mm": round(float(radius), 1),
        "views": views,
        "candidates": max(400, 4 * views),
        "completeness": {},
    }
