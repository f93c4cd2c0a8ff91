"""The tab with the prices of the design."""

from __future__ import annotations

from twinct.design import words
from twinct.design.desk import Answer
from twinct.design.page.tools import Tool, Tools
from twinct.scenario import Scenario


class PricesTab(Tool):
    """Each price now, and its change against the saved file."""

    def __init__(self, tools: Tools) -> None:
        """Add the tab."""
        super().__init__(tools)
        with tools.page.side.add_tab("Prices"):
            self._prices = tools.server.gui.add_markdown("")

    def paint(self, scenario: Scenario) -> None:
        """Show the prices."""
        self._prices.content = words.prices_in_words(self.bench.prices())

    def hear(self, subject: str, answer: Answer) -> None:
        """Show the prices."""
        self._prices.content = words.prices_in_words(self.bench.prices())
