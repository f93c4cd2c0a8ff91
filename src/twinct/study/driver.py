"""Execution of a study on a pool: trials without duplicates, their results in the journal."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from twinct.scenario import Scenario
from twinct.scenario.digests import readers
from twinct.study.design import Design, Trial
from twinct.study.estimate import bytes_below
from twinct.study.folder import StudyFolder
from twinct.study.inputs import Inputs
from twinct.study.rows import Rows
from twinct.study.timings import TrialTimings
from twinct.study.trial import START, TrialSpec, scan_name, take_scan, try_trial
from twinct.workers import Done, Failed, Pool, Work

log = logging.getLogger(__name__)

_SCAN = "scan "
"""Prefix of the keys of work that acquires a shared scan."""


@dataclass(frozen=True)
class Tally:
    """Progress of a study.

    Attributes:
        done: number of finished trials, earlier runs included.
        failed: number of failed trials.
        running: number of trials and scans that the pool works on.
        total: number of trials of the study.
        left_s: estimated seconds until the end; None before the first result.
    """

    done: int
    failed: int
    running: int
    total: int
    left_s: float | None


@dataclass
class Driver:
    """One study on one pool.

    Attributes:
        design: the study.
        folder: folder of the study.
        rows: rows of its journal.
        pool: workers of the study.
        tell: called at each change.
        total: number of trials of the study, as far as they are known.
    """

    design: Design
    folder: StudyFolder
    rows: Rows
    pool: Pool
    tell: Callable[[Tally], None]
    total: int
    _timings: TrialTimings = field(default_factory=TrialTimings.open)
    _began: float = field(default_factory=time.monotonic)
    _ended: int = 0
    _busy_s: float = 0.0

    def __post_init__(self) -> None:
        self._inputs = Inputs(self.folder.inputs)
        self._scans: dict[str, _SharedScan] = {}
        self._twins: dict[str, list[Trial]] = {}
        self._running = 0
        self._slots = 1  # cached, as the pool may be closed when it is needed

    def run(self, trials: Sequence[Trial], *, retry: bool = False) -> None:
        """Run all trials that have no row yet; on return, each trial has a row.

        Args:
            trials: the trials.
            retry: run failed trials again.

        Raises:
            TwinctError: the pool is lost, or the folder cannot be written.
        """
        self._slots = max(self.pool.slots, 1)
        firsts = self._without_twins(trials, retry)
        self._share(firsts)
        by_key = {one.key: one for one in firsts}
        released: deque[Trial] = deque()
        for event in self.pool.results(self._works(firsts, released)):
            self._running -= 1
            if event.key.startswith(_SCAN):
                released.extend(self._scanned(event.key.removeprefix(_SCAN), event))
            else:
                self._tried(by_key[event.key], event)
            self.say()
        self._timings.write()

    def _works(self, trials: Sequence[Trial], released: deque[Trial]) -> Iterator[Work | None]:
        """Yield the next work for the pool, or None while all remaining trials wait for scans."""
        waiting = iter(trials)
        while True:
            one = released.popleft() if released else next(waiting, None)
            if one is not None:
                if (work := self._work(one)) is not None:
                    self._running += 1
                    self.say()
                    yield work
            elif any(scan.waiting for scan in self._scans.values()):
                yield None
            else:
                return

    def _without_twins(self, trials: Sequence[Trial], retry: bool) -> list[Trial]:
        """Return one trial for each new volume; the other trials get its figures later."""
        wanted = [one for one in trials if self.rows.wanted(one.key, retry=retry)]
        if self.design.study.keep == "everything" or not wanted:
            return wanted
        there = {row.key: row for row in self.rows.all() if row.status == "done"}
        volumes = {one.volume: there[one.key] for one in trials if one.key in there}
        firsts: list[Trial] = []
        for one in wanted:
            if one.volume in volumes:
                self.rows.copied(one, volumes[one.volume])
            elif one.volume in self._twins:
                self._twins[one.volume].append(one)
            else:
                self._twins[one.volume] = []
                firsts.append(one)
        return firsts

    def _share(self, trials: Sequence[Trial]) -> None:
        """Register the scans that several trials share, and offer existing ones to the pool."""
        search = self.design.study.search
        keys = [key for d in search.keys for key in d.keys] if search else []
        later = bool(keys) and not any({*readers(key)} & _BEFORE_IMAGES for key in keys)
        for digest, number in Counter(one.scan for one in trials).items():
            path = self.folder.scans / digest[:32]
            if number > 1 or later or path.exists():
                shared = self._scans.setdefault(digest, _SharedScan())
                shared.wanted += number
                if path.exists() and not shared.there:
                    shared.there = True
                    self.pool.offer(scan_name(digest), path)

    def _work(self, one: Trial) -> Work | None:
        """Return the next work of a trial; None if it waits for a scan, or the scan has failed."""
        shared = self._scans.get(one.scan)
        if shared is None or shared.there:
            return self._trial_work(one, shared is not None)
        if shared.failed is not None:
            self._fail([one], shared.failed)
            return None
        shared.waiting.append(one)
        if len(shared.waiting) > 1:
            return None
        spec = self.spec(one, shared=True)
        names = tuple(name for name, _ in spec.files.values())
        memory = max(one.cost.stages[stage].memory_bytes for stage in _OF_SCAN)
        return Work(_SCAN + one.scan, take_scan, spec, memory, names)

    def _trial_work(self, one: Trial, shared: bool) -> Work:
        spec = self.spec(one, shared=shared)
        names = [name for name, _ in spec.files.values()]
        names += [spec.scan_name] if shared else []
        return Work(one.key, try_trial, spec, one.cost.memory_bytes, tuple(names))

    def spec(self, one: Trial, *, shared: bool) -> TrialSpec:
        """Return a trial in the form sent to workers; ``shared``: other trials use its scan."""
        scenario: Scenario = self.design.scenario(one)
        values = str(one).partition(" (")[2].removesuffix(")")  # its number may change
        name = f"{self.design.study.name}: {values}" if values else self.design.study.name
        scenario = scenario.model_copy(update={"name": name})
        return TrialSpec(
            key=one.key,
            scenario=scenario.model_dump(mode="json"),
            files=self._inputs.offered(scenario.files(), self.pool),
            scan=one.scan,
            shared=shared,
            keep=self.design.study.keep,
            link=self.design.study.link,
        )

    def _scanned(self, digest: str, event: Done | Failed) -> list[Trial]:
        """Store a shared scan and return the trials that waited for it; none if it failed."""
        shared = self._scans[digest]
        waiting, shared.waiting = shared.waiting, []
        if isinstance(event, Failed):
            shared.failed = event
            self._fail(waiting, event)
            return []
        path = self.folder.scans / digest[:32]
        self.pool.save(event, "scan", path)
        self.pool.offer(scan_name(digest), path)
        shared.there = True
        shared.seconds = event.value
        self._count(waiting[0].cost.scan, sum(event.value.values()) - event.value.get(START, 0.0))
        self._timings.add(f"{waiting[0].cost.scan} bytes", bytes_below([path]))
        return waiting

    def _tried(self, one: Trial, event: Done | Failed) -> None:
        if isinstance(event, Failed):
            self._fail([one], event)
        else:
            report = ""
            artifact, name = {
                "everything": ("run", f"trials/{one.key}"),
                "volume": ("volume", f"trials/{one.key}.nii"),
            }.get(self.design.study.keep, ("", ""))
            if artifact:
                self.pool.save(event, artifact, self.folder.path / name)
                report = f"{name}/report.html" if artifact == "run" else name
            shared = self._scans.get(one.scan)
            before = shared.take_seconds() if shared else {}
            row = self.rows.done(one, event, before, report)
            for twin in self._twins.pop(one.volume, ()):
                self.rows.copied(twin, row)
            self._count_trial(one, event, self.folder.path / name if artifact else None)
            self._ended += 1
            self._leave(one)

    def record_overhead(self, wall_s: float) -> None:
        """Record the time of a study beside its trials: start of workers, table, page."""
        if self._ended:
            timings = TrialTimings.open()
            busy_s = self._busy_s / min(self._slots, self._ended)
            timings.add("seconds around", max(wall_s - busy_s, 0.0))
            timings.write()

    def _count(self, kind: str, seconds: float) -> None:
        self._busy_s += seconds
        self._timings.add(kind, seconds)

    def _count_trial(self, one: Trial, event: Done, folder: Path | None) -> None:
        """Record seconds and bytes of a trial; count its own scan separately."""
        spent, scan_s = event.value["seconds"], 0.0
        if one.scan not in self._scans:
            scan_s = sum(spent.get(stage, 0.0) for stage in _SCAN_STAGES)
            self._count(one.cost.scan, scan_s)
        self._count(one.cost.rest, spent["total"] - scan_s)
        self._timings.add(f"{one.cost.rest} sections bytes", len(event.value["sections"]))
        scan_bytes = event.value.get("scan_bytes", 0)
        if folder is not None:
            scan_bytes = bytes_below([folder / "scan.zarr"])
            self._timings.add(f"{one.cost.rest} bytes", bytes_below([folder]) - scan_bytes)
        if scan_bytes:
            self._timings.add(f"{one.cost.scan} bytes", scan_bytes)

    def _fail(self, trials: Sequence[Trial], event: Failed) -> None:
        twins = [twin for one in trials for twin in self._twins.pop(one.volume, ())]
        self.rows.failed([*trials, *twins], event)
        self._ended += len(trials)
        for one in trials:
            self._leave(one)
        log.warning("%s: %s: %s", trials[0], event.kind, "; ".join(event.problems))
        if event.trace:
            log.warning(event.trace)

    def _leave(self, one: Trial) -> None:
        shared = self._scans.get(one.scan)
        if shared is not None:
            shared.wanted -= 1
            if not shared.wanted:
                self.pool.withdraw(scan_name(one.scan))
                del self._scans[one.scan]

    def say(self) -> None:
        """Report the progress."""
        counts = Counter(self.rows.status.values())
        left, running = self.total - len(self.rows.status), min(self._running, self._slots)
        spent = time.monotonic() - self._began
        left_s = spent / self._ended * left if self._ended else None
        self.tell(Tally(counts["done"], counts["failed"], running, self.total, left_s))


_BEFORE_IMAGES = {"surface", "plan", "executed", "images"}
_OF_SCAN = ("specimen", "plan", "views")
_SCAN_STAGES = ("scan", "plan", "motion", "xray", "storing", "link")
"""Stages that belong to a scan; all but the first two are stages of ``twinct.run``."""


@dataclass
class _SharedScan:
    """A scan that several trials share.

    Attributes:
        wanted: number of trials that have not ended yet.
        there: True once the scan is stored.
        waiting: trials that wait for the scan.
        failed: failure of the scan, if any.
        seconds: seconds of the scan, until they are assigned to a row.
    """

    wanted: int = 0
    there: bool = False
    waiting: list[Trial] = field(default_factory=list[Trial])
    failed: Failed | None = None
    seconds: dict[str, float] = field(default_factory=dict[str, float])

    def take_seconds(self) -> dict[str, float]:
        """Return the seconds, and clear them so that they count once."""
        seconds, self.seconds = self.seconds, {}
        return seconds
