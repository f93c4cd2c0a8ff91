"""Shards of a study: parts that run as jobs of their own, and the study that they make together.

A shard is a study of some trials, in a folder of its own, so that jobs of a cluster share nothing.
Trials that share a scan are in one shard. Merging copies rows and files of finished trials.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from twinct.core.errors import InputError
from twinct.core.foreign_text import counted, quoted
from twinct.study.design import Trial
from twinct.study.folder import StudyFolder
from twinct.study.journal import Journal, Row
from twinct.study.rows import Rows


@dataclass(frozen=True)
class Shard:
    """One of several parts of a study.

    Attributes:
        number: its number, from 1.
        of: number of parts.
    """

    number: int
    of: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a shard such as ``2/4``.

        Raises:
            InputError: the text has another form, or there is no such shard.
        """
        found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise InputError(
                f"shard {quoted(text)}: must be a number from 1, and the number of shards, such as "
                "2/4"
            )
        return cls(int(found[1]), int(found[2]))

    def part(self, trials: Sequence[Trial]) -> list[Trial]:
        """Return the trials of the shard: whole scans in turn, in the study's order."""
        scans = {scan: at for at, scan in enumerate(dict.fromkeys(one.scan for one in trials))}
        return [one for one in trials if scans[one.scan] % self.of == self.number - 1]


def rows_of_shards(trials: Sequence[Trial], shards: Sequence[StudyFolder]) -> list[Row]:
    """Return the rows of a study's trials in shards; a finished trial outweighs a failed one.

    Raises:
        InputError: a folder holds no trials, or trials of another study.
    """
    numbers, found = {one.key: one.number for one in trials}, dict[str, Row]()
    for shard in shards:
        rows = Journal(shard.path).rows()
        if not rows:
            raise InputError(f"{shard.path}: there are no trials of a study to merge")
        if strange := [row for row in rows if row.key not in numbers]:
            raise InputError(
                f"{shard.path}: {counted(len(strange), 'trial')} of {len(rows)} belong to another "
                f"study or scenario, such as trial {strange[0].trial}; merge shards of one study, "
                "whose files have not changed since"
            )
        for row in rows:
            if row.key not in found or found[row.key].status == "failed":
                found[row.key] = row
    return list(found.values())


def merge_shards(
    trials: Sequence[Trial], shards: Sequence[StudyFolder], folder: StudyFolder, rows: Rows
) -> list[Trial]:
    """Add the rows and files of shards to a study; return the trials that are still missing.

    Args:
        trials: all trials of the study.
        shards: folders of its shards.
        folder: folder of the study.
        rows: its rows.

    Raises:
        InputError: see ``rows_of_shards``.
    """
    new = [row for row in rows_of_shards(trials, shards) if rows.wanted(row.key, retry=True)]
    for shard in shards:
        for there, here in (
            (shard.scans, folder.scans),
            (shard.trials, folder.trials),
            (shard.best, folder.best),
        ):
            _copy(there, here)
    rows.add(new)
    rows.renumbered({one.key: one.number for one in trials})
    return [one for one in trials if rows.wanted(one.key, retry=False)]


def _copy(there: Path, here: Path) -> None:
    """Copy a folder's files beside those that are here; links stay links."""
    if there.is_dir():
        shutil.copytree(there, here, symlinks=True, dirs_exist_ok=True)
