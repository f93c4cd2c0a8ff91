"""Integrity checks of all files in the folder of a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.recon.volume import Volume
from twinct.runs.folder import Folder, read_metrics
from twinct.runs.job import finished_run
from twinct.runs.reconstruction_folder import check_files
from twinct.scan import NamedGeometry, ScanStore, frame_damage, unknown_files, view_damage
from twinct.scan.status import views_taken
from twinct.scan.sweeps import SWEEPS


@dataclass(frozen=True)
class Verdict:
    """Result of ``verify``.

    Attributes:
        problems: one sentence each, with the file, or view and array.
        unknown: foreign files in the store; they do no harm.
        in_words: the extent of the check.
    """

    problems: tuple[str, ...]
    unknown: tuple[Path, ...]
    in_words: str


@kinds_checked
def verify(path: str | Path) -> Verdict:
    """Check each file of a scan store, and all results made from it.

    Args:
        path: folder of a run, or a scan store.

    Raises:
        InputError: the path is neither.
    """
    folder = Folder(Path(path))
    store = folder.scan if folder.scan.is_dir() else folder.path
    if not (store / "status").is_dir() and not (store / "zarr.json").is_file():
        raise InputError(f"{path} is neither a run folder nor a scan.zarr")
    of_all, of_views = frame_damage(store), view_damage(store)
    problems = [f"{store}: {damage}" for damage in (*of_all, *of_views)]
    looked_at = "its views"
    scan = None
    if not of_all:
        try:
            scan = ScanStore(store)
            _ = scan.settings, scan.plan, scan.commanded
        except InputError as error:
            problems += (p if str(store) in p else f"{store}: {p}" for p in error.problems)
    if scan is not None and all(damage.file != SWEEPS for damage in of_views):
        taken = len(views_taken(store))
        looked_at = f"{taken} of {scan.views} views"
        if not of_views and taken < scan.views:
            problems.append(f"{store}: {looked_at}: the scan is not finished")
        if not scan.vouched:
            looked_at += (
                ", in an older format without digests: only missing or truncated files are found"
            )
            problems += _undecodable(scan)
    if store == folder.scan:
        problems += _of_results(folder)
        if not problems and folder.metrics.exists():
            problems += _not_of_run(folder)
    unknown = tuple(store / file for file in unknown_files(store))
    return Verdict(tuple(problems), unknown, looked_at)


def _undecodable(scan: ScanStore) -> list[str]:
    problems: list[str] = []
    for view in sorted(views_taken(scan.path)):
        try:
            scan.transmission(view)
        except (ValueError, RuntimeError, OSError, InputError) as error:
            problems.append(f"{scan.path}: view {view}, transmission: {error}")
    return problems


def _of_results(folder: Folder) -> list[str]:
    """Return the problems of all existing results beside the store."""
    named = folder.geometries.glob("[!.]*.json")
    made = folder.reconstructions.glob("[!.]*/")
    checks: list[tuple[Callable[[Path], object], Path]] = [
        *((NamedGeometry.read, file) for file in sorted(named)),
        *((check_files, path) for path in sorted(made)),
        *((Volume.read, file) for file in (folder.volume, folder.truth) if file.exists()),
        *((read_metrics, file) for file in (folder.metrics,) if file.exists()),
    ]
    problems: list[str] = []
    for check, path in checks:
        try:
            check(path)
        except InputError as error:
            problems += error.problems
    return problems


def _not_of_run(folder: Folder) -> list[str]:
    """Return the readable results that are not those of the run."""
    if "image" not in read_metrics(folder.metrics):  # of a measured scan, which has no truth
        return []
    try:
        finished_run(folder)
        return list(folder.replaced())
    except InputError as error:
        return list(error.problems)
