"""What a study will take, told before it is run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinct.report.study_page import MOST_BEST as MOST_SHOWN
from twinct.study.book import Book
from twinct.study.checking import Checked
from twinct.study.rows import MOST_BEST
from twinct.study.settings import Study

ROW_BYTES = 2_000
TABLE_BYTES = 30_000
SECTIONS_BYTES = 100_000
PAGE_BYTES = 150_000
"""Taken until one was written here."""

BYTES_IN_TABLE = 250
"""Of a row in the table of results: columns are compressed, and have a size of their own."""


@dataclass(frozen=True)
class Estimate:
    """What a study will take.

    Attributes:
        trials: that are still to be tried.
        scans: among them, each taken once.
        disk_bytes: in its folder, in the end.
        seconds: wall-clock; None where no trial of one of its kinds has run on this machine.
        measured: whether trials of all its kinds were run on this machine; else the bytes are
            those of files that nothing compresses.
    """

    trials: int
    scans: int
    disk_bytes: int
    seconds: float | None
    measured: bool


def estimate(study: Study, trials: Sequence[Checked], workers: int, book: Book) -> Estimate:
    """Of the trials that are still to be tried, by so many workers."""
    whole = study.keep == "everything"
    numbers = Counter(one.scan for one in trials)
    first = {one.scan: one for one in trials}
    # Trials with one volume have it once.
    tried = trials if whole else list({one.volume: one for one in trials}.values())
    seconds: list[float | None] = [book.mean(one.cost.scan) for one in first.values()]
    seconds += [book.mean(one.cost.rest) for one in tried]
    known = [s for s in seconds if s is not None]
    kept = [one for digest, one in first.items() if whole or numbers[digest] > 1]
    # Hard links: a scan that is kept in a trial's folder, too, takes its bytes once.
    size = sum(_mean(book, f"{one.cost.scan} bytes", one.cost.scan_bytes) for one in kept)
    size += len(trials) * (_mean(book, "row bytes", ROW_BYTES) + BYTES_IN_TABLE)
    if study.keep != "figures":
        for one in tried:
            need = sum(stage.disk_bytes for stage in one.cost.stages.values()) if whole else 0.0
            need += one.cost.volume_bytes - (one.cost.scan_bytes if whole else 0)
            size += _mean(book, f"{one.cost.rest} bytes", need)
    if trials:
        size += _mean(book, "table bytes", TABLE_BYTES)
        combinations = min(len({repr(one.trial.axes) for one in trials}), MOST_BEST)
        kind = f"{trials[0].cost.rest} sections bytes"
        size += combinations * _mean(book, kind, SECTIONS_BYTES)
        size += page_parts(combinations) * _mean(book, page_kind(study), PAGE_BYTES)
    complete = len(known) == len(seconds)
    wall = sum(known) / max(min(workers, len(tried)), 1) if complete else None
    if wall:
        wall += book.mean("seconds around") or 0.0
    return Estimate(len(trials), len(numbers), round(size), wall, complete)


def page_kind(study: Study) -> str:
    """What pages of studies like this are called in the book."""
    return f"page {len(study.axes)} {len(study.figures)} bytes"


def page_parts(combinations: int) -> int:
    """Into how many parts of about one size a page goes: its best trials; trends take little."""
    return max(min(combinations, MOST_SHOWN), 1)


def bytes_below(paths: Iterable[Path]) -> int:
    """Of all files in folders, and files; one with several names (hard links) counts once."""
    files = (file for path in paths for file in ([path] if path.is_file() else path.rglob("*")))
    told = (file.stat() for file in files if file.is_file())
    return sum({(one.st_dev, one.st_ino): one.st_size for one in told}.values())


def _mean(book: Book, kind: str, otherwise: float) -> float:
    found = book.mean(kind)
    return otherwise if found is None else found
