"""The folder of what is asked on request: a small volume, the whole check, and the whole run."""

from __future__ import annotations

from twinct.design import words
from twinct.design.desk import Answer, State
from twinct.design.page.tools import Tool, Tools
from twinct.design.questions import Checked, MeasuredTime, SmallVolume
from twinct.viewer.markdown import plain

KINDS = {"small volume": SmallVolume, "whole check": Checked, "measure time": MeasuredTime}
NAMES = {kind.subject: name for name, kind in KINDS.items()}


class AskFolder(Tool):
    """Small volume, whole check, time, and cancelling."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the folder."""
        super().__init__(tools)
        gui = tools.server.gui
        with gui.add_folder("Ask", order=order):
            self._ask = gui.add_button_group("", (*KINDS, "cancel"))
            self._answer = gui.add_markdown("")
        tools.pressed(self._ask, self._request)

    def _request(self, button: str) -> None:
        if button == "cancel":
            self.bench.cancel()
        elif not self.bench.draft.problems:
            self.bench.ask(KINDS[button](self.bench.draft.source))

    def hear(self, subject: str, answer: Answer) -> None:
        """Show the answer."""
        if subject not in NAMES:
            return
        lines = [f"{NAMES[subject]}: {answer.state}"]
        if answer.state is State.FRESH and subject == "check":
            lines += [f"{topic}: {plain(text)}" for topic, text in answer.value.items()]
        elif answer.state is State.FRESH and subject == "time":
            lines.append(plain(answer.value))
            self.bench.ask_for_costs()
        elif answer.state is State.FRESH:
            lines[0] += f", {answer.seconds:.1f} s; see Slices"
        elif answer.state is State.COMPUTING and answer.progress:
            lines.append(f"*{plain(answer.progress)}*")
        lines += [f"**{plain(problem)}**" for problem in answer.problems]
        self._answer.content = "  \n".join(lines)


class RunFolder(Tool):
    """The whole run: start, progress, cancel."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the folder."""
        super().__init__(tools)
        gui = tools.server.gui
        self._ended = ""
        with gui.add_folder("Run", order=order):
            self._buttons = gui.add_button_group("", ("run", "cancel the run"))
            self._about = gui.add_markdown("")
        tools.pressed(self._buttons, self._press)

    def _press(self, button: str) -> None:
        if button == "run":
            if not self.tools.attempt(self.bench.run):
                self._about.content = f"**{plain(self.tools.said)}**"
            self.tools.refresh()
        else:
            self.bench.cancel_run()

    def hear(self, subject: str, answer: Answer) -> None:
        """Show how far the run is, and its end."""
        if subject != "run" or self.bench.started is None:
            return
        self._about.content = words.run_in_words(self.bench.started, answer)
        if answer.state is not State.COMPUTING and answer.state != self._ended:
            bad = answer.state is not State.FRESH
            self.tools.tell("run", "cancelled or failed" if bad else "finished", bad=bad)
        self._ended = "" if answer.state is State.COMPUTING else answer.state
