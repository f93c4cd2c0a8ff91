"""Run of a study, from its file to its page."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.links import no_link
from twinct.core.files.lock import sole_owner
from twinct.core.files.writing import storage_errors
from twinct.core.threads import threads
from twinct.observers import Audience, Observers, audience_of
from twinct.study.cache import Cache
from twinct.study.checking import Checker
from twinct.study.design import Design, Trial, load_study
from twinct.study.driver import Driver, Tally
from twinct.study.estimate import BYTES_IN_TABLE, Estimate, estimate, page_kind, page_parts
from twinct.study.folder import StudyFolder
from twinct.study.page import write_page
from twinct.study.results import load_results, write_results
from twinct.study.rows import Rows
from twinct.study.search import Tried, next_values, trial_of
from twinct.study.shards import Shard, merge_shards, rows_of_shards
from twinct.study.timings import TrialTimings
from twinct.workers import LocalPool, Pool
from twinct.workers.cluster import RayPool

if TYPE_CHECKING:
    from twinct.study.table import StudyTable

StudySource = str | Path | Mapping[str, Any]


@dataclass(frozen=True)
class StudyRun:
    """Result of a study.

    Attributes:
        folder: folder of the study.
        done: number of finished trials.
        failed: number of failed trials.
        problem: message of the first failed trial, if any.
    """

    folder: StudyFolder
    done: int
    failed: int
    problem: str = ""

    @property
    def results(self) -> StudyTable:
        """Table of the results; see ``twinct.load_results``."""
        return load_results(self.folder.path)

    def __repr__(self) -> str:
        """Return folder and number of trials in one line."""
        return f"StudyRun({str(self.folder.path)!r}, {self.done} done, {self.failed} failed)"

    def _repr_html_(self) -> str:
        """Return the first figure over each axis, its means and the page, for a notebook."""
        from twinct.study.notebook import study_in_notebook  # pandas

        return study_in_notebook(self.folder.path.name, self.results, self.folder.page)


@dataclass(frozen=True)
class DryRun:
    """Preview of a study.

    Attributes:
        trials: trials that it would run, without existing ones; for a search, of its first batch.
        there: number of existing trials; for a search, of its first batch.
        total: number of trials of the whole study.
        estimate: estimated resources of ``trials``.
    """

    trials: Sequence[Trial]
    there: int
    total: int
    estimate: Estimate


def run_study(
    source: StudySource,
    out: str | Path,
    *,
    address: str | None = None,
    jobs: int | None = None,
    memory_bytes: int | None = None,
    resume: bool = False,
    retry: bool = False,
    shard: str | None = None,
    tell: Callable[[Tally], None] | None = None,
    observers: Observers = (),
) -> StudyRun:
    """Run a study; every trial gets a row, even if workers die.

    Args:
        source: the study's file, or its content as plain data.
        out: folder for the results.
        address: address of Ray: ``auto``, HOST:PORT, or ``local`` to start Ray on this machine;
            None: a pool of local processes.
        jobs: number of concurrent trials on this machine; by default all its threads are used.
        memory_bytes: memory limit of all trials together; by default this machine's memory.
        resume: continue or extend an existing study.
        retry: run failed trials again.
        shard: ``2/4``: run the second of four parts, in a folder of its own; ``merge_study`` joins
            them.
        tell: called at each change.
        observers: notified of the stages before the first trial.

    Raises:
        InputError: a problem detected before work starts; nothing has been written.
        FolderInUseError: another process works in the folder.
        TwinctError: a failure during the work; all rows are stored.
    """
    require("study")
    design, folder = load_study(source), StudyFolder(Path(out))
    study = design.study
    part = None if shard is None else Shard.parse(shard)
    if part and study.search:
        raise InputError(
            f"shard {shard}: a search has no shards, as each batch needs the one before"
        )
    with audience_of(observers) as audience:
        folder.check(design, resume=resume)
        checker = Checker(design)
        trials = _first_trials(design, checker, audience)
    if part and not (trials := part.part(trials)):
        raise InputError(f"shard {shard}: the study has fewer scans than shards, none for this one")
    with ExitStack() as stack:
        name = folder.name
        pool = _pool(folder, name, study.threads, address, jobs, memory_bytes)
        stack.callback(pool.close)
        stack.enter_context(storage_errors(folder.path))
        folder.path.mkdir(parents=True, exist_ok=True)
        stack.enter_context(sole_owner(folder.lock))
        stack.enter_context(_logged_to(folder.log))
        folder.claim(design, name)
        _remove_pickles(folder, observers)
        rows = Rows(folder, study)
        if study.search is None:
            rows.renumbered({one.key: one.number for one in trials})
        total = len(design.seeds) * study.search.trials if study.search else len(trials)
        driver = Driver(design, folder, rows, pool, tell or (lambda _: None), total)
        with _concluded(driver):
            if study.search:
                _search(design, checker, driver, retry)
            else:
                driver.run(trials, retry=retry)
        status = list(rows.status.values())
    return StudyRun(folder, status.count("done"), status.count("failed"), rows.first_problem)


def merge_study(
    source: StudySource,
    out: str | Path,
    shards: Sequence[str | Path],
    *,
    observers: Observers = (),
) -> StudyRun:
    """Join the shards of a study in one folder, with its table and page.

    The shards stay. Trials that none of them has are named in a message; ``run_study`` with
    ``resume`` runs them.

    Args:
        source: the study's file, or its content as plain data.
        out: folder for the whole study, which may hold a part of it already.
        shards: folders of ``run_study`` with ``shard``.
        observers: notified of missing trials.

    Raises:
        InputError: a folder holds another study, trials of another scenario, or none.
        FolderInUseError: another process works in the folder.
    """
    require("study")
    began, design, folder = time.monotonic(), load_study(source), StudyFolder(Path(out))
    parts = [StudyFolder(Path(path)) for path in shards]
    with audience_of(observers) as audience:
        for one in (folder, *parts):
            one.check(design, resume=True)
        trials = _first_trials(design, Checker(design), audience)
        rows_of_shards(trials, parts)
        with ExitStack() as stack:
            stack.enter_context(storage_errors(folder.path))
            folder.path.mkdir(parents=True, exist_ok=True)
            stack.enter_context(sole_owner(folder.lock))
            folder.claim(design, folder.name)
            rows = Rows(folder, design.study)
            missing = merge_shards(trials, parts, folder, rows)
            _conclude(design, folder, rows, len(trials), time.monotonic() - began)
        if missing:
            audience.say(
                f"{len(missing)} of {len(trials)} trials are in no shard, such as {missing[0]}; "
                "--resume runs them"
            )
    status = list(rows.status.values())
    return StudyRun(folder, status.count("done"), status.count("failed"), rows.first_problem)


def _remove_pickles(folder: StudyFolder, observers: Observers) -> None:
    if Cache(folder.work).remove_pickles():
        with audience_of(observers) as audience:
            audience.say(
                f"{folder.work}: an earlier twinct cached pickles there, which can run code; they "
                "are removed unread, and made again as plain data"
            )


@contextmanager
def _concluded(driver: Driver) -> Iterator[None]:
    """Close the pool after the trials, and write the results, also of an interrupted study."""
    began, total, rows = time.monotonic(), driver.total, driver.rows
    try:
        yield
    except BaseException as error:
        try:
            driver.pool.close()
        finally:
            Cache(driver.folder.work).remove_locks()
        if isinstance(error, KeyboardInterrupt):
            note = f"{driver.folder.path} keeps {len(rows.status)} of {total} trials"
            error.add_note(f"{note}; --resume continues")
        raise
    else:
        driver.pool.close(clear=True)
    finally:
        _conclude(driver.design, driver.folder, rows, driver.total, time.monotonic() - began)
    driver.record_overhead(time.monotonic() - began)


def dry_run(
    source: StudySource,
    out: str | Path | None = None,
    *,
    jobs: int | None = None,
    retry: bool = False,
    time: bool = False,
    observers: Observers = (),
) -> DryRun:
    """Check a study and return a preview; for a search, of its first batch.

    With ``time``, small scans of each kind of trials measure its time, unless it is known.

    Raises:
        InputError: a problem that is detected before work starts.
    """
    design = load_study(source)
    with audience_of(observers) as audience:
        folder = StudyFolder(Path(out)) if out is not None else None
        if folder is not None:
            folder.check(design, resume=True)
        trials = _first_trials(design, Checker(design, time), audience)
    there = Rows(folder, design.study) if folder else None
    open_ = [one for one in trials if there is None or there.wanted(one.key, retry=retry)]
    workers = jobs or _workers(design.study.threads)
    preview = estimate(design.study, open_, workers, TrialTimings.open())
    search = design.study.search
    total = search.trials * len(design.seeds) if search else len(trials)
    return DryRun(open_, len(trials) - len(open_), total, preview)


def _first_trials(design: Design, checker: Checker, audience: Audience) -> list[Trial]:
    """Check and return all trials of the axes, or the first batch of a search."""
    study = design.study
    place = design.at("max_trials", "axes", "search", "repetitions")
    if study.search is None:
        trials = list(itertools.islice(design.trials(), study.max_trials + 1))
        if len(trials) > study.max_trials:
            raise InputError(
                f"{place}the study has more than {study.max_trials} trials (max_trials): raise "
                "it, or use fewer values"
            )
        return checker.checked(trials, audience)
    if (number := study.search.trials * len(design.seeds)) > study.max_trials:
        raise InputError(
            f"{place}the search has {number} trials, more than max_trials {study.max_trials}"
        )
    return checker.checked(_repeated(design, next_values(study.search, []), 0), audience)


def _search(design: Design, checker: Checker, driver: Driver, retry: bool) -> None:
    """Request and run batches until all sets of values are tried; reuse existing rows.

    A set that the search repeats is not run again: its single row counts each time.
    """
    search = design.study.search
    tried: list[Tried] = []
    known: dict[str, int] = {}
    assert search is not None
    while len(tried) < search.trials:
        values = next_values(search, tried)
        keys: dict[int, str] = {}
        trials: list[Trial] = []
        for trial in _repeated(design, values, len(tried)):
            try:
                one = checker.one(trial)
                key = one.key
            except InputError as error:
                one, key = None, driver.rows.refused(trial, error)
            keys[trial.number] = key
            if key in known:
                driver.total -= 1
            elif one is not None and driver.rows.wanted(key, retry=retry):
                trials.append(one)
            known.setdefault(key, trial.number)
        driver.run(trials, retry=retry)
        figures = driver.rows.figures(search.figure)
        for chosen in values:
            first = len(tried) * len(design.seeds)
            of_seeds = [figures.get(keys[first + n]) for n in range(len(design.seeds))]
            known_figures = [figure for figure in of_seeds if figure is not None]
            tried.append(
                (chosen, sum(known_figures) / len(known_figures) if known_figures else None)
            )
    driver.rows.renumbered(known)
    driver.say()


def _repeated(design: Design, values: Sequence[Mapping[str, Any]], first: int) -> Iterator[Trial]:
    """Yield the trials of sets of values, numbered from the set ``first``."""
    search, seeds = design.study.search, len(design.seeds)
    assert search is not None
    for number, chosen in enumerate(values, first):
        yield from design.repeated(number * seeds, trial_of(search, chosen))


def _pool(
    folder: StudyFolder,
    name: str,
    threads_each: int,
    address: str | None,
    jobs: int | None,
    memory_bytes: int | None,
) -> Pool:
    if address is None:
        workers = jobs or _workers(threads_each)
        return LocalPool(
            folder.work, workers=workers, threads=threads_each, memory_bytes=memory_bytes
        )
    return RayPool(
        address, name=name, threads=threads_each, workers=jobs, memory_bytes=memory_bytes
    )


def _workers(threads_each: int) -> int:
    return max(threads() // threads_each, 1)


def _conclude(
    design: Design, folder: StudyFolder, rows: Rows, total: int, wall_seconds: float
) -> None:
    """Write table and page of all existing rows, also after an interruption."""
    of_trials = rows.all()
    if not of_trials:
        return
    write_results(folder.path, of_trials)
    write_page(folder, design, of_trials, total, wall_seconds)
    timings = TrialTimings.open()
    timings.add("row bytes", folder.journal.stat().st_size / len(of_trials))
    table = folder.results.stat().st_size - BYTES_IN_TABLE * len(of_trials)
    timings.add("table bytes", max(table, 0))
    parts = page_parts(len({repr(row.axes) for row in of_trials}))
    timings.add(page_kind(design.study), folder.page.stat().st_size / parts)
    timings.write()


@contextmanager
def _logged_to(path: Path) -> Iterator[None]:
    """Write the package's log messages to a file for the duration of a block."""
    with open(path, "a", encoding="utf-8", opener=no_link) as stream:
        handler = logging.StreamHandler(stream)
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        logger = logging.getLogger("twinct.study")
        logger.addHandler(handler)
        propagate, logger.propagate = logger.propagate, False
        try:
            yield
        finally:
            logger.removeHandler(handler)
            logger.propagate = propagate
            handler.close()
