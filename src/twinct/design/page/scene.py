"""The scene: the room of the draft with its path, or the newest run of the present state."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from twinct.core.errors import TwinctError
from twinct.design import words
from twinct.design.desk import Answer, State
from twinct.design.hand import Hand
from twinct.design.page.tools import Tool, Tools
from twinct.design.shared import SharedBuilder
from twinct.geometry.wire import PosePairs
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Scenario
from twinct.viewer.filling import specimen_as_it_looks, whole_room
from twinct.viewer.following import mark
from twinct.viewer.planned import field_of_view
from twinct.viewer.room import Room
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.scenery import see_whole_room
from twinct.viewer.show import RECONSTRUCTION, TRUTH, Show


class Scene(Tool):
    """Puts shows and bodies on the page of ``twinct view``."""

    def __init__(self, tools: Tools, rooms: Hand) -> None:
        """Prepare the scene; ``rooms`` is the thread that builds bodies."""
        super().__init__(tools)
        self._rooms = rooms
        self._built: tuple[Any, Any] = (None, None)
        self._folder: tuple[object, RunFolder] | None = None
        self._shown: object = None
        self._seen = False

    def show_of(self, scenario: Scenario) -> Show:
        """Return what is known of a scenario that was not run."""
        views, motion = self.bench.answer("views"), self.bench.answer("motion")
        requested = SimulationBuilder(scenario).requested
        refused: tuple[int, ...] = ()
        if views.value is not None and len(views.value) == len(requested):
            refused = tuple(np.flatnonzero(~np.asarray(views.value)).tolist())
        plan = motion.value.plan if motion.state is State.FRESH else None
        found = self.bench.answer("volume")
        volumes = {}
        if found.value is not None:
            volumes = {RECONSTRUCTION: found.value.volume, TRUTH: found.value.truth}
        return Show(
            scenario.name,
            scenario,
            PosePairs.from_geometry(requested),
            plan=plan,
            volumes=volumes,
            refused=refused,
            state=words.state_of(self.bench),
            problems=words.problems_of(self.bench),
        )

    def _show_of_run(self) -> Show | None:
        """Return the state of the newest run, if it is one of the present state and has views."""
        started = self.bench.started
        if started is None or not self.bench.shows_run:
            return None
        try:
            if self._folder is None or self._folder[0] is not started:
                self._folder = started, RunFolder(started.out, live=True)
            show = self._folder[1].look()
        except TwinctError:
            return None  # nothing is stored yet
        return show if show.poses else None

    def paint_show(self) -> None:
        """Show the run of the present state, or the present state."""
        scenario = self.tools.shown
        if scenario is None:
            return
        show = self._show_of_run()
        if show is None:
            show = self.show_of(scenario)
            self._shown = None
        elif self._shown == mark(show):
            return
        else:
            self._shown = mark(show)
            show = replace(show, problems=words.problems_of(self.bench))
        self.tools.page.put(0, show)

    def paint(self, scenario: Scenario) -> None:
        """Show a scenario."""
        self.paint_show()
        self._paint_bodies(scenario)
        if not self._seen:
            self._seen = True
            see_whole_room(self.tools.server, self.show_of(scenario))

    def hear(self, subject: str, answer: Answer) -> None:
        """Show what has changed."""
        if subject in ("views", "motion", "volume", "run"):
            self.paint_show()

    def beat(self) -> None:
        """Follow the run."""
        if self.bench.answer("run").state is State.COMPUTING and self.bench.shows_run:
            self.paint_show()

    @staticmethod
    def _room_of(scenario: Scenario, show: Show, builder: SharedBuilder) -> Room:
        """Return the room, also if fixed bodies overlap: this is what its user has to see."""
        if isinstance(scenario.cell, Cell):
            return Room(builder.cell_of(scenario.cell))
        room = whole_room(show, builder)
        assert room is not None  # only rooms without a scenario may be none
        return room

    def _paint_bodies(self, scenario: Scenario) -> None:
        """Build the room, the specimen and the field of view anew, as far as they differ."""
        reads = (scenario.cell, scenario.specimen, scenario.detector.panel)
        field = (scenario.trajectory, scenario.reconstruction, scenario.detector.panel)
        if (reads, field) == self._built:
            return
        known = self._built
        self._built = (reads, field)
        page = self.tools.page

        def build() -> None:
            builder = SharedBuilder(scenario, shelf=self.bench.shelf)
            show = self.show_of(scenario)
            if reads != known[0] or not isinstance(scenario.cell, Cell):
                page.put_room(0, self._room_of(scenario, show, builder))
                if known[0] is None or scenario.specimen != known[0][1]:
                    page.put_specimen(0, specimen_as_it_looks(builder.specimen))
            page.put_field(0, field_of_view(show))

        self._rooms.ask("bodies", build)
