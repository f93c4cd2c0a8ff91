"""The check of a scenario: everything that a run would refuse, without running it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.files.writing import check_plan_file
from twinct.core.progress import Progress
from twinct.observers import Observers, audience_of
from twinct.robots.motion import save_plan
from twinct.runs.acquisition import installed_link
from twinct.runs.checks import (
    check_geometries,
    check_physics,
    check_sight,
    findings,
    rehearse,
    require_extras,
)
from twinct.runs.needs import needs_in_words, require_memory
from twinct.runs.pilot import measured_time
from twinct.runs.remedies import explained
from twinct.runs.volumes import require_feasible
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, as_scenario


@dataclass(frozen=True)
class Checked:
    """A scenario that can be run.

    Attributes:
        scenario: the scenario.
        findings: description of the run, by topic.
        warnings: doubts about its results.
    """

    scenario: Scenario
    findings: Mapping[str, str]
    warnings: tuple[str, ...]


@kinds_checked
def check(
    scenario: Scenario | str | Path,
    *,
    save: str | Path | None = None,
    cures: bool = True,
    all_cures: bool = False,
    picture: str | Path | None = None,
    time: bool = False,
    observers: Observers = (),
) -> Checked:
    """Validate a scenario, build its specimen, plan its motion and rehearse it, without running it.

    The rehearsal simulates the arms' motion without images, and finds every view that a run would
    miss.

    Args:
        scenario: the scenario, or its file.
        save: file for the plan; a scenario follows it with the key motion.plan.
        cures: search for a remedy of infeasible views.
        all_cures: try all changes that may help, even if that takes longer than planning.
        picture: file for the picture of an infeasible view; None, or without ``cures``: no picture.
        time: take small scans of the scenario to measure the time of a run, unless that was
            done on this machine; see ``Checked.findings``.
        observers: notified of the progress and of warnings.

    Raises:
        InputError: the scenario cannot be run, with a sentence for each problem.
        TrajectoryError: a view is out of reach, would collide, or would be missed; with a remedy,
            if one was found.
    """
    scenario = as_scenario(scenario)
    if save is not None:
        _check_plan_file(scenario, save := Path(save))
    require_extras(scenario)
    builder = SimulationBuilder(scenario)
    has_arms = scenario.cell.kind == "arms"
    with audience_of(observers) as audience:

        def remedied() -> AbstractContextManager[None]:
            if not (has_arms and cures):
                return nullcontext()
            file = None if picture is None else Path(picture)
            return explained(builder, file, all_cures=all_cures, progress=audience)

        require_memory(scenario)
        check_geometries(scenario)
        if builder.plan_chooses:  # otherwise, the views are known without a plan
            with remedied():
                plan_motion(builder, audience)
        check_physics(builder)
        require_feasible(scenario, builder.commanded)
        warnings = check_sight(builder)
        for warning in warnings:
            audience.say(warning, warning=True)
        with remedied():
            plan_motion(builder, audience)
        rehearse(builder, audience)
        found = {name: words.replace("×", "x") for name, words in findings(builder).items()}
        link = installed_link()
        if time and measured_time(scenario, link, audience) is None:
            audience.say("a small scan failed, so the time of a run is not known", warning=True)
        found |= needs_in_words(scenario, link)
        if save is not None:
            assert builder.followed is not None  # as _check_plan_file has found
            save_plan(builder.followed, save)
    return Checked(scenario, found, tuple(warnings))


def plan_motion(builder: SimulationBuilder, progress: Progress) -> None:
    """Plan the motion, as a stage of its own."""
    if builder.scenario.cell.kind == "arms":
        with progress.stage("planning the motion", 1) as step:
            _ = builder.plan
            step()


def _check_plan_file(scenario: Scenario, path: Path) -> None:
    """Check that a scenario has a plan, and that a path can become its file."""
    if scenario.cell.kind != "arms" or scenario.motion.scheme == "reactive":
        why = "motion.scheme: reactive" if scenario.cell.kind == "arms" else "a gantry"
        raise InputError(f"--save {path}: {why} has no motion plan")
    check_plan_file(path)
