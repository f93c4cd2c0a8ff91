"""The copy of a draft on disk, from which the workbench goes on after a crash."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError, ScenarioError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import write_json
from twinct.design.edits import Edit
from twinct.scenario import ScenarioText


@dataclass(frozen=True)
class Kept:
    """State of a draft, as plain data.

    Attributes:
        saved: text of the file; None without a file.
        first: text before the first edit.
        edits: all edits.
        done: number of edits that are not undone.
    """

    saved: str | None
    first: str
    edits: tuple[Edit, ...] = ()
    done: int = 0

    def text_of(self, path: Path) -> str | None:
        """Return the text of the state; None if the edits do not fit."""
        source = ScenarioText(path, self.first)
        try:
            for edit in self.edits[: self.done]:
                source = edit.on(source)
        except ScenarioError:
            return None
        return source.text

    def write(self, path: Path) -> None:
        """Write the state, completely or not at all.

        Raises:
            StorageError: the folder does not exist.
            OSError: the file cannot be written.
        """
        edits = [{"values": dict(e.values), "removed": list(e.removed)} for e in self.edits]
        state = {"saved": self.saved, "first": self.first, "edits": edits, "done": self.done}
        write_json(path, state)


def path_beside(path: Path) -> Path:
    """Return the place of the draft of a scenario file."""
    return path.with_name(f".{path.name}.draft")


def kept_beside(path: Path) -> Kept | None:
    """Return the draft that was kept beside a scenario file, if any.

    Raises:
        InputError: something else has its name.
    """
    beside = path_beside(path)
    if no_file(beside) == ABSENT:
        return None
    try:
        state: Any = read_json(beside)
        edits = tuple(Edit(dict(e["values"]), tuple(e["removed"])) for e in state["edits"])
        kept = Kept(state["saved"], str(state["first"]), edits, int(state["done"]))
        if not 0 <= kept.done <= len(edits):
            raise ValueError
    except (InputError, OSError, ValueError, TypeError, KeyError, AttributeError):
        raise InputError(
            f"{beside}: this is no draft of twinct design: move it elsewhere, then open the "
            "scenario again"
        ) from None
    return kept
