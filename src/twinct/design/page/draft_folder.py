"""The folder of the draft: undo, redo, save; and the tab with its changes."""

from __future__ import annotations

from twinct.core.errors import TwinctError
from twinct.design import words
from twinct.design.page.tools import Tool, Tools
from twinct.viewer.markdown import plain


class DraftFolder(Tool):
    """Undo, redo and save, and what to do with the file of another program."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the folder."""
        super().__init__(tools)
        gui = tools.server.gui
        self._outside = False
        with gui.add_folder("Draft", order=order):
            self._file = gui.add_markdown("")
            self._draft = gui.add_button_group("", ("undo", "redo", "save"))
            self._theirs = gui.add_button_group("", ("take over", "replace"), visible=False)
        tools.pressed(self._draft, self._press)
        tools.pressed(self._theirs, self._resolve)

    def _press(self, button: str) -> None:
        if button == "save":
            self.tools.attempt(self.bench.save)
        elif button == "undo":
            self.bench.undo()
        else:
            self.bench.redo()
        self.tools.refresh()

    def _resolve(self, button: str) -> None:
        """Take over or replace the file of another program."""
        if button == "take over":
            self.tools.attempt(self.bench.take_over)
        else:
            self.tools.attempt(lambda: self.bench.save(over=True))
        self.beat()
        self.tools.refresh()

    def beat(self) -> None:
        """Notice what another program has written."""
        outside = self.bench.draft.changed_outside()
        if outside != self._outside:
            self._outside = outside
            self._theirs.visible = outside
            self.paint_draft()

    def paint_draft(self) -> None:
        """Show the state of the file, also if it is no valid scenario."""
        said = words.draft_in_words(self.bench.draft, self._outside)
        why = self.tools.said
        self._file.content = f"{said}  \n**{plain(why)}**" if why else said


class ChangesTab(Tool):
    """The changed lines of the file, and the present state as a command and as a program."""

    def __init__(self, tools: Tools) -> None:
        """Add the tab."""
        super().__init__(tools)
        with tools.page.side.add_tab("Changes"):
            self._compared = tools.server.gui.add_markdown("")
            self._copies = tools.server.gui.add_markdown("")

    def paint_draft(self) -> None:
        """Show the changes, also if the draft is no valid scenario."""
        draft = self.bench.draft
        self._compared.content = words.changes_in_words(draft.compare())
        try:
            copies = [words.code(draft.command(), "sh"), words.code(draft.python(), "python")]
        except TwinctError as error:
            copies = [f"*{plain(str(error))}*"]
        self._copies.content = "\n\n".join(copies)
