"""Estimates of the time and disk space of a study, before it runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinct.report.study_page import MOST_BEST as MOST_SHOWN
from twinct.study.design import Trial
from twinct.study.rows import MOST_BEST
from twinct.study.settings import Study
from twinct.study.timings import TrialTimings

ROW_BYTES = 2_000
TABLE_BYTES = 30_000
SECTIONS_BYTES = 100_000
PAGE_BYTES = 150_000
"""Sizes that are assumed until the timings have values of this machine."""

BYTES_IN_TABLE = 250
"""Bytes of a row in the table of results; the columns' fixed size is ``TABLE_BYTES``."""


@dataclass(frozen=True)
class Estimate:
    """Estimated resources of a study.

    Attributes:
        trials: number of trials still to run.
        scans: number of different scans among them.
        disk_bytes: final size of their results in the folder.
        seconds: wall-clock time; None if a kind of trial has neither run on this machine nor
            been timed by small scans.
        measured: True if all kinds of trials have run on this machine; else the sizes assume
            uncompressed files.
    """

    trials: int
    scans: int
    disk_bytes: int
    seconds: float | None
    measured: bool


def estimate(
    study: Study, trials: Sequence[Trial], workers: int, timings: TrialTimings
) -> Estimate:
    """Estimate the resources of the trials still to run, with a number of workers."""
    whole = study.keep == "everything"
    numbers = Counter(one.scan for one in trials)
    first = {one.scan: one for one in trials}
    # Trials that share a volume reconstruct it once.
    tried = trials if whole else list({one.volume: one for one in trials}.values())
    measured = [timings.mean(one.cost.scan) for one in first.values()]
    measured += [timings.mean(one.cost.rest) for one in tried]
    expected = [one.cost.scan_s for one in first.values()] + [one.cost.rest_s for one in tried]
    seconds = [b if a is None else a for a, b in zip(measured, expected, strict=True)]
    known = [s for s in seconds if s is not None]
    stored = [one for digest, one in first.items() if whole or numbers[digest] > 1]
    # Trial folders hold shared scans as hard links, so each scan's bytes count once.
    size = sum(_mean(timings, f"{one.cost.scan} bytes", one.cost.scan_bytes) for one in stored)
    size += len(trials) * (_mean(timings, "row bytes", ROW_BYTES) + BYTES_IN_TABLE)
    if study.keep != "figures":
        for one in tried:
            need = sum(stage.disk_bytes for stage in one.cost.stages.values()) if whole else 0.0
            need += one.cost.volume_bytes - (one.cost.scan_bytes if whole else 0)
            size += _mean(timings, f"{one.cost.rest} bytes", need)
    if trials:
        size += _mean(timings, "table bytes", TABLE_BYTES)
        combinations = min(len({repr(one.axes) for one in trials}), MOST_BEST)
        kind = f"{trials[0].cost.rest} sections bytes"
        size += combinations * _mean(timings, kind, SECTIONS_BYTES)
        size += page_parts(combinations) * _mean(timings, page_kind(study), PAGE_BYTES)
    complete = all(s is not None for s in measured)
    wall = sum(known) / max(min(workers, len(tried)), 1) if len(known) == len(seconds) else None
    if wall:
        wall += timings.mean("seconds around") or 0.0
    return Estimate(len(trials), len(numbers), round(size), wall, complete)


def page_kind(study: Study) -> str:
    """Return the name of the kind of a study's page in the timings."""
    return f"page {len(study.axes)} {len(study.figures)} bytes"


def page_parts(combinations: int) -> int:
    """Return the number of similar-sized parts of a page: its best trials; trends are small."""
    return max(min(combinations, MOST_SHOWN), 1)


def bytes_below(paths: Iterable[Path]) -> int:
    """Return the total size of files, also in folders; hard links of one file count once."""
    files = (file for path in paths for file in ([path] if path.is_file() else path.rglob("*")))
    stats = (file.stat() for file in files if file.is_file())
    return sum({(one.st_dev, one.st_ino): one.st_size for one in stats}.values())


def _mean(timings: TrialTimings, kind: str, otherwise: float) -> float:
    mean = timings.mean(kind)
    return otherwise if mean is None else mean
