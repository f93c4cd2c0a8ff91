"""Journal of a search for views, on disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import write_json
from twinct.scenario import ViewTask
from twinct.view_planning import Searched


class SearchJournal:
    """State of a search; each change is written to disk.

    Attributes:
        within_reach: indices of the reachable candidates, once they are known.
        state: state of the choice among them.
        generations: worth of all paths of each generation, for a family of paths.
    """

    def __init__(self, path: Path, digest: str, resume: bool) -> None:
        """Read the existing journal, if any, of the search with a digest.

        Raises:
            ScanExistsError: a journal exists and ``resume`` is false, or its scenario is another.
            InputError: the journal cannot be read.
        """
        self._path, self._digest = path, digest
        self.within_reach: NDArray[np.intp] | None = None
        self.state = Searched()
        self.generations: list[list[float]] = []
        if not path.exists():
            return
        data = _read(path)
        if not resume:
            raise ScanExistsError(f"{path} holds a search: continue it with --resume")
        if data.get("digest") != self._digest:
            raise ScanExistsError(f"{path} is the search of another scenario: choose another --out")
        self.within_reach = np.array(data["reachable"], np.intp)
        state = data["state"]
        self.state = Searched(
            tuple(state["chosen"]),
            tuple(state["worth"]),
            state["place"],
            state["unchanged"],
            state["priced"],
            tuple(state.get("best", ())),
        )
        self.generations = data["generations"]

    @property
    def in_words(self) -> str:
        """State of the search in words, and how it goes on."""
        if self.within_reach is None:
            return "nothing yet"
        steps = len(self.state.worth) + len(self.generations)
        return f"the candidates within reach and {steps} steps of the search; --resume continues"

    def write_candidates(self, within_reach: NDArray[np.intp]) -> None:
        """Write the candidates within reach."""
        self.within_reach = within_reach
        self._write()

    def went_on(self, state: Searched) -> None:
        """Write the state after a step of the choice."""
        self.state = state
        self._write()

    def judged(self, worth: Sequence[float]) -> None:
        """Write the worth of the paths of a generation."""
        self.generations.append(list(worth))
        self._write()

    def _write(self) -> None:
        assert self.within_reach is not None
        data = {
            "digest": self._digest,
            "reachable": self.within_reach.tolist(),
            "state": vars(self.state),
            "generations": self.generations,
        }
        write_json(self._path, data)


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_json(path)
    except ValueError as error:
        raise InputError(f"{path}: cannot be read: {error}; delete it to start again") from None


def search_digest(images: str, task: ViewTask) -> str:
    """Return the digest of a search, from that of the stage of images and the task."""
    parts = [images, task.model_dump(mode="json")]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
