"""A builder whose specimen is built by one process of the workbench, and read by the others."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from twinct.core.errors import StorageError
from twinct.scan import SimulationBuilder
from twinct.specimen import BuiltSpecimen
from twinct.specimen.built_file import load_built, save_built
from twinct.study.cache import Cache

log = logging.getLogger(__name__)

KIND = "specimens"

KEPT = 2
"""Specimens that stay in the folder: the present one, and one that a process may be reading."""


@dataclass(frozen=True)
class SharedBuilder(SimulationBuilder):
    """Parts of a scenario, with a specimen that several processes share.

    Attributes:
        shelf: folder of specimens; None: this process builds its own.
    """

    shelf: Path | None = None

    def _built(self) -> BuiltSpecimen:
        if self.shelf is None:
            return super()._built()
        try:
            return self._from(self.shelf)
        except (StorageError, OSError) as error:
            log.warning("%s; this process builds its own specimen", error)
            return super()._built()

    def _from(self, shelf: Path) -> BuiltSpecimen:
        """Return the specimen from the shelf, on which the first process puts it."""
        section = self.scenario.specimen

        def make() -> BuiltSpecimen:
            made = super(SharedBuilder, self)._built()
            # Stored with the specimen, as each process with arms needs them.
            _ = made.hull, made.hulls if self.scenario.cell.kind == "arms" else ()
            return made

        found = Cache(shelf).stored(
            KIND, self._body_digest, make, save_built, lambda path: load_built(section, path)
        )
        entries = [path for path in (shelf / KIND).iterdir() if not path.name.startswith(".")]
        for old in sorted(entries, key=lambda path: path.stat().st_mtime)[:-KEPT]:
            old.unlink(missing_ok=True)
        return found
