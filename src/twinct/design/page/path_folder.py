"""The folder of the path: its family, its numbers, and the points of a path that is drawn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from twinct.core.errors import InputError
from twinct.design.desk import Answer, State
from twinct.design.drawn_path import DrawnPath, drawn_path_of
from twinct.design.movable import tidy
from twinct.design.page.tools import Tool, Tools
from twinct.design.path_keys import Slider, family_names, of_family, sliders_of
from twinct.runs.reaching import orbit_of
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario
from twinct.trajectory import FileTrajectory
from twinct.viewer.markdown import plain
from twinct.viewer.stage import MM

DRAWN = "drawn"
POINT_M, CURVE_POINTS = 0.012, 200
POINT_RGB, CURVE_RGB = (150, 60, 190), (190, 120, 220)


class PathFolder(Tool):
    """The path as a family with sliders, or as points on the sphere of directions."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the folder."""
        super().__init__(tools)
        gui = tools.server.gui
        self.sliders: dict[str, Any] = {}
        self.drawn: DrawnPath | None = None
        self._nodes: list[Any] = []
        self._of: object = None
        self._folder = gui.add_folder("Path", order=order)
        with self._folder:
            self._reason = gui.add_markdown("", visible=False)
            self._family: Any = gui.add_dropdown("family", (*family_names(), DRAWN))
            self._draws = gui.add_checkbox(
                "draw", False, hint="Each click on the sphere of directions adds a point."
            )
            self._count = gui.add_number("drawn views", 60, min=2, max=2000, step=1)
            self._points = gui.add_button_group("", ("use drawn path", "last point off", "clear"))
            self._about = gui.add_markdown("")
        tools.on(self._family, "family", self._change_family)
        tools.pressed(self._points, self._press)
        self._clicks: Any = None
        tools.on(self._draws, "draw", self._listen_to_clicks)
        self._show_drawing(False)

    # A family.

    def _change_family(self, name: str) -> None:
        scenario = self.tools.shown
        if scenario is None or scenario.trajectory.kind == name:
            return
        if name == DRAWN:
            self._show_drawing(True)
        elif sliders_of(scenario):
            self.tools.change(of_family(scenario, name))
        else:  # views from a file: a path about the isocentre with their mean distances
            sod, odd, centre = orbit_of(SimulationBuilder(scenario))
            self.tools.change(
                {
                    "trajectory": {
                        "kind": name,
                        "views": len(SimulationBuilder(scenario).requested),
                        "isocentre_mm": [tidy(number) for number in centre],
                        "sod_mm": tidy(sod),
                        "sdd_mm": tidy(sod + odd),
                    }
                }
            )

    def _slide(self, slider: Slider, handle: Any, number: float) -> None:
        scenario, value = self.tools.shown, tidy(float(number))
        if scenario is not None and getattr(scenario.trajectory, slider.name, None) != value:
            self.tools.change({slider.key: value}, slider.key, (handle,))

    def paint(self, scenario: Scenario) -> None:
        """Show the family with its sliders."""
        sliders, section = sliders_of(scenario), scenario.trajectory
        kind = section.kind if sliders else DRAWN
        if self._family.value != kind and not (self.drawn and self._draws.value):
            self._family.value = kind
            self._show_drawing(kind == DRAWN)
        if [*self.sliders] != [one.name for one in sliders]:
            self._lay_sliders(sliders)
        for one in sliders:
            handle = self.sliders[one.name]
            if handle.value != one.value and handle not in self.tools.by:
                handle.value = one.value
        if isinstance(section, FileTrajectory) and section.path != self._of:
            self._of = section.path
            if (known := drawn_path_of(section.path)) is not None:
                self.drawn = known
                self._count.value = known.views
                self._draw_points()

    def _lay_sliders(self, sliders: tuple[Slider, ...]) -> None:
        for handle in self.sliders.values():
            handle.remove()
        self.sliders = {}
        with self._folder:
            for one in sliders:
                handle = self.tools.server.gui.add_slider(
                    *(one.label, one.low, one.high, one.step, one.value),
                    hint=f"{one.key}: {one.hint}",
                )
                self.sliders[one.name] = handle
                self._hear_slider(one, handle)

    def _hear_slider(self, slider: Slider, handle: Any) -> None:
        self.tools.on(handle, slider.key, lambda value: self._slide(slider, handle, value))

    # A drawn path.

    def _show_drawing(self, visible: bool) -> None:
        for handle in (self._draws, self._count, self._points, self._about):
            handle.visible = visible
        if visible and self.drawn is None:
            self._about.content = "*Switch on* draw*, then click on the sphere of directions.*"

    def _listen_to_clicks(self, draws: bool) -> None:
        scene = self.tools.server.scene
        if not draws:
            if self._clicks is not None:
                scene.remove_click_callback(self._clicks)
                self._clicks = None
            return

        async def clicked(event: Any) -> None:
            origin = 1000 * np.asarray(event.ray_origin)
            along = np.asarray(event.ray_direction)
            self.tools.hand.ask(object(), lambda: self.add_point(origin, along))

        self._clicks = clicked
        scene.on_click()(self._clicks)

    def add_point(self, origin: Any, along: Any) -> None:
        """Add the point of the sphere that a ray meets, mm."""
        if (begun := self._begun()) is None:
            return
        try:
            self.drawn = begun.with_point(origin, along)
        except InputError as error:
            self._about.content = f"**{plain(str(error))}**"
            return
        self._draw_points()

    def _begun(self) -> DrawnPath | None:
        """Return the drawn path, or one without points at the distances of the scenario."""
        scenario = self.tools.shown
        if self.drawn is not None or scenario is None:
            return self.drawn
        sod, odd, centre = orbit_of(SimulationBuilder(scenario))
        x, y, z = (float(number) for number in centre)
        return DrawnPath((), (x, y, z), sod, sod + odd, int(self._count.value))

    def _press(self, button: str) -> None:
        scenario = self.tools.shown
        if self.drawn is None or scenario is None:
            return
        if button == "clear":
            self.drawn = replace(self.drawn, points=())
        elif button == "last point off":
            self.drawn = replace(self.drawn, points=self.drawn.points[:-1])
        else:
            drawn = replace(self.drawn, views=int(self._count.value))
            panel, values = scenario.detector.panel, dict[str, Any]()
            if self.tools.attempt(lambda: values.update(drawn.keep(self.bench.draft.path, panel))):
                self.drawn = drawn
            self.tools.change(values) if values else self.tools.refresh()
        self._draw_points()

    def _draw_points(self) -> None:
        """Draw the points and the curve through them."""
        for node in self._nodes:
            node.remove()
        self._nodes, drawn = [], self.drawn
        if drawn is None:
            return
        scene, centre = self.tools.server.scene, np.asarray(drawn.isocentre_mm)
        for k, point in enumerate(drawn.points):
            at = (centre + drawn.sod_mm * np.asarray(point)) * MM
            self._nodes.append(
                scene.add_icosphere(
                    f"/design/drawn/{k}", radius=POINT_M, color=POINT_RGB, position=at
                )
            )
        if len(drawn.points) > 1:
            curve = (centre + drawn.sod_mm * drawn.directions(CURVE_POINTS)) * MM
            lines = np.stack([curve[:-1], curve[1:]], axis=1).astype(np.float32)
            self._nodes.append(
                scene.add_line_segments("/design/drawn/curve", lines, CURVE_RGB, thickness=0.004)
            )
        count = len(drawn.points)
        self._about.content = f"{count} point{'' if count == 1 else 's'}"

    # A dead view.

    def hear(self, subject: str, answer: Answer) -> None:
        """Say why the arms cannot take the view, and show how near they come."""
        if subject == "views":
            self.bench.explain()
        if subject not in ("views", "reason"):
            return
        held, reason = self.bench.answer("views"), self.bench.answer("reason")
        view, known = self.bench.view, reason.value
        dead = held.state is State.FRESH and view < len(held.value) and not held.value[view]
        fresh = reason.state is State.FRESH
        self._reason.visible = dead
        if dead and fresh and known is not None and known.view == view:
            why = "; ".join(known.words) or "no pair of configurations holds it"
            self._reason.content = f"**{plain(why)}**"
            self.tools.page.move(0, known.joints)
        elif dead:
            self._reason.content = f"*view {view} is out of reach: looking for the reason*"

    def look(self) -> None:
        """Say it of another view."""
        self.bench.explain()
        self.hear("reason", self.bench.answer("reason"))
