"""Further geometries and reconstructions of a finished run."""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Iterable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.files.lock import sole_owner
from twinct.core.files.writing import remove_folder, storage_errors
from twinct.core.interruption import keeping
from twinct.observers import Audience, Observers, audience_of
from twinct.recon.volume import Volume
from twinct.report import algorithm_results
from twinct.runs.checks import check_corrections
from twinct.runs.folder import Folder, read_metrics, refuse_other_keys
from twinct.runs.job import Run, finished_run, rewrite_report, scan_of
from twinct.runs.judging import ByTruth, WithoutTruth, judge_of
from twinct.runs.log import logged_to
from twinct.runs.reconstruction_folder import (
    StoredReconstruction,
    free_name,
    reconstruction_base,
    stored_reconstructions,
)
from twinct.runs.reporting import write_volumes
from twinct.runs.stages import Stage, make_due
from twinct.runs.volumes import reconstruct, require_feasible
from twinct.scan import (
    NamedGeometry,
    Scan,
    ScanStore,
    checked_name,
    free_geometry_name,
    scenario_in,
    store_geometries,
)
from twinct.scenario.imported import ScanSettings

log = logging.getLogger(__name__)


@kinds_checked
def load_scan(path: str | Path) -> Scan:
    """Load a finished scan from a scan.zarr, or from a run's folder with its derived geometries.

    Raises:
        InputError: there is no scan, or it is damaged.
        ScanExistsError: some views are not acquired yet.
    """
    folder = Folder(Path(path))
    if (folder.path / "zarr.json").is_file():
        return ScanStore(folder.path).read()
    return scan_of(folder, _settings_of(folder))


@kinds_checked
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
    scenario = scenario_in(_settings_of(folder, overrides))
    free_geometry_name(name)
    with (
        sole_owner(folder.lock),
        audience_of(observers) as audience,
        audience.stage(f"geometry {name}", 1) as step,
    ):
        scan = Run(scenario, folder).scan
        poses = scan.simulated.with_settings(scenario).reported_as(name)
        store_geometries([(poses, folder.geometries)])
        step()
    return poses


@kinds_checked
def reconstruct_run(
    path: str | Path,
    overrides: Iterable[str] = (),
    *,
    geometry: str | None = None,
    name: str | None = None,
    halves: bool = False,
    observers: Observers = (),
) -> StoredReconstruction:
    """Add a reconstruction to a scan's folder, and update its figures and its report.

    An identical reconstruction is not computed again: the existing one is returned, and shown in
    the report if an interruption had prevented that.

    Args:
        path: folder of a finished run, or of an imported scan.
        overrides: changes ``reconstruction.KEY=VALUE`` to the settings of the scan.
        geometry: geometry to reconstruct from; None: the first that the settings name.
        name: name of the reconstruction; None: named after its algorithm and geometry.
        halves: without a truth, also reconstruct the even and the odd views, for the noise; it
            doubles the time.
        observers: notified of stages and iterations.

    Raises:
        InputError: a key of another section, an unknown geometry, settings that the algorithm
            refuses, too little memory, or halves of a scan with a truth; nothing is written in that
            case.
        ScanExistsError: the name is taken, or the same reconstruction has another name.
    """
    folder, overrides = Folder(Path(path)), tuple(overrides)
    refuse_other_keys(overrides, "reconstruction")
    if name is not None:
        checked_name(name)
    settings = _settings_of(folder, overrides)
    has_truth = settings.specimen is not None
    if has_truth:
        finished_run(folder)
        if halves:
            raise InputError("--halves: only for a measured scan; this scan is simulated")
    which = geometry or settings.reconstruction.geometries[0]
    section = settings.reconstruction.model_copy(update={"geometry": which})
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        stack.enter_context(storage_errors(folder.path))
        stack.enter_context(sole_owner(folder.lock))
        scan = scan_of(folder, settings.model_copy(update={"reconstruction": section}))
        scan.poses(which)
        stored = stored_reconstructions(folder.reconstructions)
        of_geometry = scan.derived[which].digest if which in scan.derived else ""
        digest = scan.provenance.volume_digest(ScanStore(folder.scan).digests["images"])
        digest += of_geometry + ("halves" if halves else "")
        digest = hashlib.sha256(digest.encode()).hexdigest()
        if there := next((r for r in stored.values() if r.digest == digest), None):
            if name not in (None, there.name):
                raise ScanExistsError(f"{there.path} already holds this reconstruction; omit --as")
            audience.say(f"{there.path} already holds this reconstruction")
            name = there.name
        else:
            name = free_name(name, reconstruction_base(scan, which), folder.reconstructions)
        path = folder.reconstructions / name

        def make() -> None:
            stack.enter_context(logged_to(folder.log))
            log.info("reconstruction %s: %s", name, section.in_words)
            judge = judge_of(scan, folder, audience, halves=halves)
            made, volume = _made(scan, judge, path, (digest, which, of_geometry), folder, audience)
            made.keep(volume)
            remove_folder(folder.checkpoints)

        volume = Stage("volume", digest, (path,), lambda: StoredReconstruction.read(path).digest)
        results = folder.metrics, folder.report
        page = Stage("report", digest, results, partial(_reported_from, folder, name))
        make_due([volume], {"volume": make})
        if not has_truth:  # no volume of a run is judged again
            make_due([page], {"report": partial(write_volumes, folder, scan)})
            return StoredReconstruction.read(path)
    with keeping(lambda: f"{path} is kept; the same command completes the report"):
        make_due([page], {"report": lambda: rewrite_report(folder.path, observers)})
    return StoredReconstruction.read(path)


def _reported_from(folder: Folder, name: str) -> str | None:
    """Return the digest of a reconstruction that the figures, which are written last, name."""
    return read_metrics(folder.metrics).get("reconstructions", {}).get(name, {}).get("digest")


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
    scan: Scan,
    judge: ByTruth | WithoutTruth,
    path: Path,
    of: tuple[str, str, str],
    folder: Folder,
    audience: Audience,
) -> tuple[StoredReconstruction, Volume]:
    settings, (digest, which, of_geometry) = scan.settings, of
    check_corrections(settings)
    require_feasible(settings, scan.provenance.first.geometry(settings.detector.panel))
    volume, residuals, seconds = timed_volume(scan, folder, which, audience)
    reconstruction = StoredReconstruction(
        name=path.name,
        digest=digest,
        geometry=which,
        geometry_digest=of_geometry,
        in_words=settings.reconstruction.in_words,
        settings=settings.reconstruction.model_dump(mode="json"),
        figures=judge.figures(volume, which),
        residuals=residuals,
        seconds=seconds,
        slices=judge.slices(volume),
        path=path,
        results=algorithm_results(volume.extras),
    )
    return reconstruction, volume


def _settings_of(folder: Folder, overrides: tuple[str, ...] = ()) -> ScanSettings:
    """Return the settings that a scan was made with, with some keys changed."""
    if (why := no_file(folder.scenario)) and why != ABSENT:
        raise InputError(f"{folder.scenario} {why}")
    if why or not folder.scan.is_dir():
        raise InputError(
            f"{folder.path} is not a run folder; expected scenario.yaml and scan.zarr in it"
        )
    return folder.settings_of_scan(overrides)
