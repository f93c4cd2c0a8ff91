"""Record of a scan in sweeps, which may end before all commanded views are taken."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import write_json
from twinct.scan.manifest import Damage, damaged, digest_of, lost, row_file

SWEEPS = "status/sweeps.json"
"""Path of the record in its store."""


@dataclass(frozen=True)
class Sweeps:
    """Comparisons of a scan in sweeps, and its end.

    Attributes:
        changes_rel: relative change of the volume since half the views, by the number of views.
        complete: number of views with which the scan is complete; None: it goes on.
    """

    changes_rel: Mapping[int, float] = field(default_factory=dict[int, float])
    complete: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the content as JSON has it."""
        changes = {str(views): change for views, change in self.changes_rel.items()}
        return {"changes_rel": changes, "complete": self.complete}


def write_sweeps(path: Path, sweeps: Sweeps) -> None:
    """Write the record of a scan into its store, completely or not at all."""
    write_json(path / SWEEPS, sweeps.as_dict() | {"digest": _digest(path, sweeps)})


def read_sweeps(path: Path) -> Sweeps:
    """Return the record of a scan, which is empty before the first comparison.

    Raises:
        DamagedError: the record is damaged, or belongs to other images.
    """
    if not (path / SWEEPS).exists():
        return Sweeps()
    if damage := sweeps_damage(path):
        raise damaged(path, damage)
    return _read(path)


def sweeps_damage(path: Path) -> Damage | None:
    """Return the damage to the record of a scan, which depends on the images of its last view."""
    if not (path / SWEEPS).exists():
        return None
    if gone := lost(path, SWEEPS, None):
        return gone
    try:
        intact = read_json(path / SWEEPS)["digest"] == _digest(path, _read(path))
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        intact = False
    return None if intact else Damage(SWEEPS, "changed")


def _read(path: Path) -> Sweeps:
    data: Any = read_json(path / SWEEPS)
    changes = {int(views): float(change) for views, change in data["changes_rel"].items()}
    return Sweeps(changes, None if data["complete"] is None else int(data["complete"]))


def _digest(path: Path, sweeps: Sweeps) -> str:
    """Return the digest of a record and of the last view's row in the manifest."""
    last = max((sweeps.complete or 0, *sweeps.changes_rel)) - 1
    row = digest_of((path / row_file(last)).read_bytes())
    return digest_of(json.dumps([sweeps.as_dict(), row], sort_keys=True).encode())
