"""Runs a study: gives trials to a pool, each thing once, and journals what comes back."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from twinct.pool import Done, Failed, Pool, Work, each
from twinct.scenario import Scenario
from twinct.scenario.digests import readers
from twinct.study.book import Book
from twinct.study.checking import Checked
from twinct.study.design import Design
from twinct.study.estimate import bytes_below
from twinct.study.folder import StudyFolder
from twinct.study.inputs import Inputs
from twinct.study.rows import Rows
from twinct.study.taking import START, Errand, scan_name, take_scan, try_trial

log = logging.getLogger(__name__)

_SCAN = "scan "
"""How keys of work that takes a shared scan begin."""


@dataclass(frozen=True)
class Tally:
    """How far a study is.

    Attributes:
        done: trials that came to their end, those of before included.
        failed: trials that cannot be had.
        running: trials and scans that the pool has.
        total: trials of the study.
        left_s: seconds until the end, as far as it can be told.
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
        folder: its own.
        rows: its journal.
        pool: what works.
        tell: hears of each change.
        total: trials of the study, as far as they are known.
    """

    design: Design
    folder: StudyFolder
    rows: Rows
    pool: Pool
    tell: Callable[[Tally], None]
    total: int
    _book: Book = field(default_factory=Book.open)
    _began: float = field(default_factory=time.monotonic)
    _ended: int = 0
    _busy_s: float = 0.0

    def __post_init__(self) -> None:
        self._inputs = Inputs(self.folder.inputs)
        self._scans: dict[str, _SharedScan] = {}
        self._twins: dict[str, list[Checked]] = {}
        self._running = 0
        self._slots = 1  # of the pool when it was last given work: it may be closed by now

    def run(self, trials: Sequence[Checked], *, retry: bool = False) -> None:
        """Try those of some trials that have no row yet; each has one when this returns.

        Args:
            trials: which.
            retry: try failed ones again.

        Raises:
            TwinctError: the pool is lost, or the folder cannot be written.
        """
        self._slots = max(self.pool.slots, 1)
        firsts = self._without_twins(trials, retry)
        self._share(firsts)
        by_key = {one.key: one for one in firsts}
        released: deque[Checked] = deque()
        for event in each(self.pool, self._works(firsts, released)):
            self._running -= 1
            if event.key.startswith(_SCAN):
                released.extend(self._scanned(event.key.removeprefix(_SCAN), event))
            else:
                self._tried(by_key[event.key], event)
            self.say()
        self._book.write()

    def _works(self, trials: Sequence[Checked], released: deque[Checked]) -> Iterator[Work | None]:
        """What the pool shall do next; None while all that is left waits for scans."""
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

    def _without_twins(self, trials: Sequence[Checked], retry: bool) -> list[Checked]:
        """One trial of each volume that is not there; the others get its figures in the end."""
        wanted = [one for one in trials if self.rows.wanted(one.key, retry=retry)]
        if self.design.study.keep == "everything" or not wanted:
            return wanted
        there = {row.key: row for row in self.rows.all() if row.status == "done"}
        volumes = {one.volume: there[one.key] for one in trials if one.key in there}
        firsts: list[Checked] = []
        for one in wanted:
            if one.volume in volumes:
                self.rows.copied(one, volumes[one.volume])
            elif one.volume in self._twins:
                self._twins[one.volume].append(one)
            else:
                self._twins[one.volume] = []
                firsts.append(one)
        return firsts

    def _share(self, trials: Sequence[Checked]) -> None:
        """Find the scans that several trials have in common."""
        search = self.design.study.search
        keys = [key for d in search.keys for key in d.keys] if search else []
        later = bool(keys) and not any({*readers(key)} & _BEFORE_IMAGES for key in keys)
        for digest, number in Counter(one.scan for one in trials).items():
            kept = self.folder.scans / digest[:32]
            if number > 1 or later or kept.exists():
                shared = self._scans.setdefault(digest, _SharedScan())
                shared.wanted += number
                if kept.exists() and not shared.there:
                    shared.there = True
                    self.pool.offer(scan_name(digest), kept)

    def _work(self, one: Checked) -> Work | None:
        """What a trial asks for now; None where that is another's to bring, or has failed."""
        shared = self._scans.get(one.scan)
        if shared is None or shared.there:
            return self._trial_work(one, shared is not None)
        if shared.failed is not None:
            self._fail([one], shared.failed)
            return None
        shared.waiting.append(one)
        if len(shared.waiting) > 1:
            return None
        errand = self.errand(one, shared=True)
        names = tuple(name for name, _ in errand.files.values())
        memory = max(one.cost.stages[stage].memory_bytes for stage in _OF_SCAN)
        return Work(_SCAN + one.scan, take_scan, errand, memory, names)

    def _trial_work(self, one: Checked, shared: bool) -> Work:
        errand = self.errand(one, shared=shared)
        names = [name for name, _ in errand.files.values()]
        names += [errand.scan_name] if shared else []
        return Work(one.key, try_trial, errand, one.cost.memory_bytes, tuple(names))

    def errand(self, one: Checked, *, shared: bool) -> Errand:
        """A trial as it travels; ``shared``: its scan is another trial's, too."""
        scenario: Scenario = self.design.scenario(one.trial)
        told = str(one.trial).partition(" (")[2].removesuffix(")")  # its number may become another
        name = f"{self.design.study.name}: {told}" if told else self.design.study.name
        scenario = scenario.model_copy(update={"name": name})
        return Errand(
            key=one.key,
            scenario=scenario.model_dump(mode="json"),
            files=self._inputs.offered(scenario, self.pool),
            scan=one.scan,
            shared=shared,
            keep=self.design.study.keep,
            link=self.design.study.link,
        )

    def _scanned(self, digest: str, event: Done | Failed) -> list[Checked]:
        """Trials that may go on now that their scan is there; none if it has failed."""
        shared = self._scans[digest]
        waiting, shared.waiting = shared.waiting, []
        if isinstance(event, Failed):
            shared.failed = event
            self._fail(waiting, event)
            return []
        kept = self.folder.scans / digest[:32]
        event.parcels["scan"].save(kept)
        self.pool.offer(scan_name(digest), kept)
        shared.there = True
        shared.seconds = event.value
        self._count(waiting[0].cost.scan, sum(event.value.values()) - event.value.get(START, 0.0))
        self._book.add(f"{waiting[0].cost.scan} bytes", bytes_below([kept]))
        return waiting

    def _tried(self, one: Checked, event: Done | Failed) -> None:
        if isinstance(event, Failed):
            self._fail([one], event)
        else:
            report = ""
            parcel, name = {
                "everything": ("run", f"trials/{one.key}"),
                "volume": ("volume", f"trials/{one.key}.nii"),
            }.get(self.design.study.keep, ("", ""))
            if parcel:
                event.parcels[parcel].save(self.folder.path / name)
                report = f"{name}/report.html" if parcel == "run" else name
            shared = self._scans.get(one.scan)
            before = shared.take_seconds() if shared else {}
            row = self.rows.done(one, event, before, report)
            for twin in self._twins.pop(one.volume, ()):
                self.rows.copied(twin, row)
            self._count_trial(one, event, self.folder.path / name if parcel else None)
            self._ended += 1
            self._leave(one)

    def book_around(self, wall_s: float) -> None:
        """Count what a study takes beside its trials: start of workers, table, page."""
        if self._ended:
            book = Book.open()
            busy_s = self._busy_s / min(self._slots, self._ended)
            book.add("seconds around", max(wall_s - busy_s, 0.0))
            book.write()

    def _count(self, kind: str, seconds: float) -> None:
        self._busy_s += seconds
        self._book.add(kind, seconds)

    def _count_trial(self, one: Checked, event: Done, kept: Path | None) -> None:
        """Count seconds and bytes of a trial; those of a scan that it took itself apart."""
        spent, scan_s = event.value["seconds"], 0.0
        if one.scan not in self._scans:
            scan_s = sum(spent.get(stage, 0.0) for stage in _SCAN_STAGES)
            self._count(one.cost.scan, scan_s)
        self._count(one.cost.rest, spent["total"] - scan_s)
        self._book.add(f"{one.cost.rest} sections bytes", len(event.value["sections"]))
        scan_bytes = event.value.get("scan_bytes", 0)
        if kept is not None:
            scan_bytes = bytes_below([kept / "scan.zarr"])
            self._book.add(f"{one.cost.rest} bytes", bytes_below([kept]) - scan_bytes)
        if scan_bytes:
            self._book.add(f"{one.cost.scan} bytes", scan_bytes)

    def _fail(self, trials: Sequence[Checked], event: Failed) -> None:
        twins = [twin for one in trials for twin in self._twins.pop(one.volume, ())]
        self.rows.failed([*trials, *twins], event)
        self._ended += len(trials)
        for one in trials:
            self._leave(one)
        log.warning("%s: %s: %s", trials[0].trial, event.kind, "; ".join(event.problems))
        if event.trace:
            log.warning(event.trace)

    def _leave(self, one: Checked) -> None:
        shared = self._scans.get(one.scan)
        if shared is not None:
            shared.wanted -= 1
            if not shared.wanted:
                self.pool.withdraw(scan_name(one.scan))
                del self._scans[one.scan]

    def say(self) -> None:
        """Tell how far it is."""
        counts = Counter(self.rows.status.values())
        left, running = self.total - len(self.rows.status), min(self._running, self._slots)
        spent = time.monotonic() - self._began
        left_s = spent / self._ended * left if self._ended else None
        self.tell(Tally(counts["done"], counts["failed"], running, self.total, left_s))


_BEFORE_IMAGES = {"surface", "plan", "executed", "images"}
_OF_SCAN = ("specimen", "plan", "views")
_SCAN_STAGES = ("scan", "plan", "motion", "xray", "storing", "link")
"""Stages whose seconds are of a scan; all but the first two as ``twinct.run`` tells them."""


@dataclass
class _SharedScan:
    """A scan that several trials have in common.

    Attributes:
        wanted: trials that have not ended yet.
        there: whether it has been taken.
        waiting: trials that go on once it is there.
        failed: why it cannot be taken.
        seconds: that it took, until a row tells of them.
    """

    wanted: int = 0
    there: bool = False
    waiting: list[Checked] = field(default_factory=list[Checked])
    failed: Failed | None = None
    seconds: dict[str, float] = field(default_factory=dict[str, float])

    def take_seconds(self) -> dict[str, float]:
        """The seconds, once."""
        found, self.seconds = self.seconds, {}
        return found
