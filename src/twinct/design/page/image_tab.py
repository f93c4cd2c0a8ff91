"""The tab with the image of the view, and a profile through it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.design.desk import Answer, State
from twinct.design.page.tools import Tool, Tools
from twinct.design.profiles import QUANTITIES, profile_of
from twinct.design.questions import Projection
from twinct.scenario import Scenario
from twinct.viewer.markdown import plain
from twinct.viewer.projection import picture_of, window_of

WIDE_PX = 400
"""Width to which small images are enlarged, by whole pixels."""

LINE_RGB = (220, 60, 40)
ALONG = ("columns", "rows")


class ImageTab(Tool):
    """Projection, profile, and what the view sees."""

    def __init__(self, tools: Tools) -> None:
        """Add the tab."""
        super().__init__(tools)
        gui = tools.server.gui
        self._window = 0.0
        self._last: tuple[Projection, NDArray[np.float32], str] | None = None
        with tools.page.side.add_tab("Image"):
            self._image = gui.add_image(np.full((8, 8, 3), 255, np.uint8), label="projection")
            self._of_image = gui.add_markdown("")
            self._seen = gui.add_markdown("")
            self._along: Any = gui.add_dropdown("profile along", ALONG)
            self._at = gui.add_slider("profile at, mm", -100.0, 100.0, 1.0, 0.0)
            self._quantity: Any = gui.add_dropdown("profile of", QUANTITIES)
            nothing = np.zeros(2)
            self._plot = gui.add_uplot(
                data=(np.array([-1.0, 1.0]), nothing),
                series=({"label": "mm"}, {"label": "value", "stroke": "#1f6091", "width": 1.5}),
                title="profile",
                aspect=1.9,
                scales={"x": {"time": False}},
            )
        for handle in (self._along, self._at, self._quantity):
            tools.on(handle, "profile", lambda _: self._paint_image())

    def paint(self, scenario: Scenario) -> None:
        """Fit the profile's slider to the panel."""
        half = round(max(scenario.detector.panel.size_mm) / 2)
        if self._at.max != half:
            self._at.min, self._at.max = -half, half
            self._at.value = float(np.clip(self._at.value, -half, half))

    def hear(self, subject: str, answer: Answer) -> None:
        """Show the newest image."""
        if subject == "image":
            question = answer.question
            if isinstance(question, Projection) and answer.state is not State.FAILED:
                state = "" if answer.state is State.FRESH else f", {answer.state}"
                self._last = question, answer.value, state
                self._paint_image()
            elif answer.problems:
                self._of_image.content = f"**{plain('; '.join(answer.problems))}**"
            self.bench.ask_for_scatter()
        if subject == "scatter":
            self._paint_image()
        if subject in ("image", "seen"):
            self._paint_seen()

    def _paint_image(self) -> None:
        scenario = self.tools.shown
        if self._last is None or scenario is None:
            return
        question, image, state = self._last
        scatter = self.bench.scatter_in(question)
        if scatter.value is not None:
            image = image + scatter.value
        if not self._window or question.whole:
            self._window = window_of(image)
        rows, columns = image.shape
        picture, times = picture_of(image, self._window), max(WIDE_PX // columns, 1)
        along = self._along.value
        profile = profile_of(
            image, scenario.detector.panel, along, float(self._at.value), self._quantity.value
        )
        large = picture.repeat(times, axis=0).repeat(times, axis=1)
        middle = profile.index * times + times // 2
        large[(middle, slice(None)) if along == "columns" else (slice(None), middle)] = LINE_RGB
        self._image.image = large
        self._plot.data = profile.place_mm, profile.values
        kind = "preview"
        if question.whole:
            kind = "all pixels" + (", with scatter" if scenario.detector.scatter else "")
        elif scatter.value is not None:
            kind += ", with scatter"
        elif scatter.state is not State.UNASKED:
            kind += f"; scatter: {plain('; '.join(scatter.problems)) or scatter.state}"
        self._of_image.content = (
            f"view {question.view}, {columns} x {rows} pixels ({kind}), line integrals from 0 "
            f"to {self._window:.2f}{state}"
        )

    def _paint_seen(self) -> None:
        seen, view = self.bench.answer("seen"), self.bench.view
        if seen.value is None or view >= len(seen.value.by_view):
            return
        state = "" if seen.state is State.FRESH else f" ({seen.state})"
        self._seen.content = (
            f"this view sees {100 * seen.value.by_view[view]:.0f} % of the specimen, every view "
            f"{100 * seen.value.by_all:.0f} %{state}"
        )
