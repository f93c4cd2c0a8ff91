"""Tools that all folders and tabs of the page share."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any

from twinct.core.errors import TwinctError
from twinct.design.desk import Answer
from twinct.design.hand import Hand
from twinct.design.workbench import Workbench
from twinct.scenario import Scenario
from twinct.viewer.live_page import Page
from twinct.viewer.server import Server

NOTICE_S = 8.0
"""Time that a notice stays."""

RED, GREEN = (200, 50, 50), (38, 150, 70)


class Tools:
    """Server, model and thread of a page, and what its folders do with them.

    Attributes:
        server: the server.
        page: the page of ``twinct view``.
        bench: the model; only the page's own thread changes it.
        hand: this thread.
        shown: the scenario that the page shows, which is the last valid one.
        by: controls that asked for the change that is being painted.
        said: why the last request was refused.
    """

    def __init__(self, server: Server, page: Page, bench: Workbench, hand: Hand) -> None:
        """Keep them; ``refresh`` is set by the page."""
        self.server, self.page, self.bench, self.hand = server, page, bench, hand
        self.shown: Scenario | None = None
        self.by: tuple[Any, ...] = ()
        self.said = ""
        self.refresh: Callable[[], None] = lambda: None

    def on(self, handle: Any, kind: Hashable, does: Callable[[Any], object]) -> None:
        """Do something in the page's thread with each new value of a control; the newest counts.

        The value is that of the event: until the thread comes to it, painting may have set another.
        The function is asynchronous, to run in the server's loop, which keeps the order.
        """

        async def heard(event: Any) -> None:
            if event.client_id is None:  # painted, by no user
                return
            value = handle.value
            self.hand.ask(kind, lambda: does(value))

        handle.on_update(heard)

    def pressed(self, group: Any, does: Callable[[str], object]) -> None:
        """Do a task of the page's thread for each press of a button."""

        async def heard(event: Any) -> None:
            button = str(event.target.value)
            self.hand.ask(object(), lambda: does(button))

        group.on_click(heard)

    def change(
        self, values: Mapping[str, Any], gesture: object = None, by: tuple[Any, ...] = ()
    ) -> None:
        """Make an edit; the controls that asked for it stay, as their user may have gone on."""
        if values:
            self.attempt(lambda: self.bench.set(values, gesture=gesture))
        self.by = by
        try:
            self.refresh()
        finally:
            self.by = ()

    def attempt(self, act: Callable[[], object]) -> bool:
        """Do something; if it is refused, keep the reason, and return False."""
        self.said = ""
        try:
            act()
        except TwinctError as error:
            self.said = str(error)
        return not self.said

    def tell(self, title: str, text: str, *, bad: bool = False) -> None:
        """Show a notice in all browsers."""
        for client in self.server.get_clients().values():
            client.add_notification(
                title,
                text,
                auto_close_seconds=None if bad else NOTICE_S,
                color=RED if bad else GREEN,
            )


class Tool:
    """A folder or a tab: it paints the scenario and the answers that concern it."""

    def __init__(self, tools: Tools) -> None:
        """Keep what all tools share."""
        self.tools = tools

    @property
    def bench(self) -> Workbench:
        """The model."""
        return self.tools.bench

    def put(self, handle: Any, value: Any) -> None:
        """Set a control, unless it asked for the change that is being painted."""
        if handle.value != value and handle not in self.tools.by:
            handle.value = value

    def paint(self, scenario: Scenario) -> None:
        """Show a scenario that has changed."""

    def hear(self, subject: str, answer: Answer) -> None:
        """Show an answer that has changed."""

    def beat(self) -> None:
        """Look at what changes by itself; called every second while nothing else is asked for."""

    def close(self) -> None:
        """End what the tool has started."""
