"""The page of ``twinct design``: the page of ``twinct view``, with tools that change its scenario.

The tools are a thin layer: browsers ask, one thread changes the model and paints what it says.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np

from twinct.core.errors import TwinctError
from twinct.design import words
from twinct.design.desk import Answer, State
from twinct.design.draft import Draft
from twinct.design.hand import Hand
from twinct.design.movable import Movable, movables, tidy
from twinct.design.path_keys import Slider, family_names, of_family, sliders_of
from twinct.design.questions import Checked, Projection, Shading, SmallVolume
from twinct.design.workbench import Workbench
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Scenario
from twinct.viewer.filling import specimen_as_it_looks, whole_room
from twinct.viewer.live_page import Page
from twinct.viewer.markdown import plain
from twinct.viewer.planned import field_of_view
from twinct.viewer.projection import picture_of, window_of
from twinct.viewer.scenery import see_whole_room
from twinct.viewer.server import Server
from twinct.viewer.show import RECONSTRUCTION, TRUTH, Show
from twinct.viewer.stage import MM

log = logging.getLogger(__name__)

REST_S = 0.6
"""Time without a change after which all pixels of the image are asked for."""

WIDE_PX = 400
"""Width to which small images are enlarged, by whole pixels."""

NOTHING = "nothing"
GIZMO_M = 0.25

BOTH, ONE, NONE = (38, 150, 70), (240, 170, 40), (200, 50, 50)
"""Colours of directions that both arms, one arm, and no arm can hold."""


class DesignPage:
    """Tools beside a page, and the model behind them.

    Attributes:
        page: the page of ``twinct view``.
        bench: the model; only the page's own thread changes it.
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
        self.page, self._rest_s = Page(server), rest_s
        self.bench = Workbench(draft, folder, self._hear)
        self._server, self._window = server, 0.0
        self._rest: Timer | None = None
        self._shaded: Shading | None = None
        self._hand = Hand("design", self._say, self.look_at_file)
        self._rooms = Hand("rooms", self._say)
        self._built: tuple[Any, Any] = (None, None)
        self._shown: Scenario | None = None
        self._sliders: dict[str, Any] = {}
        self._by: tuple[Any, ...] = ()
        self._outside = False
        self._said = ""
        self._build()
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

    # Controls.

    def _build(self) -> None:
        gui, order = self._server.gui, self.page.below_head
        with gui.add_folder("Draft", order=order):
            self._file = gui.add_markdown("")
            self._draft = gui.add_button_group("", ("undo", "redo", "save"))
            self._theirs = gui.add_button_group("", ("take over", "replace"), visible=False)
        with gui.add_folder("Move", order=order + 0.1):
            self._body: Any = gui.add_dropdown("body", (NOTHING,))
            self._at = gui.add_vector3("position, mm", (0.0, 0.0, 0.0), visible=False)
            self._turned = gui.add_vector3("rotation, deg", (0.0, 0.0, 0.0), visible=False)
            self._snap_mm = gui.add_number("snap, mm", 10.0, min=0.0)
            self._snap_deg = gui.add_number("snap, deg", 5.0, min=0.0)
        self._gizmo = self._server.scene.add_transform_controls(
            "/design/gizmo", scale=GIZMO_M, visible=False, depth_test=False
        )
        self._path = gui.add_folder("Path", order=order + 0.2)
        with self._path:
            self._family: Any = gui.add_dropdown("family", family_names())
        with gui.add_folder("Ask", order=order + 0.3):
            self._sphere = gui.add_checkbox("sphere of directions", True)
            self._ask = gui.add_button_group("", ("small volume", "whole check", "cancel"))
            self._answer = gui.add_markdown("")
        with self.page.side.add_tab("Image"):
            self._image = gui.add_image(np.full((8, 8, 3), 255, np.uint8), label="projection")
            self._of_image = gui.add_markdown("")
        with self.page.side.add_tab("Prices"):
            self._prices = gui.add_markdown("")
        with self.page.side.add_tab("Changes"):
            self._compared = gui.add_markdown("")
            self._copies = gui.add_markdown("")
        self._listen()

    def _listen(self) -> None:
        """Turn what browsers do into tasks of the page's thread; the newest of each kind counts.

        The functions are asynchronous, to run in the server's loop, which keeps them in order.
        """

        def on(handle: Any, kind: str, task: Callable[[], object]) -> None:
            async def heard(_: Any) -> None:
                self._hand.ask(kind, task)

            handle.on_update(heard)

        def pressed(group: Any, does: Callable[[str], object]) -> None:
            async def heard(event: Any) -> None:
                button = str(event.target.value)
                self._hand.ask(object(), lambda: does(button))

            group.on_click(heard)

        pressed(self._draft, self._press)
        pressed(self._theirs, self._resolve)
        pressed(self._ask, self._request)
        on(self._body, "body", self._choose)
        on(self._at, "typed", self._typed)
        on(self._turned, "typed", self._typed)
        on(self._family, "family", self._change_family)
        on(self._sphere, "sphere", lambda: self._paint_sphere(self.bench.answer("sphere")))
        self.page.watch_view(lambda view: self._hand.ask("view", lambda: self._look(view)))

        async def dragged(event: Any) -> None:
            if event.phase == "end":
                self._hand.ask("dropped", self._drop)

        self._gizmo.on_update(dragged)

    # Tasks of the page's thread.

    def _begin(self) -> None:
        self.bench.begin()
        self._refresh()

    def _press(self, button: str) -> None:
        if button == "save":
            self._try(self.bench.save)
        elif button == "undo":
            self.bench.undo()
        else:
            self.bench.redo()
        self._refresh()

    def _resolve(self, button: str) -> None:
        """Take over or replace the file of another program."""
        if button == "take over":
            self._try(self.bench.take_over)
        else:
            self._try(lambda: self.bench.save(over=True))
        self.look_at_file()
        self._refresh()

    def _request(self, button: str) -> None:
        if button == "cancel":
            self.bench.cancel()
        elif not self.bench.draft.problems:
            kind = SmallVolume if button == "small volume" else Checked
            self.bench.ask(kind(self.bench.draft.source))

    def _change(
        self, values: dict[str, Any], gesture: object = None, by: tuple[Any, ...] = ()
    ) -> None:
        """Make an edit; the controls that asked for it stay, as their user may have gone on."""
        if values:
            self._try(lambda: self.bench.set(values, gesture=gesture))
        self._by = by
        try:
            self._refresh()
        finally:
            self._by = ()

    def _try(self, act: Callable[[], object]) -> None:
        """Do something, and show why it is refused."""
        self._said = ""
        try:
            act()
        except TwinctError as error:
            self._said = str(error)

    def _choose(self) -> None:
        self._paint_move()

    def _chosen(self) -> Movable | None:
        scenario = self._shown
        known = () if scenario is None else movables(scenario)
        return next((one for one in known if one.name == self._body.value), None)

    def _typed(self) -> None:
        """Move the chosen body to the typed numbers."""
        body = self._chosen()
        if body is not None:
            pose = Pose.from_euler(self._at.value, self._turned.value)
            self._change(dict(body.moved(pose)), ("typed", body.name), (self._at, self._turned))

    def _drop(self) -> None:
        """Move the chosen body to the gizmo."""
        body = self._chosen()
        if body is not None:
            w, x, y, z = self._gizmo.wxyz
            pose = Pose.from_metres(self._gizmo.position, (x, y, z, w))
            steps = float(self._snap_mm.value), float(self._snap_deg.value)
            self._change(dict(body.moved(pose, *steps)))

    def _change_family(self) -> None:
        scenario, name = self._shown, str(self._family.value)
        if scenario is not None and scenario.trajectory.kind != name:
            self._change(of_family(scenario, name))

    def _slide(self, slider: Slider, handle: Any) -> None:
        scenario = self._shown
        value = tidy(float(handle.value))
        if scenario is not None and getattr(scenario.trajectory, slider.name, None) != value:
            self._change({slider.key: value}, slider.key, (handle,))

    def _look(self, view: int) -> None:
        if view != self.bench.view:
            self.bench.look(view)
            self._look_closer_later()

    def _look_closer_later(self) -> None:
        """Ask for all pixels when nothing has changed for a while."""
        if self._rest is not None:
            self._rest.cancel()
        self._rest = Timer(self._rest_s, self._hand.ask, ("closer", self._look_closer))
        self._rest.daemon = True
        self._rest.start()

    def _look_closer(self) -> None:
        self.bench.look(self.bench.view, whole=True)

    def look_at_file(self) -> None:
        """Notice what another program has written; the page's thread does so every second."""
        outside = self.bench.draft.changed_outside()
        if outside != self._outside:
            self._outside = outside
            self._theirs.visible = outside
            self._paint_draft()

    # Painting.

    def _hear(self, subject: str, answer: Answer) -> None:
        """Paint an answer; called by the desks' threads."""
        self._hand.ask(("answer", subject), lambda: self._paint_answer(subject))

    def _paint_answer(self, subject: str) -> None:
        answer = self.bench.answer(subject)
        if subject == "image":
            self._paint_image(answer)
        elif subject == "sphere":
            self._paint_sphere(answer)
        elif subject in ("views", "motion", "volume"):
            self._paint_show()
        if subject in ("volume", "check"):
            self._paint_requested(subject, answer)
        self._paint_prices()

    def _refresh(self) -> None:
        """Paint the draft's present state."""
        self._paint_draft()
        scenario = self.bench.draft.scenario
        if scenario is None:
            self.page.say("; ".join(words.problems_of(self.bench)))
            return
        if scenario is not self._shown:
            first = self._shown is None
            self._shown = scenario
            self._paint_show()
            self._paint_controls(scenario)
            self._paint_bodies(scenario)
            if first:
                see_whole_room(self._server, self._show(scenario))
            self._look_closer_later()
        else:
            self._paint_show()
        self._paint_prices()

    def _paint_draft(self) -> None:
        draft = self.bench.draft
        said = words.draft_in_words(draft, self._outside)
        self._file.content = f"{said}  \n**{plain(self._said)}**" if self._said else said
        self._compared.content = words.changes_in_words(draft.compare())
        try:
            copies = [words.code(draft.command(), "sh"), words.code(draft.python(), "python")]
        except TwinctError as error:
            copies = [f"*{plain(str(error))}*"]
        self._copies.content = "\n\n".join(copies)

    def _paint_prices(self) -> None:
        self._prices.content = words.prices_in_words(self.bench.prices())

    def _show(self, scenario: Scenario) -> Show:
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

    def _paint_show(self) -> None:
        if self._shown is not None:
            self.page.put(0, self._show(self._shown))

    def _paint_image(self, answer: Answer) -> None:
        question = answer.question
        if isinstance(question, Projection) and answer.state is not State.FAILED:
            if not self._window or question.whole:
                self._window = window_of(answer.value)
            rows, columns = answer.value.shape
            picture, times = picture_of(answer.value, self._window), max(WIDE_PX // columns, 1)
            self._image.image = picture.repeat(times, axis=0).repeat(times, axis=1)
            kind = "all pixels" if question.whole else "preview"
            self._of_image.content = (
                f"view {question.view}, {columns} x {rows} pixels ({kind}), line integrals from 0 "
                f"to {self._window:.2f}{'' if answer.state is State.FRESH else f', {answer.state}'}"
            )
        elif answer.problems:
            self._of_image.content = f"**{plain('; '.join(answer.problems))}**"

    def _paint_sphere(self, answer: Answer) -> None:
        shading: Shading | None = answer.value
        if not self._sphere.value or answer.state is State.FAILED:
            shading = None
        if shading is not self._shaded:
            self._shaded = shading
            self._draw_sphere(shading)
        if answer.state is State.FRESH and shading is not None:
            self.bench.refine()

    def _draw_sphere(self, shading: Shading | None) -> None:
        if shading is None:
            self._server.scene.remove_by_name("/design/sphere")
            return
        held = shading.alone.sum(axis=0)
        colours = np.where(shading.both[:, None], BOTH, np.where(held[:, None] > 0, ONE, NONE))
        points = (shading.isocentre_mm + shading.sod_mm * shading.directions) * MM
        self._server.scene.add_point_cloud(
            "/design/sphere",
            points.astype(np.float32),
            colors=colours.astype(np.uint8),
            point_size=0.008,
            point_shape="circle",
        )

    def _paint_requested(self, subject: str, answer: Answer) -> None:
        name = "small volume" if subject == "volume" else "whole check"
        lines = [f"{name}: {answer.state}"]
        if answer.state is State.FRESH and subject == "check":
            lines += [f"{topic}: {plain(text)}" for topic, text in answer.value.items()]
        elif answer.state is State.FRESH:
            lines[0] += f", {answer.seconds:.1f} s; see Slices"
        lines += [f"**{plain(problem)}**" for problem in answer.problems]
        self._answer.content = "  \n".join(lines)

    def _paint_controls(self, scenario: Scenario) -> None:
        names = (NOTHING, *(one.name for one in movables(scenario)))
        if self._body.options != names:
            chosen = self._body.value
            self._body.options = names
            self._body.value = chosen if chosen in names else NOTHING
        self._paint_move()
        sliders = sliders_of(scenario)
        self._path.visible = bool(sliders)
        if sliders and self._family.value != scenario.trajectory.kind:
            self._family.value = scenario.trajectory.kind
        if [*self._sliders] != [one.name for one in sliders]:
            self._lay_sliders(sliders)
        for one in sliders:
            handle = self._sliders[one.name]
            if handle.value != one.value and handle not in self._by:
                handle.value = one.value

    def _lay_sliders(self, sliders: tuple[Slider, ...]) -> None:
        for handle in self._sliders.values():
            handle.remove()
        self._sliders = {}
        with self._path:
            for one in sliders:
                handle = self._server.gui.add_slider(
                    one.name, one.low, one.high, one.step, one.value, hint=one.hint
                )
                self._sliders[one.name] = handle
                self._hear_slider(one, handle)

    def _hear_slider(self, slider: Slider, handle: Any) -> None:
        async def heard(_: Any) -> None:
            self._hand.ask(slider.key, lambda: self._slide(slider, handle))

        handle.on_update(heard)

    def _paint_move(self) -> None:
        """Show gizmo and numbers of the chosen body."""
        body = self._chosen()
        for handle in (self._gizmo, self._at, self._turned):
            if handle.visible != (body is not None):
                handle.visible = body is not None
        if body is None:
            return
        position, quat = body.pose.to_metres()
        self._gizmo.position, self._gizmo.wxyz = position, quat[[3, 0, 1, 2]]
        for handle, numbers in ((self._at, body.position_mm), (self._turned, body.rotation_deg)):
            if tuple(handle.value) != tuple(numbers) and handle not in self._by:
                handle.value = np.asarray(numbers, float)

    def _paint_bodies(self, scenario: Scenario) -> None:
        """Build the room, the specimen and the field of view anew, as far as they differ."""
        reads = (scenario.cell, scenario.specimen, scenario.detector.panel)
        field = (scenario.trajectory, scenario.reconstruction, scenario.detector.panel)
        if (reads, field) == self._built:
            return
        known = self._built
        self._built = (reads, field)

        def build() -> None:
            builder = SimulationBuilder(scenario)
            show = self._show(scenario)
            if reads != known[0] or not isinstance(scenario.cell, Cell):
                if (room := whole_room(show, builder)) is not None:
                    self.page.put_room(0, room)
                if known[0] is None or scenario.specimen != known[0][1]:
                    self.page.put_specimen(0, specimen_as_it_looks(builder.specimen))
            self.page.put_field(0, field_of_view(show))

        self._rooms.ask("bodies", build)

    def _say(self, error: Exception) -> None:
        """Show an error that no task expected."""
        if not isinstance(error, TwinctError):
            log.error("the page could not do what was asked", exc_info=error)
        self.page.say(str(error))
