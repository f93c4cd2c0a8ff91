"""The job behind ``twinct run`` and ``twinct report``: every stage, each kept on disk."""

from __future__ import annotations

import contextlib
import json
import logging
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from twinct.cell import check_drawing
from twinct.cli.progress import TerminalProgress
from twinct.errors import InputError
from twinct.evaluate import ImageFigures, pose_errors
from twinct.files.writing import storage_errors, write_text
from twinct.report import (
    ReportData,
    build_metrics,
    cross_sections,
    draw_pictures,
    physics_in_words,
    write_report,
)
from twinct.runs.acquisition import acquire_to_store, local_rig
from twinct.runs.checks import check_physics, check_sight, require_extras
from twinct.runs.folder import Folder, read_metrics
from twinct.runs.judgement import Truth, judge, truth_of
from twinct.runs.seconds import Seconds
from twinct.runs.volumes import reconstruct, reconstruction_digest, require_feasible
from twinct.scan import Rig, Scan, ScanStore, Workshop, check_space
from twinct.scenario import Scenario, load_scenario
from twinct.volume import read_volume, write_volume

log = logging.getLogger(__name__)
Link = Literal["ros2", "local"]
MakeRig = Callable[[Workshop, NDArray[np.float64] | None, int], Rig]
"""Of a scenario, the simulator state to start from, and the first view to take."""

_SHOWN_VIEWS = 4
"""Projections shown in the report."""


def run_job(scenario: Scenario, out: Path, link: Link, *, resume: bool) -> None:
    """Plan, acquire, reconstruct, judge and report.

    Raises:
        InputError: whatever can be known before work starts; nothing has been written then.
    """
    folder, console = Folder(out), Console()
    seconds = Seconds(folder.seconds)
    if not resume:
        folder.refuse_if_taken()
    folder.refuse_others()
    if resume and folder.scan.exists():
        ScanStore(folder.scan).refuse_other(scenario)
    require_extras(scenario)
    check_drawing()
    if resume and folder.finished(scenario):
        console.print(f"{folder.path} is complete; the report is {folder.report}", highlight=False)
        return
    workshop = Workshop(scenario)
    check_physics(workshop)
    with contextlib.ExitStack() as stack:
        with seconds.stage("link"):
            make_rig = _link(link, folder, console, stack)
        _run(workshop, folder, seconds, link, make_rig, resume=resume)
    _say_result(console, folder)


def _run(
    workshop: Workshop,
    folder: Folder,
    seconds: Seconds,
    link: Link,
    make_rig: MakeRig,
    *,
    resume: bool,
) -> None:
    progress, scenario = TerminalProgress(), workshop.scenario
    require_feasible(scenario, workshop.commanded)
    out = folder.path
    check_space(out, scenario, len(workshop.targets))
    with seconds.stage("specimen"), progress.stage("specimen", 1) as step:
        warnings = check_sight(workshop)
        step()
    warn(warnings)
    with seconds.stage("plan"), progress.stage("plan", 1) as step:
        workshop.plan  # noqa: B018 - planned here, before anything is written
        step()
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        _log_to(folder.log)
        write_text(folder.scenario, _as_yaml(scenario))
        log.info(
            "twinct run %s, %s link, scenario digest %s", scenario.name, link, scenario.digest()
        )
        for name, words in physics_in_words(scenario, *workshop.commanded_poses[0]).items():
            log.info("%s: %s", name.lower(), words)
        for warning in warnings:
            log.warning(warning)
        if resume:
            seconds.go_on()
        with seconds.views() as watch:
            store = acquire_to_store(
                workshop,
                folder.scan,
                partial(_started, make_rig, workshop, progress),
                resume=resume,
                watch=watch,
                progress=progress,
            )
        with seconds.stage("truth"):
            scan = store.read()
            truth = truth_of(scan, workshop, progress)
        figures: dict[str, ImageFigures] = {}
        residuals: dict[str, list[float]] = {}
        kept: NDArray[np.float32] | None = None
        for which in scenario.reconstruction.geometries:
            course = residuals.setdefault(which, [])
            with seconds.stage("reconstruction", keep=True):
                volume = reconstruct(
                    scan,
                    geometry=which,
                    checkpoints=folder.checkpoints,
                    watch=lambda _, residual, course=course: course.append(residual),
                    progress=progress,
                )
            if kept is None:
                kept = volume
                grid = scenario.reconstruction.grid.volume_grid
                digest = reconstruction_digest(scenario)
                with seconds.stage("storing"):
                    write_volume(folder.volume, volume, grid, f"twinct {digest[:32]}")
            with seconds.stage("judge"), progress.stage(f"judge, {which} geometry", 1) as step:
                figures[which] = judge(scan, volume, truth)
                step()
            del volume
        assert kept is not None
        _report(folder, scan, workshop, kept, truth, figures, seconds, residuals)
        shutil.rmtree(folder.checkpoints, ignore_errors=True)
        folder.seconds.unlink(missing_ok=True)


def report_again(path: Path) -> None:
    """Judge a finished run again and rewrite its figures and its report.

    Raises:
        InputError: the folder holds no finished run.
    """
    folder, progress = Folder(path), TerminalProgress()
    needed = (folder.scan, folder.volume, folder.metrics, folder.scenario)
    missing = [p.name for p in needed if not p.exists()]
    if missing:
        raise InputError(f"{path} holds no finished run: {', '.join(missing)} missing")
    before = read_metrics(folder.metrics)
    scenario = load_scenario(folder.scenario)
    scan = replace(ScanStore(folder.scan).read(), scenario=scenario)
    workshop = Workshop(scenario)
    volume, _ = read_volume(folder.volume)
    truth = truth_of(scan, workshop, progress)
    figures = {scenario.reconstruction.geometries[0]: judge(scan, volume, truth)}
    for which, values in before.get("image_by_geometry", {}).items():
        figures.setdefault(which, ImageFigures(**values))
    with storage_errors(path):
        residuals = before.get("residuals", {})
        _report(folder, scan, workshop, volume, truth, figures, before, residuals)
    _say_result(Console(), folder)


def summary(workshop: Workshop) -> Table:
    """What ``twinct check`` found."""
    scenario, plan = workshop.scenario, workshop.plan
    grid = scenario.reconstruction.grid.volume_grid
    physics = physics_in_words(scenario, *workshop.commanded_poses[0])
    worst = int(plan.clearance_mm.argmin())
    table = Table(title=f"{scenario.name}: can be run", show_header=False)
    for name, value in {
        "views": f"{len(workshop.targets)}, {scenario.trajectory.kind}",
        **{name.lower(): words.replace("×", "x") for name, words in physics.items()},
        "specimen": ", ".join(
            f"{part.name} of {part.material.name}" for part in workshop.specimen.parts
        ),
        "smallest clearance": f"{plan.clearance_mm.min():.1f} mm, "
        f"at view {worst}, between {' and '.join(plan.nearest[worst])}",
        "grid": f"{' x '.join(map(str, grid.shape_xyz))} voxels of "
        f"{' x '.join(f'{edge:g}' for edge in grid.voxel)} mm",
        "reconstruction": scenario.reconstruction.in_words,
        "digest": scenario.digest(),
    }.items():
        table.add_row(name, value)
    return table


def _link(link: Link, folder: Folder, console: Console, stack: contextlib.ExitStack) -> MakeRig:
    """What starts the two simulations; whatever can be missing for that is missed here.

    The ROS domain is taken and said at once, so that who wants to follow the scan joins in time.
    """
    if link == "local":
        from twinct.xray import prepare_engine

        prepare_engine()
        return lambda workshop, state, _: local_rig(workshop, state)
    from twinct.ros import Domain, require_ros

    require_ros()
    domain = Domain()
    stack.callback(domain.close)
    console.print(f"ROS 2: domain {domain.id} (ROS_DOMAIN_ID)", highlight=False)

    def make_rig(workshop: Workshop, state: NDArray[np.float64] | None, first: int) -> Rig:
        from twinct.ros import RosRig

        return RosRig(
            workshop.scenario,
            first_view=first,
            start_state=state,
            log_dir=folder.logs,
            domain=domain,
        )

    return make_rig


def _started(
    make_rig: MakeRig,
    workshop: Workshop,
    progress: TerminalProgress,
    first: int,
    state: NDArray[np.float64] | None,
) -> Rig:
    with progress.stage("start of both simulations", 1) as step:
        rig = make_rig(workshop, state, first)
        step()
    return rig


def _report(
    folder: Folder,
    scan: Scan,
    workshop: Workshop,
    volume: NDArray[np.float32],
    truth: Truth,
    figures: dict[str, ImageFigures],
    seconds: Seconds | Mapping[str, Any],
    residuals: dict[str, list[float]],
) -> None:
    """Write metrics.json and report.html, each complete or not at all.

    Args:
        folder: where.
        scan: what was taken.
        workshop: its parts.
        volume: the reconstruction kept.
        truth: what it is judged against.
        figures: of each geometry.
        seconds: of this run, or the metrics of the run that is reported again.
        residuals: of each iteration, for each geometry.
    """
    scenario = scan.scenario
    with seconds.stage("report") if isinstance(seconds, Seconds) else contextlib.nullcontext():
        data = _report_data(scan, workshop, volume, truth)
        pictures = draw_pictures(data)
    if isinstance(seconds, Seconds):
        stages, simulated = seconds.finished()
        factor = simulated / stages["motion"] if stages["motion"] else float("nan")
    else:
        stages, factor = seconds["seconds"], seconds["real_time_factor"]
    metrics = build_metrics(
        views=len(workshop.targets),
        reached=len(scan),
        pose_errors=pose_errors(scan.commanded, scan.executed),
        clearance_mm=scan.clearance_mm,
        image=figures,
        seconds=stages,
        simulated_seconds=float(scan.simulated_s[-1]),
        real_time_factor=factor,
        scenario_digest=scenario.digest(),
        reconstruction_digest=reconstruction_digest(scenario),
        residuals=residuals,
    )
    write_report(folder.report, replace(data, metrics=metrics), pictures)
    write_text(folder.metrics, json.dumps(metrics, indent=2) + "\n")


def _report_data(
    scan: Scan, workshop: Workshop, volume: NDArray[np.float32], truth: Truth
) -> ReportData:
    """All that a report shows but the figures."""
    scenario = scan.scenario
    shown = np.unique(np.linspace(0, len(scan) - 1, _SHOWN_VIEWS).round().astype(int))
    return ReportData(
        scenario=scenario,
        scenario_yaml=_as_yaml(scenario),
        metrics={},
        commanded=scan.commanded,
        executed=scan.executed,
        panel=scenario.detector.panel,
        clearance_mm=scan.clearance_mm,
        projections=[(int(view), scan.transmission[view]) for view in shown],
        slices=cross_sections(
            volume, truth.volume, truth.region, scenario.reconstruction.grid.volume_grid
        ),
        mu_reference=truth.mu_reference,
        room_png=_room(workshop),
        nearest=workshop.plan.nearest[int(workshop.plan.clearance_mm.argmin())],
    )


def _as_yaml(scenario: Scenario) -> str:
    return yaml.safe_dump(json.loads(scenario.resolved()), sort_keys=False)


def _room(workshop: Workshop) -> bytes:
    """Picture of the room with the arms in the middle of the path."""
    from twinct.cell import render_cell

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.png"
        render_cell(workshop.room, path, workshop.plan.joints[len(workshop.targets) // 2])
        return path.read_bytes()


def _log_to(path: Path) -> None:
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logger = logging.getLogger("twinct")
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)


def warn(warnings: list[str]) -> None:
    """Say what a user should know of a scan that can be run."""
    for warning in warnings:
        Console(stderr=True).print(f"twinct: warning: {warning}", highlight=False, soft_wrap=True)


def _say_result(console: Console, folder: Folder) -> None:
    metrics = read_metrics(folder.metrics)
    image, pose = metrics["image"], metrics["pose_error"]
    console.print(
        f"{metrics['reached']} of {metrics['views']} views; "
        f"RMSE {_percent(image['rmse_rel'])} of mu(bone), "
        f"{_percent(image['rmse_bone_rel'])} near bone; "
        f"pose error {pose['source']['position_mm']['mean']:.2f} mm source, "
        f"{pose['detector']['position_mm']['mean']:.2f} mm detector\n"
        f"report: {folder.report}",
        highlight=False,
        soft_wrap=True,
    )


def _percent(share: float | None) -> str:
    """None stands for a figure without a voxel to stand on, such as near bone where is none."""
    return "no figure" if share is None else f"{100 * share:.1f} %"
