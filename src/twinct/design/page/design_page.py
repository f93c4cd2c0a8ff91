"""The page: all folders and tabs, one thread that paints them, and the model behind them."""

from __future__ import annotations

import logging
from pathlib import Path
from threading import Timer

from twinct.core.errors import TwinctError
from twinct.design import words
from twinct.design.desk import Answer
from twinct.design.draft import Draft
from twinct.design.hand import Hand
from twinct.design.page.ask_folder import AskFolder, RunFolder
from twinct.design.page.beam_folder import BeamFolder
from twinct.design.page.choose_folder import ChooseFolder
from twinct.design.page.draft_folder import ChangesTab, DraftFolder
from twinct.design.page.image_tab import ImageTab
from twinct.design.page.move_folder import MoveFolder
from twinct.design.page.path_folder import PathFolder
from twinct.design.page.prices_tab import PricesTab
from twinct.design.page.proposal_folder import ProposalFolder
from twinct.design.page.scene import Scene
from twinct.design.page.sphere import Sphere
from twinct.design.page.tools import Tool, Tools
from twinct.design.workbench import Workbench
from twinct.viewer.live_page import Page
from twinct.viewer.server import Server

log = logging.getLogger(__name__)

REST_S = 0.6
"""Time without a change after which all pixels of the image, and the dose, are asked for."""


class DesignPage:
    """Tools beside a page, and the model behind them.

    Attributes:
        page: the page of ``twinct view``.
        bench: the model; only the page's own thread changes it.
        move, path: the folders of bodies and of the path.
        choose: the folder of arms, room and specimen.
    """

    def __init__(
        self, server: Server, draft: Draft, folder: Path, *, rest_s: float = REST_S
    ) -> None:
        """Show a draft.

        Args:
            server: the server.
            draft: the draft.
            folder: folder for the output of the workers.
            rest_s: time without a change after which all pixels are asked for.
        """
        self.page, self._rest_s = Page(server, live=True), rest_s
        self.bench = Workbench(draft, folder, self._hear)
        self._rest: Timer | None = None
        self._hand = Hand("design", self._say, self._beat)
        self._rooms = Hand("rooms", self._say)
        self._tools = tools = Tools(server, self.page, self.bench, self._hand)
        tools.refresh = self._refresh
        order = self.page.below_head
        self._draft = DraftFolder(tools, order)
        runs = RunFolder(tools, order + 0.02)
        self.choose = ChooseFolder(tools, order + 0.05)
        self.move = MoveFolder(tools, order + 0.1)
        self.path = PathFolder(tools, order + 0.2)
        beam = BeamFolder(tools, order + 0.22)
        proposals = ProposalFolder(tools, order + 0.25)
        asks = AskFolder(tools, order + 0.3)
        sphere = Sphere(tools, order + 0.4)
        image, prices = ImageTab(tools), PricesTab(tools)
        self._changes = ChangesTab(tools)
        self.scene = Scene(tools, self._rooms)
        self._all: tuple[Tool, ...] = (
            *(self.scene, self._draft, self.choose, self.move, self.path, beam, proposals, asks),
            *(runs, sphere, image, prices, self._changes),
        )
        self.page.watch_view(lambda view: self._hand.ask("view", lambda: self._look(view)))
        self._hand.ask("begin", self._begin)

    def close(self) -> None:
        """End both threads, the workers and the page."""
        self._hand.close()
        self._rooms.close()
        if self._rest is not None:
            self._rest.cancel()
        self.bench.close()
        self.page.close()

    def settle(self, timeout_s: float | None = None) -> bool:
        """Wait until all is answered and painted; return False on timeout."""
        parts = (self._hand, self.bench, self._hand, self._rooms, self.page)
        return all(part.settle(timeout_s) for part in parts)

    # Tasks of the page's thread.

    def _begin(self) -> None:
        self.bench.begin()
        self._refresh()

    def _look(self, view: int) -> None:
        if view != self.bench.view:
            self.bench.look(view)
            self.path.look()
            self._rest_later()

    def _rest_later(self) -> None:
        """Ask for what takes longer when nothing has changed for a while."""
        if self._rest is not None:
            self._rest.cancel()
        self._rest = Timer(self._rest_s, self._hand.ask, ("rest", self.bench.rest))
        self._rest.daemon = True
        self._rest.start()

    def _beat(self) -> None:
        for tool in self._all:
            tool.beat()

    # Painting.

    def _hear(self, subject: str, answer: Answer) -> None:
        """Paint an answer; called by the desks' threads."""
        self._hand.ask(("answer", subject), lambda: self._paint_answer(subject))

    def _paint_answer(self, subject: str) -> None:
        answer = self.bench.answer(subject)
        for tool in self._all:
            tool.hear(subject, answer)

    def _refresh(self) -> None:
        """Paint the draft's present state."""
        self._draft.paint_draft()
        self._changes.paint_draft()
        scenario = self.bench.draft.scenario
        if scenario is None:
            self.page.say("; ".join(words.problems_of(self.bench)))
            return
        if scenario is self._tools.shown:
            self.scene.paint_show()
            return
        self._tools.shown = scenario
        for tool in self._all:
            tool.paint(scenario)
        self._rest_later()

    def _say(self, error: Exception) -> None:
        """Show an error that no task expected."""
        if not isinstance(error, TwinctError):
            log.error("the page could not do what was asked", exc_info=error)
        self.page.say(str(error))
