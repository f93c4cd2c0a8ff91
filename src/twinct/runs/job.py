"""A run: plan, acquire, reconstruct, judge and report, with all results in one folder."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from contextlib import ExitStack, closing, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.files.lock import sole_owner
from twinct.core.files.plain_yaml import read_file
from twinct.core.files.writing import remove_folder, storage_errors
from twinct.core.interruption import keeping
from twinct.core.threads import limit_threads, load_numba
from twinct.evaluation import ImageFigures, figure_kinds
from twinct.link.recording import recorder_of
from twinct.observers import Audience, Observers, audience_of
from twinct.recon.volume import Volume
from twinct.report import algorithm_results, physics_in_words
from twinct.robots.cell import tell_if_undrawable
from twinct.runs.acquisition import (
    Link,
    RigFactory,
    acquire_to_store,
    installed_link,
    rig_factory,
    scenario_with,
)
from twinct.runs.checks import (
    check_geometries,
    check_physics,
    check_places,
    check_sight,
    require_extras,
)
from twinct.runs.figures import Figures
from twinct.runs.folder import Folder, read_metrics, refuse_other_keys
from twinct.runs.judgement import Judgement
from twinct.runs.judging import ByTruth, WithoutTruth
from twinct.runs.log import logged_to
from twinct.runs.needs import require_memory
from twinct.runs.notebook import run_in_notebook
from twinct.runs.reconstruction_folder import check_files, stored_reconstructions
from twinct.runs.repair import resumable
from twinct.runs.repeated_figures import repeated_figures, repeats_asked
from twinct.runs.repeats import Repeats
from twinct.runs.reporting import Results, judge, write_results, write_volumes
from twinct.runs.seconds import Seconds, Timing
from twinct.runs.stages import (
    due,
    figures_digest,
    figures_made_from,
    make_due,
    run_stages,
    volume_made_from,
)
from twinct.runs.truth import truth_of
from twinct.runs.volumes import reconstruct, require_feasible
from twinct.scan import (
    Rig,
    Scan,
    ScanStore,
    SimulationBuilder,
    check_space,
    image_digests,
    named_geometries,
    scenario_in,
)
from twinct.scan.status import views_taken
from twinct.scenario import SECTIONS, Scenario, stage_digests, with_files_in
from twinct.scenario.imported import ScanSettings
from twinct.scenario.version_0_1 import volume_digest

if TYPE_CHECKING:
    from twinct.link.recording import Recorder

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Run:
    """A finished run, or an imported scan with its volumes.

    Their files below ``paths`` are read on first access.
    """

    settings: ScanSettings
    paths: Folder

    @property
    def scenario(self) -> Scenario:
        """The scenario that was run; an imported scan has none."""
        return scenario_in(self.settings)

    @cached_property
    def scan(self) -> Scan:
        """Images and poses of all views, and the geometries derived from them."""
        return scan_of(self.paths, self.settings)

    @cached_property
    def volume(self) -> Volume:
        """The reconstruction, 1/mm."""
        return Volume.read(self.paths.volume)

    @cached_property
    def figures(self) -> Figures:
        """Content of ``metrics.json``."""
        return Figures(read_metrics(self.paths.metrics))

    def __repr__(self) -> str:
        """Return name and folder in one line."""
        return f"Run({self.settings.name!r}, {str(self.paths.path)!r})"

    def _repr_html_(self) -> str:
        """Return the volume's sections, the figures of the image and the report, for a notebook."""
        return run_in_notebook(self.settings.name, self.paths, self.volume, self.figures)


def scan_of(folder: Folder, settings: ScanSettings) -> Scan:
    """Return the scan in a folder with these settings, and with the geometries derived from it."""
    scan = ScanStore(folder.scan).read().with_settings(settings)
    return replace(scan, derived=named_geometries(folder.geometries))


@kinds_checked
def run(
    scenario: Scenario | str | Path,
    out: str | Path,
    *,
    link: Link | None = None,
    resume: bool = False,
    record: bool = False,
    threads: int | None = None,
    builder: SimulationBuilder | None = None,
    observers: Observers = (),
    **keys: Any,
) -> Run:
    """Run a scenario from the plan to the report.

    Args:
        scenario: the scenario, or its file.
        out: folder for the results; an existing scan is never changed without ``resume``.
        link: ``ros2`` starts both simulations as processes; ``local`` runs them in this process;
            None: ``ros2`` if the extra ``ros`` is installed, else ``local``; observers hear which.
        resume: continue with the existing results. Intact views are not acquired again; a volume
            made with other settings is reconstructed again.
        record: write all messages of the scan to ``scan.mcap`` in the folder.
        threads: number of threads of each process; see ``limit_threads``.
        builder: provides parts of this scenario that are already built.
        observers: notified of the plan, moving joints, views, iterations, stages and warnings; see
            ``twinct.observers``.
        **keys: other values of the scenario's sections, as ``Scenario.with_`` takes them, such as
            ``seed=2`` or ``specimen=mesh``; the folder keeps meshes and views in ``inputs``.

    Raises:
        InputError: a problem detected before work starts; nothing has been written.
        FolderInUseError: another process works in the folder.
        TrajectoryError: a view is out of reach or would collide; nothing has been written.
        TwinctError: a failure during the work. Every acquired view is stored.
    """
    load_numba()
    limit_threads(threads)
    scenario = scenario_with(scenario, keys, builder)
    folder = Folder(Path(out))
    seconds = Seconds(folder.seconds)
    if not resume:
        folder.refuse_if_taken()
    folder.refuse_others()
    store = resumable(folder, scenario) if resume and folder.scan.exists() else None
    if store:
        store.refuse_other(image_digests(scenario))
        scenario = with_files_in(scenario, folder.inputs)
    require_extras(scenario)
    chosen = link or installed_link()
    require_memory(scenario)
    check_geometries(scenario, folder.geometries if store else None)
    stages = run_stages(folder, scenario)
    wanted = due(stages)
    if store and not wanted:
        with audience_of(observers) as audience:
            audience.say(f"{folder.path} is complete; the report is {folder.report}")
        return Run(scenario, folder)
    if store and wanted == ["figures"]:
        return _judged_again(finished_run(folder), scenario, observers)
    recorder = recorder_of(chosen, folder.path) if record else None
    builder = builder or SimulationBuilder(scenario)
    if store:
        builder = replace(builder, given_plan=store.plan)
    check_physics(builder)
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        if link is None:
            without = "" if chosen == "ros2" else ": the extra ros is not installed"
            audience.say(f"link {chosen}{without}")
        with seconds.stage("link"):
            hear = recorder.hear if recorder else None
            rigs = rig_factory(chosen, scenario.engine, folder.logs, audience, hear)
            make_rig = stack.enter_context(rigs)
        warnings = _prepare(builder, folder, seconds, audience)
        stack.enter_context(storage_errors(folder.path))
        stack.enter_context(keeping(partial(_kept, folder, len(builder.targets))))
        folder.path.mkdir(parents=True, exist_ok=True)
        stack.enter_context(sole_owner(folder.lock))
        stack.enter_context(logged_to(folder.log))
        if not resume:  # another process may have written here while this one planned
            folder.refuse_if_taken()
        builder = _with_inputs(builder, folder)
        scenario = builder.scenario
        _note(builder, folder, chosen, warnings)
        if resume:
            seconds.go_on()
        with closing(recorder) if recorder else nullcontext():
            take = builder, folder, seconds, make_rig, audience, recorder
            work = {
                "views": lambda: _take_views(*take, resume=resume),
                "volume": lambda: _make_volumes(builder, folder, seconds, audience),
                "figures": lambda: _rejudge(finished_run(folder), builder, audience),
            }
            make_due(stages, work)
        folder.seconds.unlink(missing_ok=True)
    return Run(scenario, folder)


def _kept(folder: Folder, views: int) -> str:
    taken = len(views_taken(folder.scan))
    return f"{folder.path} keeps {taken} of {views} views; --resume continues"


def finished_run(folder: Folder) -> Run:
    """Return the finished run of a folder.

    Raises:
        InputError: the folder holds no finished run, or its volume was made with other settings.
    """
    needed = (folder.scan, folder.volume, folder.metrics, folder.scenario)
    if missing := [p.name for p in needed if not p.exists()]:
        raise InputError(f"{folder.path} holds no finished run: {', '.join(missing)} missing")
    store = ScanStore(folder.scan)
    scenario = folder.scenario_of_run()
    run = Run(scenario, folder)
    if run.volume.extras["note"] not in (_note_of(folder, scenario), _note_of_0_1(store, folder)):
        raise InputError(
            f"{folder.volume} was made with settings other than those in {folder.scenario.name}; "
            f"{again_in_words(folder)}"
        )
    return run


def again_in_words(folder: Folder) -> str:
    """Return the command that makes the results of a run again."""
    return f"'twinct run {folder.scenario} --out {folder.path} --resume' makes it again"


@kinds_checked
def rewrite_report(
    path: str | Path, observers: Observers = (), overrides: Iterable[str] = ()
) -> Run:
    """Judge a finished run, or the volumes of an imported scan, again; rewrite figures and report.

    Figures of two halves of the views stay, as the volumes of the halves are not kept.

    Args:
        path: folder of a run, or of an imported scan.
        observers: notified of the stages.
        overrides: changes ``evaluation.KEY=VALUE`` to the run's scenario, for other figures.

    Raises:
        InputError: see ``finished_run``; the volume was replaced; a key of another section; regions
            or bodies that cannot be measured.
    """
    folder, overrides = Folder(Path(path)), tuple(overrides)
    refuse_other_keys(overrides, "evaluation")
    if folder.scenario.is_file() and folder.settings_of_scan().specimen is None:
        return _volumes_judged_again(folder, overrides, observers)
    made = finished_run(folder)
    if changed := folder.replaced(folder.volume):  # a truth is made again
        raise InputError([f"{problem}; {again_in_words(folder)}" for problem in changed])
    scenario = folder.scenario_of_run(overrides) if overrides else made.scenario
    return _judged_again(made, scenario, observers)


def _judged_again(made: Run, scenario: Scenario, observers: Observers) -> Run:
    """Rewrite the figures of a run; the scenario may differ in its section ``evaluation``."""
    folder = made.paths
    builder = SimulationBuilder(scenario, ScanStore(folder.scan).plan)
    if scenario.evaluation != made.scenario.evaluation:
        check_places(builder)
    with sole_owner(folder.lock), audience_of(observers) as audience:
        tell_if_undrawable(audience)
        return _rejudge(made, builder, audience)


def _rejudge(made: Run, builder: SimulationBuilder, audience: Audience) -> Run:
    """Rewrite the figures of a run, with the section ``evaluation`` of a builder's scenario."""
    scenario, folder = builder.scenario, made.paths
    now = Run(scenario, folder)
    asked_anew = figures_made_from(folder) != figures_digest(scenario)
    before = read_metrics(folder.metrics)
    truth = truth_of(now.scan, builder, audience, file=folder.truth).written(folder.truth)
    which = scenario.reconstruction.geometries[0]
    known = {} if asked_anew else repeated_figures(before["image"])
    again = None
    if repeats_asked(scenario) and not known:
        again = Repeats(now.scan, builder, audience).of(which, made.volume.array)
    first = judge(now.scan, made.volume, truth, builder.specimen, again)
    first = replace(first, further={**first.further, **known})
    figures = {which: first}
    for which, values in before.get("image_by_geometry", {}).items():
        # Only the first volume is stored: the others cannot be measured again.
        data = {k: v for k, v in values.items() if not (asked_anew and k in figure_kinds())}
        figures.setdefault(which, ImageFigures.of(data))
    if asked_anew:
        _judge_others(now, builder, audience)
    volume = replace(made.volume, extras={**made.volume.extras, **algorithm_results(before)})
    results = Results.of(volume, truth)
    results = replace(results, figures=figures, residuals=before.get("residuals", {}))
    timing = Timing(before["seconds"], before["real_time_factor"])
    write_results(folder, builder, now.scan, results, timing)
    if asked_anew:
        folder.write_scenario(scenario)
    return now


def _volumes_judged_again(folder: Folder, overrides: tuple[str, ...], observers: Observers) -> Run:
    """Judge all volumes of a scan without a truth again, and rewrite figures and page."""
    settings = folder.settings_of_scan(overrides)
    now = Run(settings, folder)
    stored = stored_reconstructions(folder.reconstructions)
    if not stored:
        raise InputError(f"{folder.path} holds no volume yet; 'twinct reconstruct' makes one")
    with (
        sole_owner(folder.lock),
        storage_errors(folder.path),
        audience_of(observers) as audience,
    ):
        for one in stored.values():
            check_files(one.path)
            judged = WithoutTruth(now.scan, audience).figures(one.volume, one.geometry)
            assert isinstance(one.figures, Judgement)
            one.with_figures(judged.with_halves_of(one.figures))
        if overrides:
            folder.write_scenario(settings)
        write_volumes(folder, now.scan)
    return now


def _judge_others(run: Run, builder: SimulationBuilder, audience: Audience) -> None:
    """Judge the further reconstructions of a run, too."""
    for one in stored_reconstructions(run.paths.reconstructions).values():
        section = SECTIONS[str(one.settings["algorithm"])].model_validate(dict(one.settings))
        scenario = run.scenario.model_copy(update={"reconstruction": section})
        of_it = replace(builder, scenario=scenario, given_specimen=builder.specimen)
        judge = ByTruth(run.scan.with_settings(scenario), of_it, run.paths, audience)
        one.with_figures(judge.figures(one.volume, one.geometry))


def _prepare(
    builder: SimulationBuilder, folder: Folder, seconds: Seconds, audience: Audience
) -> list[str]:
    """Check and plan before anything is written; return warnings for the user."""
    require_feasible(builder.scenario, builder.commanded)
    undrawable = tell_if_undrawable(audience)
    check_space(folder.path, builder.scenario, len(builder.targets))
    with seconds.stage("specimen"), audience.stage("specimen", 1) as step:
        warnings = check_sight(builder)
        step()
    for warning in warnings:
        audience.say(warning, warning=True)
    with seconds.stage("plan"), audience.stage("plan", 1) as step:
        builder.plan  # noqa: B018 - planned here, before anything is written
        step()
    return [*undrawable, *warnings]


def _with_inputs(builder: SimulationBuilder, folder: Folder) -> SimulationBuilder:
    """Return a builder whose scenario names its files in the folder, where it keeps them."""
    scenario = with_files_in(builder.scenario, folder.inputs)
    if scenario is builder.scenario:
        return builder
    return SimulationBuilder(scenario, builder.plan, builder.specimen)


def _note(builder: SimulationBuilder, folder: Folder, link: Link, warnings: list[str]) -> None:
    """Write the scenario, and log the run's settings and warnings."""
    scenario = builder.scenario
    folder.write_scenario(scenario)
    log.info("twinct run %s, %s link, digests %s", scenario.name, link, stage_digests(scenario))
    for name, words in physics_in_words(scenario, *builder.commanded_poses[0], builder.mas).items():
        log.info("%s: %s", name.lower(), words)
    for warning in warnings:
        log.warning(warning)


def _take_views(
    builder: SimulationBuilder,
    folder: Folder,
    seconds: Seconds,
    make_rig: RigFactory,
    audience: Audience,
    recorder: Recorder | None,
    *,
    resume: bool,
) -> None:
    make_rig = recorder.rigs(make_rig) if recorder else make_rig

    def started(builder: SimulationBuilder, first: int, state: NDArray[np.float64] | None) -> Rig:
        with audience.stage("start of both simulations", 1) as step:
            rig = make_rig(builder, first, state)
            step()
        return rig

    with seconds.views() as watch:
        store = acquire_to_store(
            builder, folder.scan, started, resume=resume, watch=watch, observers=audience
        )
    if recorder:
        recorder.finish(store.reported)
        for problem in recorder.problems:
            audience.say(problem, warning=True)


def _make_volumes(
    builder: SimulationBuilder, folder: Folder, seconds: Seconds, audience: Audience
) -> None:
    """Reconstruct from each geometry, judge, store the first volume, and report."""
    scenario = builder.scenario
    there = folder.volume.exists() and folder.metrics.exists()
    if there and volume_made_from(folder) not in (None, folder.volume_digest(scenario)):
        audience.say(
            f"{folder.volume} is replaced: it was made with other settings (twinct reconstruct "
            "would keep it, and add a volume)"
        )
    with seconds.stage("truth"):
        # The scenario in the store may state another reconstruction; this run's counts.
        scan = Run(scenario, folder).scan
        scan.reported.write(folder.geometries)
        truth = truth_of(scan, builder, audience, file=folder.truth).written(folder.truth)
    figures: dict[str, ImageFigures] = {}
    residuals: dict[str, list[float]] = {}
    first: Results | None = None
    repeats = Repeats(scan, builder, audience) if repeats_asked(scenario) else None
    for which in scenario.reconstruction.geometries:
        course = residuals.setdefault(which, [])
        with seconds.stage("reconstruction", keep=True):
            volume = reconstruct(
                scan,
                geometry=which,
                checkpoints=folder.checkpoints,
                watch=lambda _, residual, course=course: course.append(residual),
                observers=audience,
            )
        if first is None:
            with seconds.stage("storing"):
                volume.write(folder.volume, _note_of(folder, scenario))
            first = Results.of(volume, truth)
        with seconds.stage("judge"), audience.stage(f"judge, {which} geometry", 1) as step:
            again = repeats and repeats.of(which, volume.array)
            figures[which] = judge(scan, volume, truth, builder.specimen, again)
            step()
        del volume
    assert first is not None  # there is a geometry
    del truth  # the report takes memory, too
    results = replace(first, figures=figures, residuals=residuals)
    write_results(folder, builder, scan, results, seconds)
    remove_folder(folder.checkpoints)
    folder.seconds.unlink(missing_ok=True)


def _note_of(folder: Folder, scenario: Scenario) -> str:
    """Return the note in a volume's file that identifies the settings that made it."""
    return f"twinct {folder.volume_digest(scenario)[:32]}"


def _note_of_0_1(store: ScanStore, folder: Folder) -> str | None:
    """Return the note of a run of version 0.1, with its older digest; None for later versions."""
    if store.digest_0_1 is None:
        return None
    scenario = read_file(folder.scenario, "scenario").value
    return f"twinct {volume_digest(store.digest_0_1, scenario['reconstruction'])[:32]}"
