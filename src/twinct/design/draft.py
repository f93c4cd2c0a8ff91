"""A scenario file in the making: edits, undo and redo, and a copy on disk that survives a crash."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError, ScenarioError, StorageError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.files.plain_yaml import read_file_text
from twinct.core.files.writing import storage_errors, write_text
from twinct.design.edits import Edit, Line, compared, overrides_between
from twinct.design.kept import Kept, kept_beside, path_beside
from twinct.scenario import Scenario, ScenarioText, load_scenario, scenario_names
from twinct.scenario.catalogue import scenario_file

NEW_FILE = "design.yaml"
"""Name of a scenario file that extends a built-in scenario."""


@dataclass
class Draft:
    """A scenario file with edits that are not saved yet.

    Each edit changes only its own lines. Every state is kept beside the file (``kept_beside``) as
    soon as it is reached, until it is saved.

    Attributes:
        path: the scenario file, which may not exist yet.
        saved: text of the file when it was opened or saved; None if there was no file.
        first: text before the first edit.
        edits: all edits, also those that are undone.
        done: number of edits that are not undone.
        scenario: the present scenario, or the last one without problems; None without any.
        problems: reasons why the present text is no valid scenario.
        unkept: why the draft could not be kept on disk; empty if it was.
        dropped: edits that did not fit to the text of another program.
    """

    path: Path
    saved: str | None
    first: str
    edits: list[Edit] = field(default_factory=list[Edit])
    done: int = 0
    scenario: Scenario | None = None
    problems: tuple[str, ...] = ()
    unkept: str = ""
    dropped: tuple[Edit, ...] = ()
    _texts: list[str] = field(default_factory=list[str])
    _gesture: object = None

    @classmethod
    def open(cls, path: Path, start: str = "") -> Draft:
        """Open a file, with the edits that were kept beside it, if any.

        Args:
            path: the file; if it does not exist, the draft begins with ``start``.
            start: text for a new file.

        Raises:
            ScenarioError: the file cannot be read as text.
            StorageError: the folder of the file does not exist.
        """
        path = path.absolute()
        if not path.parent.is_dir():
            raise StorageError(f"{path}: there is no folder {path.parent}")
        on_disk = _text_at(path)
        kept = kept_beside(path)
        if kept is None or kept.text_of(path) == on_disk:
            kept = Kept(on_disk, start if on_disk is None else on_disk)
        draft = cls(path, kept.saved, kept.first, list(kept.edits), kept.done)
        draft._replay()
        draft._judge()
        return draft

    @property
    def text(self) -> str:
        """The present text."""
        return self._texts[self.done]

    @property
    def source(self) -> ScenarioText:
        """The present text, with its place."""
        return ScenarioText(self.path, self.text)

    @property
    def is_saved(self) -> bool:
        """True if the file holds the present text, unless another program has changed it."""
        return self.saved == self.text

    @property
    def can_undo(self) -> bool:
        """True if there is an edit to undo."""
        return self.done > 0

    @property
    def can_redo(self) -> bool:
        """True if there is an undone edit."""
        return self.done < len(self.edits)

    def set(self, values: Mapping[str, Any], *, gesture: object = None) -> Edit:
        """Set keys, as one edit.

        Args:
            values: plain values by dotted key.
            gesture: edits one after the other with this mark, such as those of one slider while it
                is dragged, count as one.

        Raises:
            ScenarioError: a key leads nowhere; the draft stays as it is.
        """
        return self.apply(Edit(dict(values)), gesture=gesture)

    def apply(self, edit: Edit, *, gesture: object = None) -> Edit:
        """Apply an edit; undone edits are forgotten. See ``set``."""
        again = gesture is not None and gesture == self._gesture and self.done > 0
        if again:
            former = self.edits[self.done - 1]
            removed = (*former.removed, *edit.removed)
            edit = Edit({**former.values, **edit.values}, removed)
        base = self.done - again
        after = edit.on(ScenarioText(self.path, self._texts[base])).text
        self.edits[base:], self._texts[base + 1 :] = [edit], [after]
        self.done, self._gesture = base + 1, gesture
        self._keep()
        self._judge()
        return edit

    def undo(self) -> None:
        """Return to the state before the last edit, if there is one."""
        self._go(self.done - 1)

    def redo(self) -> None:
        """Repeat the edit that was undone last, if there is one."""
        self._go(self.done + 1)

    def _go(self, to: int) -> None:
        if 0 <= to <= len(self.edits):
            self.done, self._gesture = to, None
            self._keep()
            self._judge()

    def compare(self) -> list[Line]:
        """Return the lines of the saved and the present text, with the changed ones marked."""
        return compared(self.saved or "", self.text)

    def changed_outside(self) -> bool:
        """Return True if another program has changed or removed the file."""
        try:
            return _text_at(self.path) != self.saved
        except ScenarioError:
            return True

    def save(self, *, over: bool = False) -> None:
        """Write the file, completely or not at all.

        Args:
            over: also replace what another program has written.

        Raises:
            InputError: another program has changed the file.
            StorageError: the file cannot be written; the draft stays.
        """
        if not over and self.changed_outside():
            raise InputError(
                f"{self.path}: another program has changed the file since it was opened: take its "
                "text over, or replace it"
            )
        with storage_errors(self.path, "the file is as it was, and the draft is kept"):
            write_text(self.path, self.text)
        self.saved = self.text
        self._keep()

    def take_over(self) -> None:
        """Begin again with the file of another program, and repeat the edits on it.

        Edits that do not fit to it are ``dropped``.

        Raises:
            ScenarioError: the file cannot be read as text.
        """
        self.saved = _text_at(self.path)
        self.first = self.saved or ""
        edits, self.edits, self.done = self.edits[: self.done], [], 0
        self._texts, self._gesture, dropped = [self.first], None, list[Edit]()
        for edit in edits:
            try:
                after = edit.on(self.source).text
            except ScenarioError:
                dropped.append(edit)
                continue
            self.edits.append(edit)
            self._texts.append(after)
            self.done += 1
        self.dropped = tuple(dropped)
        self._keep()
        self._judge()

    def command(self) -> str:
        """Return the command that runs the present state of the saved file.

        Raises:
            ScenarioError: the text cannot be read, or a removed key has no option.
        """
        words = ["twinct", "run", self.path.name]
        for override in self._overrides():
            words += ["--set", override]
        return shlex.join([*words, "--out", f"out/{self.path.stem}"])

    def python(self) -> str:
        """Return a program that runs the present state of the saved file; see ``command``."""
        lines = "".join(f"    {override!r},\n" for override in self._overrides())
        changes = f", [\n{lines}]" if lines else ""
        return (
            "from twinct import load_scenario, run\n\n"
            f"scenario = load_scenario({self.path.name!r}{changes})\n"
            f"run(scenario, {f'out/{self.path.stem}'!r})\n"
        )

    def _overrides(self) -> list[str]:
        if self.saved is None:
            raise ScenarioError(f"{self.path}: the file is new: save it, then it can be run")
        return overrides_between(ScenarioText(self.path, self.saved), self.source)

    def _replay(self) -> None:
        self._texts = [self.first]
        for edit in self.edits:
            source = ScenarioText(self.path, self._texts[-1])
            try:
                self._texts.append(edit.on(source).text)
            except ScenarioError:  # a file that it extends has changed
                break
        del self.edits[len(self._texts) - 1 :]
        self.done = min(self.done, len(self.edits))

    def _judge(self) -> None:
        try:
            self.scenario, self.problems = load_scenario(self.source), ()
        except InputError as error:
            self.problems = tuple(error.problems)

    def _keep(self) -> None:
        """Keep the draft on disk, or remove it if the file holds all of it."""
        beside = path_beside(self.path)
        try:
            with storage_errors(beside, "the draft is only in memory"):
                if self.is_saved:
                    beside.unlink(missing_ok=True)
                else:
                    Kept(self.saved, self.first, tuple(self.edits), self.done).write(beside)
            self.unkept = ""
        except (InputError, OSError) as error:
            self.unkept = str(error)


def open_draft(scenario: Path, folder: Path | None = None) -> Draft:
    """Open the draft of a scenario file, or of a new one.

    Args:
        scenario: the file; or the name of a built-in scenario, which ``NEW_FILE`` then extends.
        folder: folder for ``NEW_FILE``; None: the working folder.

    Raises:
        ScenarioError: neither a file nor a built-in scenario, or no text.
        InputError: something else lies where the draft should be kept.
    """
    name = str(scenario)
    if name in scenario_names() and not scenario.is_file():
        return Draft.open((folder or Path.cwd()) / NEW_FILE, f"extends: {name}\nname: design\n")
    if not scenario.suffix:
        scenario_file(scenario)  # names the built-in scenarios
    return Draft.open(scenario, "extends: demo\n" + f"name: {scenario.stem}\n")


def _text_at(path: Path) -> str | None:
    """Return the text of a file; None if there is none."""
    return None if no_file(path) == ABSENT else read_file_text(path, "scenario")
