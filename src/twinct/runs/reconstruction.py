"""Further geometries and reconstructions of a finished run."""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.files.lock import sole_owner
from twinct.core.files.writing import remove_folder, storage_errors
from twinct.core.foreign_text import quoted
from twinct.core.interruption import keeping
from twinct.observers import Audience, Observers, audience_of
from twinct.recon.volume import Volume
from twinct.report import algorithm_results, cross_sections
from twinct.runs.checks import check_corrections
from twinct.runs.folder import Folder, read_metrics, refuse_other_keys
from twinct.runs.job import Run, finished_run, rewrite_report
from twinct.runs.log import logged_to
from twinct.runs.reconstruction_folder import (
    Reconstruction,
    free_name,
    reconstruction_base,
    stored_reconstructions,
)
from twinct.runs.repeated_figures import repeats_asked
from twinct.runs.repeats import Repeats
from twinct.runs.reporting import judge
from twinct.runs.truth import truth_of
from twinct.runs.volumes import reconstruct, require_feasible
from twinct.scan import (
    OWN,
    RELATIVE,
    NamedGeometry,
    Scan,
    ScanStore,
    SimulationBuilder,
    checked_name,
    reported,
)
from twinct.scenario import Scenario, stage_digests

log = logging.getLogger(__name__)


def load_scan(path: str | Path) -> Scan:
    """Load a finished scan from a scan.zarr, or from a run's folder with its derived geometries.

    Raises:
        InputError: there is no scan, or it is damaged.
        ScanExistsError: some views are not acquired yet.
    """
    folder = Folder(Path(path))
    if (folder.path / "zarr.json").is_file():
        return ScanStore(folder.path).read()
    return Run(_scenario_of(folder), folder).scan


def derive_geometry(
    path: str | Path, name: str, overrides: Iterable[str] = (), observers: Observers = ()
) -> NamedGeometry:
    """Derive and store the geometry that the robots of a scan would report with other errors.

    Args:
        path: folder of a run.
        name: name of the geometry.
        overrides: changes ``uncertainty.KEY=VALUE`` to the run's scenario.
        observers: notified of the stage.

    Raises:
        InputError: a key of another section, a reserved name, or no scan.
        ScanExistsError: another geometry has this name.
    """
    folder, overrides = Folder(Path(path)), tuple(overrides)
    refuse_other_keys(overrides, "uncertainty")
    scenario = _scenario_of(folder, overrides)
    if checked_name(name) in (taken := (*OWN, RELATIVE)):
        raise InputError(
            f"name {quoted(name)} is reserved: every scan already has {', '.join(taken)}"
        )
    with (
        sole_owner(folder.lock),
        audience_of(observers) as audience,
        audience.stage(f"geometry {name}", 1) as step,
    ):
        scan = Run(scenario, folder).scan
        poses = reported(scenario, scan.joints, scan.executed, scan.commanded, name)
        if name in scan.derived and scan.derived[name].digest != poses.digest:
            raise ScanExistsError(
                f"{folder.geometries / name}.json holds another geometry; choose another --as"
            )
        poses.write(folder.geometries)
        step()
    return poses


def reconstruct_run(
    path: str | Path,
    overrides: Iterable[str] = (),
    *,
    geometry: str | None = None,
    name: str | None = None,
    observers: Observers = (),
) -> Reconstruction:
    """Add a reconstruction to a finished run, and update the run's figures and report.

    An identical reconstruction is not computed again: the existing one is returned, and shown in
    the report if an interruption had prevented that.

    Args:
        path: folder of a run.
        overrides: changes ``reconstruction.KEY=VALUE`` to the run's scenario.
        geometry: geometry to reconstruct from; None: the scenario's first.
        name: name of the reconstruction; None: named after its algorithm and geometry.
        observers: notified of stages and iterations.

    Raises:
        InputError: a key of another section, an unknown geometry, settings that the algorithm
            refuses, or too little memory; nothing is written in that case.
        ScanExistsError: the name is taken, or the same reconstruction has another name.
    """
    folder, overrides = Folder(Path(path)), tuple(overrides)
    refuse_other_keys(overrides, "reconstruction")
    if name is not None:
        checked_name(name)
    finished_run(folder)
    scenario = _scenario_of(folder, overrides)
    which = geometry or scenario.reconstruction.geometries[0]
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        stack.enter_context(storage_errors(folder.path))
        stack.enter_context(sole_owner(folder.lock))
        scan = Run(_with_geometry(scenario, which), folder).scan
        scan.poses(which)
        stored = stored_reconstructions(folder.reconstructions)
        of_geometry = scan.derived[which].digest if which in scan.derived else ""
        digest = stage_digests(scan.scenario)["volume"] + of_geometry
        digest = hashlib.sha256(digest.encode()).hexdigest()
        if there := next((r for r in stored.values() if r.digest == digest), None):
            if name not in (None, there.name):
                raise ScanExistsError(f"{there.path} already holds this reconstruction; omit --as")
            audience.say(f"{there.path} already holds this reconstruction")
            if _is_reported(folder, there):
                return there
        else:
            base = reconstruction_base(scan.scenario, which)
            name = free_name(name, base, folder.reconstructions)
            stack.enter_context(logged_to(folder.log))
            log.info("reconstruction %s: %s", name, scan.scenario.reconstruction.in_words)
            there, volume = _made(scan, folder, which, (name, digest, of_geometry), audience)
            there.keep(volume)
            remove_folder(folder.checkpoints)
    with keeping(lambda: f"{there.path} is kept; the same command completes the report"):
        rewrite_report(folder.path, observers)
    return there


def _is_reported(folder: Folder, there: Reconstruction) -> bool:
    """Return True if the run's figures, which are written last, name a reconstruction."""
    reported = read_metrics(folder.metrics).get("reconstructions", {}).get(there.name, {})
    return reported.get("digest") == there.digest


def timed_volume(
    scan: Scan, folder: Folder, which: str, audience: Audience
) -> tuple[Volume, tuple[float, ...], float]:
    """Return the volume of a geometry, the residual after each iteration, and the seconds."""
    residuals: list[float] = []
    start = time.perf_counter()
    volume = reconstruct(
        scan,
        geometry=which,
        checkpoints=folder.checkpoints,
        watch=lambda _, residual: residuals.append(residual),
        observers=audience,
    )
    return volume, tuple(residuals), time.perf_counter() - start


def _made(
    scan: Scan, folder: Folder, which: str, called: tuple[str, str, str], audience: Audience
) -> tuple[Reconstruction, Volume]:
    scenario = scan.scenario
    builder = SimulationBuilder(scenario, ScanStore(folder.scan).plan)
    check_corrections(scenario)
    require_feasible(scenario, scan.commanded.geometry(scenario.detector.panel))
    volume, residuals, seconds = timed_volume(scan, folder, which, audience)
    truth = truth_of(scan, builder, audience, file=folder.truth)
    grid = scenario.reconstruction.volume_grid
    again = None
    if repeats_asked(scenario):
        again = Repeats(scan, builder, audience).of(which, volume.array)
    name, digest, of_geometry = called
    reconstruction = Reconstruction(
        name=name,
        digest=digest,
        geometry=which,
        geometry_digest=of_geometry,
        in_words=scenario.reconstruction.in_words,
        settings=scenario.reconstruction.model_dump(mode="json"),
        figures=judge(scan, volume, truth, builder.specimen, again),
        residuals=residuals,
        seconds=seconds,
        slices=cross_sections(volume.array, truth.volume, truth.region, grid),
        path=folder.reconstructions / name,
        results=algorithm_results(volume.extras),
    )
    return reconstruction, volume


def _scenario_of(folder: Folder, overrides: tuple[str, ...] = ()) -> Scenario:
    """Return the scenario that a run was made with, with some keys changed."""
    if (why := no_file(folder.scenario)) and why != ABSENT:
        raise InputError(f"{folder.scenario} {why}")
    if why or not folder.scan.is_dir():
        raise InputError(
            f"{folder.path} is not a run folder; expected scenario.yaml and scan.zarr in it"
        )
    return folder.scenario_of_run(overrides)


def _with_geometry(scenario: Scenario, which: str) -> Scenario:
    section = scenario.reconstruction.model_copy(update={"geometry": which})
    return scenario.model_copy(update={"reconstruction": section})
